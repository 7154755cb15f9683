"""Contact of an undecomposed lattice by V-cycles and by factors, against other methods."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.driver import solve
from solver.primal.by_active_sets import solve_by_multigrid
from solver.primal.factor import FactorOptions
from solver.primal.merged import MergedSystem, merge
from solver.primal.products import multiply
from solver.primal.projector import Projector
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from solver.tfeti.dual import DualProblem
from solver.vectors import Array
from tests.solver.lattices import COLUMNS, ROWS, in_pieces, undecomposed
from tests.solver.tfeti.test_from_arrays import GAP, floor_force, reference

WIDTH = 3 * COLUMNS


def by_multigrid(problem: DualProblem, direct: bool) -> Solution:
    task = Task(problem, StoppingRule(1e-10), MPRGP(rtol=1e-11, max_iterations=10_000))
    cycles = FactorOptions(small=0.0, thin=math.inf)
    return solve_by_multigrid(task, None, None, FactorOptions() if direct else cycles)


def pressed(seed: int) -> tuple[float, Array]:
    """A load on the top, and gaps of the bottom, of which some are zero."""
    draw = np.random.default_rng(seed)
    return draw.uniform(0.001, 0.02), draw.uniform(0.0, 0.05, WIDTH + 1) * (draw.random() < 0.8)


@pytest.mark.parametrize("load", [0.004, 0.05])
def test_the_force_of_the_floor_is_that_of_bounded_least_squares(load: float) -> None:
    gaps = np.full(WIDTH, GAP)
    problem = undecomposed(WIDTH, lambda x: load * (x[:, 0] == WIDTH), gaps, (True, True))
    assert floor_force(problem) == pytest.approx(reference(load), rel=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_answers_of_bodies_that_a_floor_holds_are_those_of_total_feti(
    seed: int, direct: bool
) -> None:
    load, gaps = pressed(seed)

    def down(x: Array) -> Array:
        return load * (x[:, 1] == ROWS) * (x[:, 0] % COLUMNS == 1)

    answer = by_multigrid(undecomposed(WIDTH, down, gaps, (True, False)), direct)
    glued = in_pieces(COLUMNS, 3, down, gaps, (True, False))
    expected = solve(glued, SolverOptions(tolerance=1e-10))
    assert answer.converged
    assert answer.method == "primal"
    assert answer.measures.energy == pytest.approx(expected.measures.energy, rel=1e-8)


@pytest.fixture(scope="module")
def system() -> MergedSystem:
    gaps = np.full(WIDTH, GAP)
    return merge(undecomposed(WIDTH, lambda x: 0.01 * x[:, 1], gaps, (True, True)))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 1.0))
def test_the_projector_leaves_active_rows_unchanged(
    system: MergedSystem, seed: int, share: float
) -> None:
    """Π Π = Π, C Π = 0 in the active rows, and the products of Π and Πᵀ agree."""
    draw = np.random.default_rng(seed)
    active = draw.random(len(system.rows)) < share
    x, y = draw.standard_normal((2, system.size))
    projector = Projector(system, active)
    projected = projector.apply(x)
    np.testing.assert_allclose(multiply(system.C, projected)[active], 0.0, atol=1e-9)
    np.testing.assert_allclose(projector.apply(projected), projected, atol=1e-9)
    assert y @ projected == pytest.approx(projector.apply_transpose(y) @ x, abs=1e-9)
