"""Scenes whose dual problem has no correct digits in subdomains are solved undecomposed."""

from typing import Any

import pytest

from contact_app.run.solve import solve_scene
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem
from tests import reference, scenes


def slab(dimension: int, cells: list[int], length: float) -> scenes.Config:
    """A held slab beside an oblique plane, of cells a hundred times longer than thick."""
    upper = [0.3, 1.5, length] if dimension == 3 else [0.3, length]
    plane = {"point": [0.3, 0.0, 0.0][:dimension], "normal": [-0.9, -0.3, -0.27][:dimension]}
    return {
        "title": "slab",
        "dimension": 3 if dimension == 3 else "plane_strain",
        "bodies": [scenes.box("b", upper, cells, young=50.0, poisson=0.43, degree=2)],
        "conditions": [
            {"on": "b.x-", "displacement": [-0.0002, -0.0008, 0.033][:dimension]},
            {"on": "b.y-", "traction": [-0.0015, 0.05, -0.016][:dimension]},
        ],
        "contacts": [{"on": "b.x+", "obstacle": {"plane": plane}}],
        "solver": {"tolerance": 1e-8},
    }


SLABS = [(3, [2, 2, 2], 200.0), (2, [4, 4], 300.0)]


@pytest.mark.parametrize(("dimension", "cells", "length"), SLABS)
def test_scenes_that_fail_in_subdomains_are_solved_undecomposed(
    dimension: int, cells: list[int], length: float
) -> None:
    scene = scenes.build(slab(dimension, cells, length), 4)
    summary = solve_scene(scene).summary
    assert summary["certificate"]["passed"]
    assert summary["decomposition"]["subdomains"] == 1
    assert "in 4 subdomains the answer could not be" in summary["certificate"]["warnings"][-1]
    known = reference.solve(scene).energy
    assert summary["solution"]["energy"] == pytest.approx(known, rel=1e-6)


def test_a_limit_on_steps_stays_one() -> None:
    made = slab(*SLABS[0])
    made["solver"]["max_iterations"] = 40
    summary = solve_scene(scenes.build(made, 4)).summary
    assert not summary["certificate"]["passed"]
    assert summary["decomposition"]["subdomains"] == 4
    assert summary["solver"]["cg_steps"] <= 40


def cantilever(tolerance: float) -> scenes.Config:
    """Clamped, bent by a pressure, of cells that are long and thin; no contact."""
    return {
        "dimension": 2,
        "bodies": [scenes.box("b", [30, 3], [24, 48], young=1.0)],
        "conditions": [
            {"on": "b.x+", "displacement": [0.0, 0.0]},
            {"on": "b.y+", "pressure": 0.0004},
        ],
        "contacts": [],
        "solver": {"tolerance": tolerance},
    }


def test_an_exception_of_the_solver_is_one_more_way_that_failed() -> None:
    """At a tolerance of twelve digits the dual problem loses its curvature; the body is clamped."""
    summary = solve_scene(scenes.build(cantilever(1e-12))).summary
    assert summary["certificate"]["passed"]
    assert summary["decomposition"]["subdomains"] == 1
    warning = summary["certificate"]["warnings"][-1]
    assert "could not be certified" in warning
    assert "unbounded" not in warning
    loose = solve_scene(scenes.build(cantilever(1e-6))).summary
    assert summary["solution"]["energy"] == pytest.approx(loose["solution"]["energy"], rel=1e-9)
    undecomposed = solve_scene(scenes.build(cantilever(1e-12), 1)).summary
    counts = [one["solver"]["hessian_multiplications"] for one in (undecomposed, summary)]
    assert counts[1] > counts[0] + 10, "the work before the exception counts"


def test_where_the_dual_methods_fail_in_one_piece_multigrid_follows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever they raise; the message is of the scene."""
    from contact_app.run import solve as run
    from solver.errors import UnboundedError

    scene = scenes.build(scenes.lifted_strip(60.0, [120, 2]), 1)
    known, solve = solve_scene(scene).summary, run.solve

    def fails_by_dual_methods(problem: DualProblem, *arguments: Any) -> Solution:
        if problem.factored:
            raise UnboundedError("the cost is unbounded below", 7)
        return solve(problem, *arguments)

    monkeypatch.setattr(run, "solve", fails_by_dual_methods)
    summary = solve_scene(scene).summary
    assert summary["certificate"]["passed"]
    assert summary["solution"]["energy"] == pytest.approx(known["solution"]["energy"], rel=1e-6)
    assert summary["solution"]["active_contacts"] == known["solution"]["active_contacts"]
    warning = summary["certificate"]["warnings"][-1]
    assert "strip is 60 times as long as thick" in warning
    assert "solved by multigrid instead" in warning
    assert "unbounded" not in warning


@pytest.mark.ratchet
def test_contact_rows_that_rounding_holds_up_are_given_up_early() -> None:
    """MPRGP would go on to the limit of steps, and the run would end without a certificate."""
    summary = solve_scene(scenes.build(scenes.lifted_strip(500.0, [400, 2]), 1)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] < 2000
