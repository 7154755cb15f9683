"""Each body is certified by its own sizes: weak beside strong, stiff on soft, moved far.

An earlier version certified a wrong answer of every scene here, or did not certify a right one.
"""

import math
from typing import Any

import pytest

from contact_app.run.solve import solve_scene
from solver.problem.certify import certify
from solver.qp.result import Reason
from tests import scenes
from tests.comparison import solve


def box(name: str, lower: list[float], upper: list[float], cells: list[int], **material: float):
    material = {"young": 1.0e5, "poisson": 0.3, **material}
    mesh = {"box": {"lower": lower, "upper": upper, "cells": cells}}
    return {"name": name, "mesh": mesh, "material": material}


def plane(point: list[float], normal: list[float]) -> dict[str, Any]:
    return {"plane": {"point": point, "normal": normal}}


def beside(weak: float) -> scenes.Config:
    """A cantilever bent onto a floor by a small traction, and a block that is pulled hard."""
    small = box("small", [10, 0, 0], [14, 1, 1], [20, 5, 5])
    big = box("big", [0, 0, 0], [1, 1, 1], [4, 4, 4])
    floor = plane([0, -1e-4 * weak, 0], [0, 1, 0])
    return {
        "dimension": 3,
        "bodies": [big, small],
        "conditions": [
            {"on": "small.x-", "displacement": [0, 0, 0]},
            {"on": "small.y+", "traction": [0, -weak, 0]},
            {"on": "big.y-", "displacement": [0, 0, 0]},
            {"on": "big.y+", "traction": [0, 1000, 0]},
        ],
        "contacts": [{"on": "small.y-", "obstacle": floor}],
    }


def test_an_error_of_the_weak_body_is_measured_and_named() -> None:
    solved = solve(beside(1e-6), [4, 2, 2], tolerance=1e-8)
    problem, answer = solved.model.problem, solved.solution
    assert answer.certificate.passed
    wrong = [u.copy() for u in answer.displacements]
    for u, body in zip(wrong, problem.bodies.members, strict=True):
        u[:, body == 1] *= 1.01
    seen, measures = certify(problem, answer.multiplier, wrong, 1e-8)
    assert not seen.passed
    assert seen.deciding(1e-8) == 1
    assert seen.duality_gap > 1e-6
    assert measures.gap < 1e-10 * abs(measures.energy), (
        "relative to the strong body the error would be hidden"
    )
    assert seen.required_reduction(1e-8) > 10.0


def on_rubber(cell: str = "hexahedron") -> scenes.Config:
    """Steel on rubber, between walls that keep it from spreading."""
    steel = box("steel", [0, 0, 0], [2, 2, 2], [4, 4, 4], young=2.1e5)
    rubber = box("rubber", [-1, -1, -1], [3, 3, 0], [4, 4, 2], young=1.0, poisson=0.4)
    walls = {
        "x+": plane([2, 0, 0], [-1, 0, 0]),
        "x-": plane([0, 0, 0], [1, 0, 0]),
        "y-": plane([0, 0, 0], [0, 1, 0]),
        "y+": plane([0, 2, 0], [0, -1, 0]),
    }
    return {
        "dimension": 3,
        "bodies": [rubber, steel],
        "conditions": [
            {"on": "rubber.z-", "displacement": [0, 0, 0]},
            {"on": "steel.z+", "traction": [0, 0, -0.01]},
        ],
        "contacts": [{"on": f"steel.{side}", "obstacle": wall} for side, wall in walls.items()]
        + [{"on": "steel.z-", "against": "rubber.z+"}],
    }


def test_groups_are_bodies_that_pairs_connect() -> None:
    made = on_rubber()
    made["bodies"].append(box("apart", [20, 0, 0], [21, 1, 1], [2, 2, 2]))
    made["conditions"] += [
        {"on": "apart.x-", "displacement": [0, 0, 0]},
        {"on": "apart.x+", "traction": [1e-3, 0, 0]},
    ]
    solved = solve(made, tolerance=1e-6)
    bodies, measures = solved.model.problem.bodies, solved.solution.measures
    assert bodies.groups[0] == bodies.groups[1] != bodies.groups[2]
    assert measures.gaps.shape == (2,)
    pairs = bodies.rows[bodies.rows[:, 0] != bodies.rows[:, 1]]
    assert len(pairs) == (solved.model.problem.contact.sources == 4).sum() > 0
    assert solved.summary["certificate"]["decided_by"] in ("rubber", "steel", "apart")


