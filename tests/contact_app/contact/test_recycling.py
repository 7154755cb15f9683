"""Directions of one face serve on the next: they lie in it, they are exact, and they save work."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.model import build_model
from contact_app.run.solve import solve_scene
from contact_app.studies.failing_scenes import locking
from solver import MPRGP
from solver.tfeti import recycling
from solver.tfeti.active_set_problem import ActiveSetProblem
from solver.tfeti.dual import DualProblem
from solver.tfeti.recycling import Directions, Recycled
from tests import scenes

TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    """A nearly incompressible block in four parts, whose F is ill-conditioned."""
    return build_model(scenes.build(locking(0.4999), [2, 2]), MPI.COMM_WORLD).problem


def closed(problem: DualProblem, count: int) -> NDArray[np.bool_]:
    """The first contact rows."""
    touching = np.zeros(problem.size, bool)
    touching[np.flatnonzero(problem.inequality)[:count]] = True
    return touching


def solved(face: ActiveSetProblem) -> tuple[NDArray[np.float64], int]:
    """The face's multiplier and the products it took."""
    face.solve(MPRGP(max_iterations=500), TOLERANCE, None)
    state = face.state()
    return state.multiplier, face.counts.hessian


@pytest.mark.parametrize("count", [10, 14])
def test_a_face_that_knows_directions_finds_the_same_multiplier_sooner(
    problem: DualProblem, count: int
) -> None:
    """Of two faces before it; two rows have opened since, or two have closed."""
    directions = Directions(problem)
    near = None
    for before in (16, 12):
        near, _ = solved(ActiveSetProblem(problem, closed(problem, before), near, directions))
    alone, all_products = solved(ActiveSetProblem(problem, closed(problem, count), near))
    found, products = solved(ActiveSetProblem(problem, closed(problem, count), near, directions))
    assert found == pytest.approx(alone, abs=1e-6 * np.abs(alone).max())
    assert products < all_products / 2


def test_what_directions_change_stays_in_the_face_and_is_the_best(problem: DualProblem) -> None:
    """It keeps open rows empty and equilibrium, and leaves a residual orthogonal to the rest."""
    directions = Directions(problem)
    near, _ = solved(ActiveSetProblem(problem, closed(problem, 16), None, directions))
    touching = closed(problem, 13)
    glued = problem.with_active(touching, near)
    np.testing.assert_allclose(glued.d, glued.residual(glued.free_displacements))
    recycled = Recycled(directions, touching)
    change, motion = recycled.best(glued.rhs)
    size = np.abs(change).max()
    assert size > 0.0
    assert not change[problem.inequality & ~touching].any()
    assert problem.coarse is not None
    moved = np.empty_like(problem.e)
    problem.coarse.restrict(change, moved)
    assert np.abs(moved).max() < 1e-10 * size

    product = np.empty(problem.size)
    problem.B.apply(motion, product)
    exact = np.empty(problem.size)
    problem.F.apply(change, exact)
    assert product == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())
    again, _ = recycled.best(glued.beginning_at(change, motion).rhs)
    assert np.abs(again).max() < 1e-6 * size

    z = np.random.default_rng(0).normal(size=problem.size) * (~problem.inequality | touching)
    recycled.orthogonalise(z)
    problem.F.apply(z, product)
    assert abs(change @ product) < 1e-7 * np.linalg.norm(change) * np.linalg.norm(product)


def test_near_incompressibility_takes_half_the_products(monkeypatch: pytest.MonkeyPatch) -> None:
    """The active sets change a few rows a face; what one learnt the next needs not learn again."""

    def products() -> int:
        summary: dict[str, Any] = solve_scene(scenes.build(locking(0.4999), [2, 2])).summary
        assert summary["certificate"]["passed"]
        return int(summary["solver"]["hessian_multiplications"])

    recycled = products()
    monkeypatch.setattr(recycling, "BYTES", 0)
    assert recycled < 0.6 * products()


def test_directions_that_are_not_light_are_kept_once_a_face_is_hard(
    problem: DualProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first face keeps those after its first steps, the next all of its own."""
    monkeypatch.setattr(recycling, "LIGHT", 0)
    directions = Directions(problem)
    first, second = (closed(problem, count) for count in (16, 12))
    near, products = solved(ActiveSetProblem(problem, first, None, directions))
    steps = products - 1  # the right-hand side is the other
    assert steps > recycling.EASY
    assert directions.kept == steps - recycling.EASY
    _, products = solved(ActiveSetProblem(problem, second, near, directions))
    assert directions.kept == steps - recycling.EASY + products - 1

    easy = Directions(problem)
    ActiveSetProblem(problem, first, None, easy).solve(
        MPRGP(max_iterations=recycling.EASY), TOLERANCE, None
    )
    assert easy.kept == 0
