"""Search directions of one set on the next: they are admissible, exact, and save work."""

import numpy as np
import pytest
from mpi4py import MPI

from solver import MPRGP, Reason
from solver.backend import Statuses
from solver.contact.active_set import ActiveSetMethod
from solver.contact.retries import solve_with_retries
from solver.contact.solve_on_set import StoppingTest
from solver.tfeti.active_set_problem import ActiveSetProblem, State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.derived import beginning_at, with_active
from solver.tfeti.directions import Directions, RecyclingOptions
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.by_active_sets import initial_active_set
from solver.tfeti.recycling import Recycled
from solver.vectors import Array, Mask
from tests import scenes

TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    """A nearly incompressible block in four parts, whose F is ill-conditioned."""
    made = scenes.wall("quadrilateral", 16) | {"solver": {"tolerance": 1e-8}}
    made["bodies"][0]["material"]["poisson"] = 0.4999
    return scenes.problem(made, [2, 2], comm=MPI.COMM_WORLD)


def closed(problem: DualProblem, count: int) -> Mask:
    """The first contact rows."""
    touching = np.zeros(problem.size, bool)
    touching[np.flatnonzero(problem.inequality)[:count]] = True
    return touching


def solved(active_set: ActiveSetProblem) -> tuple[Array, int]:
    """Multiplier of an active set, and the number of products of its solve."""
    active_set.solve(MPRGP(max_iterations=500), TOLERANCE, None)
    state = active_set.state()
    return state.multiplier, active_set.counts.hessian


@pytest.mark.parametrize("count", [10, 14])
@pytest.mark.ratchet
def test_recycled_directions_find_the_same_multiplier_sooner(
    problem: DualProblem, count: int
) -> None:
    """Directions are of two earlier sets; two rows have opened since, or two have closed."""
    directions = Directions(problem.B, problem.conditional)
    near = None
    for before in (16, 12):
        near, _ = solved(
            ActiveSetProblem(problem, Statuses(closed(problem, before)), near, directions)
        )
    alone, all_products = solved(ActiveSetProblem(problem, Statuses(closed(problem, count)), near))
    found, products = solved(
        ActiveSetProblem(problem, Statuses(closed(problem, count)), near, directions)
    )
    assert found == pytest.approx(alone, abs=1e-6 * np.abs(alone).max())
    assert products < all_products / 2


def test_recycled_directions_keep_the_set_and_minimise_the_residual(problem: DualProblem) -> None:
    """Open rows stay without force, equilibrium holds, and the residual is orthogonal to the
    directions."""
    directions = Directions(problem.B, problem.conditional)
    near, _ = solved(ActiveSetProblem(problem, Statuses(closed(problem, 16)), None, directions))
    touching = closed(problem, 13)
    glued = with_active(problem, touching, near)
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
    again, _ = recycled.best(beginning_at(glued, change, motion).rhs)
    assert np.abs(again).max() < 1e-6 * size

    z = np.random.default_rng(0).normal(size=problem.size) * (~problem.inequality | touching)
    recycled.orthogonalise(z)
    problem.F.apply(z, product)
    assert abs(change @ product) < 1e-7 * np.linalg.norm(change) * np.linalg.norm(product)


@pytest.mark.ratchet
def test_near_incompressibility_takes_half_the_products(problem: DualProblem) -> None:
    """Sets differ in a few rows: directions of one set save operator applications on the next."""

    def products(options: RecyclingOptions) -> int:
        def required(state: State) -> float:
            return problem.largest_distance(state) / 1e-7

        test = StoppingTest(required, lambda state: required(state) <= 1.0)
        backend, start = TotalFeti(problem, options), initial_active_set(problem, None)
        method = ActiveSetMethod(backend, test, MPRGP(max_iterations=5000))
        found = solve_with_retries(method, start)
        assert found.reason is Reason.ACCEPTED
        return found.counts.hessian

    assert products(RecyclingOptions()) < 0.6 * products(RecyclingOptions(memory=0))


def test_expensive_directions_are_stored_once_a_set_takes_many_steps(problem: DualProblem) -> None:
    """The first set stores those after its first steps, the next all of its own."""
    options = RecyclingOptions(light=0)
    directions = Directions(problem.B, problem.conditional, options)
    first, second = (closed(problem, count) for count in (16, 12))
    near, products = solved(ActiveSetProblem(problem, Statuses(first), None, directions))
    steps = products - 1  # the right-hand side is the other
    assert steps > options.easy
    assert directions.stored == steps - options.easy
    _, products = solved(ActiveSetProblem(problem, Statuses(second), near, directions))
    assert directions.stored == steps - options.easy + products - 1

    easy = Directions(problem.B, problem.conditional, options)
    ActiveSetProblem(problem, Statuses(first), None, easy).solve(
        MPRGP(max_iterations=options.easy), TOLERANCE, None
    )
    assert easy.stored == 0
