"""The augmented Lagrangian with friction, where active sets do not settle."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver.contact.active_set_options import ActiveSetOptions
from solver.driver import solve as solve_problem
from solver.primal.augmented import AugmentedLagrangian
from tests import meshfiles, scenes
from tests.bearings import half_bearing
from tests.comparison import solve
from tests.contact_app.run.test_friction import on_a_slope
from tests.stability.friction_scenes import friction_scene

TRESCA, COULOMB = {"tresca": 20.0}, {"coulomb": 0.4}


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
@pytest.mark.parametrize(
    ("name", "friction"),
    [
        *((name, law) for name in ("wall", "two_bodies") for law in (TRESCA, COULOMB)),
        ("wall", None),
        ("rollers_and_floor", None),
    ],
)
def test_the_lagrangian_alone_finds_the_answer_of_the_active_sets(
    name: str, cell: str, friction: dict[str, Any] | None
) -> None:
    """It begins after one set that has to change."""
    made = scenes.ALL[name](cell, 4)
    for contact in made["contacts"] if friction else []:
        contact["friction"] = friction
    made["solver"] = {"method": "primal", "tolerance": 1e-8}
    model = solve(made, None).model
    options = model.scene.solver
    expected = solve_problem(model.problem, options)
    found = solve_problem(model.problem, options, active_sets=ActiveSetOptions(most_sets=0))
    assert found.converged
    assert found.method == "primal"
    for one, other in zip(found.displacements, expected.displacements, strict=True):
        assert one == pytest.approx(other, abs=1e-5 * np.abs(other).max())


def test_sets_that_do_not_settle_where_friction_alone_holds_a_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The Lagrangian goes on at once: the sets have no contact without friction to begin from."""
    made = on_a_slope("hexahedron", {"coulomb": 0.4}, 0.36)
    made["solver"] = {"method": "primal", "tolerance": 1e-8}
    model = solve(made, None).model
    options = model.scene.solver
    expected = solve_problem(model.problem, options)
    ended: list[int] = []

    def watched(lagrangian: AugmentedLagrangian, u: Any) -> Any:
        outcome = find(lagrangian, u)
        ended.append(outcome.counts.hessian)
        return outcome

    find = AugmentedLagrangian.solve
    monkeypatch.setattr(AugmentedLagrangian, "solve", watched)
    never_settled = ActiveSetOptions(settling=1, unsettled=0.0)
    found = solve_problem(model.problem, options, active_sets=never_settled)
    assert found.converged
    assert ended == [found.counts.hessian]
    for one, other in zip(found.displacements, expected.displacements, strict=True):
        assert one == pytest.approx(other, abs=1e-5 * np.abs(other).max())


@pytest.mark.ratchet
def test_rollers_with_friction_are_solved_by_multigrid(tmp_path: Path) -> None:
    """Two of three rollers carry nothing; active sets do not settle, SMALBE-M takes 510."""
    made = half_bearing(tmp_path, "quadrilateral", 3, (12, 10))
    for contact in made["contacts"]:
        contact["friction"] = {"coulomb": 0.2}
    summary = solve(made, None, tolerance=1e-6, method="primal").summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] <= 60
    other = solve(made, None, tolerance=1e-6, method="smalbe").summary
    assert summary["solution"]["energy"] == pytest.approx(other["solution"]["energy"], rel=1e-5)


def hooked(x: np.ndarray) -> np.ndarray:
    """Points of a half ring about a peg of radius 8, which ends in a straight stem."""
    inner, outer, stem = 8.05, 16.0, 20.0
    arc = np.pi * (inner + outer) / 2
    s, r = (arc + stem) * x[:, 0], inner + (outer - inner) * x[:, 1]
    angle = np.pi * (1 - np.minimum(s, arc) / arc)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle) - np.maximum(s - arc, 0.0)])


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("coefficient", "cells"), [(0.3, (60, 6)), (0.8, (60, 6)), (1.0, (60, 6)), (1.0, (120, 8))]
)
def test_a_hook_that_slides_on_a_peg_is_solved_by_multigrid(
    tmp_path: Path, coefficient: float, cells: tuple[int, int]
) -> None:
    """Its few contact points wander about the peg with each set.

    With given limits, changed after each problem, the Lagrangian takes 160, 180, 584 and more
    operator applications. The fine hook takes 956 with steps that have to lower the last residual.
    """
    sides = {"bore": "sqrt(x**2 + y**2) < 8.06 and y > -1e-6", "end": "y < -19.999"}
    body = meshfiles.part(tmp_path / "hook.vtu", "triangle", cells, hooked, sides)
    peg = {"sphere": {"center": [0, 0], "radius": 8}}
    made = {
        "dimension": 2,
        "bodies": [body],
        "conditions": [
            {"on": "hook.end", "displacement": [0, None]},
            {"on": "hook.end", "traction": [0, -20]},
        ],
        "contacts": [{"on": "hook.bore", "obstacle": peg, "friction": {"coulomb": coefficient}}],
    }
    summary = solve(made, None, tolerance=1e-6, method="primal").summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] <= 60
    width = 16.0 - 8.05
    assert summary["contacts"][0]["force"][1] == pytest.approx(20 * width, rel=1e-3)


@pytest.mark.ratchet
def test_sets_that_fail_after_early_releases_give_way_to_newton() -> None:
    """A second run of the loop without such releases does not settle, either: 260 applications."""
    made = friction_scene(620069)[0]
    made["solver"]["method"] = "primal"
    summary = solve(made, None).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 200
