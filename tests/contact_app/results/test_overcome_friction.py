"""Answers in which friction does not hold the loads: `contact_app.results.overcome_friction`."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import contact_app
from contact_app.errors import NoEquilibriumError
from contact_app.machine.exits import Exit
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from solver.tfeti.friction_share import overcome
from tests import scenes

FRICTION, PULL = 0.3, 1.0


def block_in_a_slot(**of_contacts: object) -> scenes.Config:
    """A block of width one between two walls without play, pulled along them."""

    def wall(x: float, normal: float) -> scenes.Config:
        obstacle = {"plane": {"point": [x, 0], "normal": [normal, 0]}}
        return {"obstacle": obstacle, "friction": {"coulomb": FRICTION}, **of_contacts}

    return {
        "dimension": 2,
        "bodies": [scenes.box("block", [1, 2], [2, 4])],
        "conditions": [{"on": "block.y+", "traction": [0, PULL]}],
        "contacts": [{"on": "block.x-", **wall(0, 1)}, {"on": "block.x+", **wall(1, -1)}],
    }


@pytest.mark.parametrize("interference", [0.0, 0.00046], ids=["unpressed", "pressed too little"])
def test_a_block_in_a_slot_slides_with_a_warning(interference: float) -> None:
    """The pull makes the block narrower, but the test before the solve lets both walls press.

    With the interference friction holds 0.94 of the pull.
    """
    answer = contact_app.solve(block_in_a_slot(interference=interference))
    assert not answer.converged
    told = [w for w in answer.summary["certificate"]["warnings"] if "friction at the" in w]
    assert len(told) == 1
    assert "does not stop block from leaving along +y" in told[0]


def test_the_share_is_that_of_the_friction_forces_at_their_limit() -> None:
    """Pressed walls hold the block; with a part of their forces, that part of the limits."""
    solved = solve_scene(scenes.build(block_in_a_slot(interference=0.002)))
    problem, solution = solved.model.problem, solved.solution
    assert solution.converged
    assert overcome(problem, solution) == []
    pressing = float(problem.friction.pressing(solution.multiplier).sum())
    assert FRICTION * pressing > PULL
    part = 0.25 * PULL / (FRICTION * pressing)
    (found,) = overcome(problem, replace(solution, multiplier=part * solution.multiplier))
    assert found.share == pytest.approx(0.25, rel=1e-5)
    assert list(found.bodies) == [0]
    (found,) = overcome(problem, solution, 1.01 * FRICTION * pressing / PULL)
    assert found.share == pytest.approx(1.0 / 1.01, rel=1e-5)
    assert abs(found.motion[1]) > 0.99


def turned_block(moment: float) -> scenes.Config:
    """A block of weight 1 on a rough floor, turned about the normal by a moment over μ."""
    return scenes.config(
        "hexahedron",
        [scenes.box("block", [1, 1, 0.5], [4, 4, 2])],
        [
            {"in": "block", "force": [0, 0, -2]},
            {
                "on": "block.z+", "at": [0.5, 0.5, 0.5], "total_force": [0, 0, 0],
                "total_moment": [0, 0, FRICTION * moment],
            },
        ],
        [
            {
                "on": "block.z-", "friction": {"coulomb": FRICTION},
                "obstacle": scenes.plane("hexahedron", (0, 0, 0), (0, 0, 1)),
            }
        ],
    )  # fmt: skip


def test_a_block_turned_in_a_history_ends_it_with_the_factor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The moment grows to 0.41 μ W; it turns the block from 0.38 to 0.4 on."""
    made = turned_block(0.41)
    assert run(scenes.build(made), tmp_path) == Exit.NO_EQUILIBRIUM
    made["conditions"][1]["name"] = "turn"
    made["steps"] = [{"turn": 1, "increments": 4}]
    assert run(scenes.build(made), tmp_path) == Exit.NO_EQUILIBRIUM
    told = capsys.readouterr().err.splitlines()[-1]
    said = re.match(r"step 1, between its factors (\S+) and (\S+): .* along a turn about z", told)
    assert said is not None, told
    assert 0.37 < 0.41 * float(said[1]) < 0.41 * float(said[2]) < 0.41
    records = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert [record["certificate"]["passed"] for record in records[:-1]] == [True] * (
        len(records) - 1
    )
    assert "--resume goes on from there" in told


def test_a_turned_block_slides_below_the_limit_of_rigid_equilibrium() -> None:
    """Pressed at its corners alone it could carry √½ μ W, but its pressure is nearly uniform.

    A uniform one carries 0.38 μ W.
    """
    assert contact_app.solve(turned_block(0.36)).converged
    answer = contact_app.solve(turned_block(0.41))
    assert not answer.converged
    told = [w for w in answer.summary["certificate"]["warnings"] if "friction at the" in w]
    assert len(told) == 1
    assert "does not stop block from leaving along a turn about z" in told[0]
    with pytest.raises(NoEquilibriumError, match="leaving along a turn about z"):
        contact_app.solve(turned_block(1.01 * 0.5**0.5))
