"""The limited-memory preconditioner: symmetric, positive definite, and worth its vectors."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from solver import MPRGP, SMALBE, BoxQP
from solver.qp.memory import CurvatureMemory
from solver.vectors import Reduction
from tests.solver.qp.problems import kkt_residual, membrane, random_hessian


def matrix(memory: CurvatureMemory, free: np.ndarray) -> np.ndarray:
    """The preconditioner as a matrix on the free components."""
    n = free.size
    H = np.zeros((n, n))
    for i in np.flatnonzero(free):
        memory.apply(np.eye(n)[i], free, H[i])
    return H[np.ix_(free, free)]


@pytest.mark.parametrize("pairs", [1, 3, 8])
def test_it_is_symmetric_and_positive_definite_on_any_face(pairs):
    rng = np.random.default_rng(0)
    A = random_hessian(rng, np.geomspace(1.0, 1e3, 12))
    memory = CurvatureMemory(12, pairs, Reduction(MPI.COMM_SELF))
    for _ in range(10):
        p = rng.standard_normal(12)
        memory.observe(p, A @ p)
    free = np.arange(12) % 4 != 0
    memory.restart(free)
    H = matrix(memory, free)
    np.testing.assert_allclose(H, H.T, atol=1e-12 * np.abs(H).max())
    assert np.linalg.eigvalsh(H)[0] > 0.0


def test_enough_conjugate_pairs_make_the_inverse():
    rng = np.random.default_rng(1)
    A = random_hessian(rng, np.geomspace(1.0, 1e3, 6))
    memory = CurvatureMemory(6, 6, Reduction(MPI.COMM_SELF))
    for p in np.linalg.eigh(A)[1].T:
        memory.observe(p, A @ p)
    free = np.ones(6, dtype=bool)
    memory.restart(free)
    np.testing.assert_allclose(matrix(memory, free), np.linalg.inv(A), atol=1e-10)


@pytest.mark.ratchet
def test_it_saves_products_and_finds_the_same_point():
    rng = np.random.default_rng(2)
    A = random_hessian(rng, np.geomspace(1.0, 1e3, 150))
    lower, upper = -np.abs(rng.standard_normal(150)), np.abs(rng.standard_normal(150))
    b = A @ rng.standard_normal(150)
    for qp, matrix_ in ((BoxQP(A, b, lower, upper), A), (membrane(30), None)):
        plain, remembering = MPRGP(rtol=1e-8).solve(qp), MPRGP(rtol=1e-8, memory=8).solve(qp)
        assert remembering.converged
        assert remembering.counts.hessian < 0.8 * plain.counts.hessian
        np.testing.assert_allclose(remembering.x, plain.x, atol=1e-4 * np.abs(plain.x).max())
        if matrix_ is not None:
            residual = kkt_residual(matrix_, b, remembering.x, lower, upper)
            assert residual <= 1.1e-8 * np.linalg.norm(b)


def test_it_starts_from_another_preconditioner():
    rng = np.random.default_rng(3)
    scale = np.geomspace(1.0, 1e3, 60)
    A = scale[:, None] * random_hessian(rng, np.linspace(1.0, 9.0, 60)) * scale
    qp = BoxQP(A, scale * rng.standard_normal(60), lower=-0.3 / scale)

    class Jacobi:
        def apply(self, r, free_mask, out):
            np.divide(r, np.diag(A), out=out)

    alone = MPRGP(rtol=1e-8, memory=5).solve(qp)
    both = MPRGP(rtol=1e-8, memory=5, preconditioner=Jacobi()).solve(qp)
    assert both.converged
    assert both.counts.hessian < alone.counts.hessian


def test_smalbe_passes_it_on():
    rng = np.random.default_rng(4)
    A = random_hessian(rng, np.geomspace(1.0, 1e3, 60))
    qp = BoxQP(A, 10.0 * rng.standard_normal(60), lower=0.0)
    C = rng.standard_normal((5, 60))
    c = C @ np.abs(rng.standard_normal(60))
    plain = SMALBE(MPRGP(rtol=1e-8)).solve(qp, C, c)
    remembering = SMALBE(MPRGP(rtol=1e-8, memory=8)).solve(qp, C, c)
    assert remembering.converged
    assert remembering.counts.hessian < plain.counts.hessian
    np.testing.assert_allclose(remembering.x, plain.x, atol=1e-4)


def test_anticipated_expansions_take_one_product():
    """With a memory the product that finds out that CG would leave the box is saved."""
    qp = membrane(20)
    counts = MPRGP(memory=5).solve(qp).counts
    assert counts.expansion > 0
    full = 1 + counts.cg + 2 * counts.expansion + counts.proportioning
    assert full - counts.expansion <= counts.hessian < full


def test_units_change_nothing():
    qp = membrane(12)
    plain = MPRGP(memory=4).solve(qp)
    A = 2.0**15 * qp.operator.matrix
    scaled = MPRGP(memory=4).solve(BoxQP(A, 2.0**-5 * qp.b, lower=2.0**-20 * qp.lower))
    assert scaled.counts == plain.counts
    np.testing.assert_array_equal(scaled.x, 2.0**-20 * plain.x)
