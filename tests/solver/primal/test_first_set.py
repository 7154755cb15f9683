"""The first set: a level with springs on its contact rows comes to its minimum."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse
from scipy.sparse.linalg import spsolve

from solver.distributed import petsc_rows
from solver.primal.block_rows import BlockRows
from solver.primal.friction_springs import FrictionSprings
from solver.primal.hierarchy import Hierarchy, MultigridOptions
from solver.primal.spring_levels import CycleLevel, DenseLevel, FirstSetOptions, Rows

NO_POINTS, NO_VALUES = np.zeros(0, np.int64), np.zeros(0)

NO_FRICTION = FrictionSprings(*(NO_POINTS,) * 3, *(NO_VALUES,) * 3, acts=False)


@pytest.mark.parametrize("full", [0.0, 1.0])
def test_a_dense_level_is_solved_to_its_minimum(full: float) -> None:
    """Rows multiplied as a full matrix and as a sparse one; half of them start closed."""
    rng, n, m = np.random.default_rng(1), 30, 40
    root = rng.standard_normal((n, n))
    A = sparse.csr_matrix(root @ root.T + np.eye(n))
    Q = sparse.csr_matrix(rng.standard_normal((m, n)) * (rng.random((m, n)) < 0.3))
    c = np.where(np.arange(m) % 2, 0.0, 0.02)
    stiff, equality = rng.uniform(50.0, 100.0, m), np.arange(m) < 3
    rows = Rows(MPI.COMM_SELF, c, ~equality, equality, stiff, NO_FRICTION)
    load, options = 10.0 * rng.standard_normal(n), replace(FirstSetOptions(), full=full)
    level = DenseLevel(rows, A, Q, load, options)
    x = level.minimise(np.zeros(n), options.exact_steps)
    jump = Q @ x - c
    pressed = equality | (jump > 0.0)
    assert 3 < pressed.sum() < m - 3
    multiplier = stiff * np.where(pressed, 1.0, options.faint) * jump
    np.testing.assert_allclose(A @ x + level.shift * x + Q.T @ multiplier, load, atol=1e-9)
    np.testing.assert_array_equal(level.pressed(x), pressed & ~equality)


def test_a_slender_beam_lifts_off() -> None:
    """A beam pressed evenly on a floor and pulled up at one end, softer than the faint springs.

    These leave it on the floor, and proximal steps find the exact set.
    """
    n = 40
    bending = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], (n - 2, n))
    A = sparse.csr_matrix(100.0 * (bending.T @ bending))
    load = np.ones(n)  # downwards, as the rows point
    load[-1] -= 12.0
    every, stiff = np.ones(n, bool), np.full(n, 1e7)
    rows = Rows(MPI.COMM_SELF, np.zeros(n), every, ~every, stiff, NO_FRICTION)
    options = replace(FirstSetOptions(), proximal=1e-10)
    level = DenseLevel(rows, A, sparse.identity(n, format="csr"), load, options)
    x = level.minimise(np.zeros(n), options.exact_steps)
    pressed = level.pressed(level.without_faint_springs(x))
    springs = sparse.diags(np.where(pressed, stiff, 0.0))
    exact = spsolve(sparse.csc_matrix(A + springs), load)
    np.testing.assert_array_equal(pressed, exact > 0.0)
    assert pressed.sum() < 25
    assert level.pressed(level.minimise(np.zeros(n), 60)).sum() > 30


def test_a_light_body_comes_to_its_contact() -> None:
    """A loose chain under its weight, which even the fainter springs hold above a bent floor."""
    n = 20
    slopes = sparse.diags([-1.0, 1.0], [0, 1], (n - 1, n))
    A, load = sparse.csr_matrix(10.0 * (slopes.T @ slopes)), np.full(n, 1.0 / n)
    every, floor = np.ones(n, bool), 0.1 + 0.001 * (np.arange(n) - 12) ** 2
    rows = Rows(MPI.COMM_SELF, floor, every, ~every, np.full(n, 1e8), NO_FRICTION)
    level = DenseLevel(rows, A, sparse.identity(n, format="csr"), load, FirstSetOptions())
    x = level.without_faint_springs(level.minimise(np.zeros(n), 60))
    np.testing.assert_allclose(level.multiplier(x).sum(), load.sum(), rtol=1e-2)


def test_a_cycle_has_the_springs_of_rows_on_all_levels() -> None:
    """Twenty bars, held by nothing but the rows between them, take nine conjugate gradients."""
    bars, nodes, each = 20, 40, 4
    bar = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (nodes, nodes)).tolil()
    bar[0, 0] = bar[-1, -1] = 1.0
    A = sparse.block_diag([bar] * bars, format="csr")
    n, m = A.shape[0], bars - 1
    ends = nodes * np.arange(1, bars)
    Q = sparse.csr_matrix(
        (np.tile([1.0, -1.0], m), np.stack([ends - 1, ends], 1).ravel(), 2 * np.arange(m + 1)),
        (m, n),
    )
    A[0, 0] += 1.0  # the first bar is held
    P = sparse.kron(sparse.identity(n // each), np.ones((each, 1)), format="csr")
    comm, load = MPI.COMM_SELF, np.random.default_rng(2).standard_normal(n)
    stiff, every = np.full(m, 0.5), np.ones(m, bool)
    rows = Rows(comm, np.zeros(m), ~every, every, stiff, NO_FRICTION)
    operators = petsc_rows(comm, A, n), petsc_rows(comm, sparse.csr_matrix(P.T @ A @ P), n // each)
    hierarchy = Hierarchy((petsc_rows(comm, P, n // each),), operators, MultigridOptions())
    options = replace(FirstSetOptions(), reduction=1e-9, iterations=9)
    level = CycleLevel(rows, hierarchy, [BlockRows(comm, Q.tobsr((1, 1)), n)], load, options)
    K = sparse.csc_matrix(A + Q.T @ sparse.diags(stiff) @ Q)
    exact = spsolve(K, load)
    error = level.newton_step(stiff, load) - exact
    assert error @ (K @ error) < 1e-4 * (exact @ (K @ exact))