def moved(squeeze: float) -> scenes.Config:
    """A block carried along and squeezed a little against a plane."""
    return {
        "dimension": 3,
        "bodies": [box("b", [0, 0, 0], [1, 1, 1], [4, 4, 4])],
        "conditions": [{"on": "b.z-", "displacement": [10.0, 0, 0.005]}],
        "contacts": [{"on": "b.z+", "obstacle": plane([0, 0, 1.005 - squeeze], [0, 0, -1])}],
    }


def test_results_without_correct_digits_are_not_certified() -> None:
    summary = solve(moved(3e-13)).summary
    certificate = summary["certificate"]
    assert not certificate["passed"]
    assert certificate["duality_gap"] > 1e-3
    assert any("rounding errors of its displacements" in w for w in certificate["warnings"])
    assert summary["accuracy"]["total"] is None


def test_an_unfinished_iteration_causes_no_warning_on_its_displacements() -> None:
    """They are no answer: units, places and rounding errors of the scene are not to blame."""
    solved = solve(moved(3e-13), [2, 2, 2], max_iterations=1)
    assert solved.solution.reason is Reason.MAX_ITERATIONS
    (warning,) = solved.summary["certificate"]["warnings"]
    assert warning.startswith("not certified: The limit of inner iterations was reached")


def test_contact_forces_of_rounding_errors_cause_a_warning() -> None:
    """A body squeezed by the last digits of its motion: its forces may be rounding errors."""
    summary = solve(moved(1e-14)).summary
    told = summary["certificate"]["warnings"]
    assert any("its contact forces" in w and "rounding errors" in w for w in told)
    assert summary["accuracy"]["total"] is None


def test_a_body_that_is_merely_moved_is_certified() -> None:
    made = moved(1.0)
    made["contacts"] = []
    for subdomains in (1, [2, 1, 1]):
        solved = solve(made, subdomains)
        assert solved.solution.certificate.passed
        (warning,) = solved.solution.certificate.warnings
        assert warning.startswith("b moves by 10, farther than it is large")
        assert solved.accuracy.total == 0.0


def test_nan_does_not_pass_the_certificate() -> None:
    certificate = solve(beside(1.0)).solution.certificate
    assert certificate.required_reduction(1e-6) <= 1.0
    broken = type(certificate)(0.0, 0.0, 0.0, 0.0, math.nan, 0.0, passed=False)
    assert not broken.judged(1.0).passed


@pytest.mark.parametrize("method", ["auto", "primal"])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_a_body_that_moves_rigidly_with_a_load_on_its_held_face(cell: str, method: str) -> None:
    """The support takes the load; without the load the answer is the same."""
    made = scenes.wall(cell, 3)
    up = f"block.{scenes.up(cell)}"
    made["conditions"] = [{"on": up, "displacement": scenes.vector(cell, 0.01, 0.02, -0.1)}]
    far = scenes.plane(cell, (0, 0, -5), (0, 0, 1))
    made["contacts"] = [{"on": f"block.{scenes.down(cell)}", "obstacle": far}]
    made["solver"]["method"] = method
    for load in ({}, {"on": up, "traction": scenes.vector(cell, 1, 0, -10)}):
        made["conditions"][1:] = [load] if load else []
        solved = solve_scene(scenes.build(made, 1))
        assert solved.solution.certificate.passed
        reaction = solved.summary["reactions"][0]["force"]
        assert reaction[0] == pytest.approx(-1.0 if load else 0.0, abs=1e-9)


def test_tensile_forces_of_an_early_set_are_no_equilibrium() -> None:
    """A plate that its held edge lifts off the floor: a set of the way has 75 times its energy."""
    plate = box("plate", [0, 0, 0], [180, 90, 1], [14, 7, 2], young=580.0, poisson=0.05)
    made = {
        "dimension": 3,
        "bodies": [plate],
        "conditions": [
            {"in": "plate", "force": [0, 0, -6.7e-7]},
            {"on": "plate.x-", "displacement": [0, 0, 0.022]},
        ],
        "contacts": [{"on": "plate.z-", "obstacle": plane([0, 0, 0], [0, 0, 1])}],
    }
    right = solve(made | {"solver": {"tolerance": 1e-8, "method": "active-set"}})
    loose = solve(made | {"solver": {"tolerance": "auto", "method": "primal"}})
    assert right.solution.certificate.passed
    assert loose.solution.certificate.passed
    energies = [one.summary["solution"]["energy"] for one in (loose, right)]
    assert energies[0] == pytest.approx(energies[1], rel=0.05)
