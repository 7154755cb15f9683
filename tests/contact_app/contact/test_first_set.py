"""The first set: a level with springs on its contact rows comes to its minimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from solver.primal.spring_levels import DenseLevel, FirstSetOptions, Rows


@pytest.mark.parametrize("full", [0.0, 1.0])
def test_a_dense_level_is_solved_to_its_minimum(full: float) -> None:
    """Rows multiplied as a full matrix and as a sparse one; half of them start closed."""
    rng, n, m = np.random.default_rng(1), 30, 40
    root = rng.standard_normal((n, n))
    A = sparse.csr_matrix(root @ root.T + np.eye(n))
    Q = sparse.csr_matrix(rng.standard_normal((m, n)) * (rng.random((m, n)) < 0.3))
    c = np.where(np.arange(m) % 2, 0.0, 0.02)
    stiff, equality = rng.uniform(50.0, 100.0, m), np.arange(m) < 3
    rows = Rows(MPI.COMM_SELF, c, ~equality, equality, stiff)
    load, options = 10.0 * rng.standard_normal(n), replace(FirstSetOptions(), full=full)
    level = DenseLevel(rows, A, Q, load, options)
    x = level.minimise(np.zeros(n), options.exact_steps)
    jump = Q @ x - c
    pressed = equality | (jump > 0.0)
    assert 3 < pressed.sum() < m - 3
    tensions = stiff * np.where(pressed, 1.0, options.faint) * jump
    np.testing.assert_allclose(A @ x + level.near * x + Q.T @ tensions, load, atol=1e-9)
    np.testing.assert_array_equal(level.pressed(x), pressed & ~equality)
