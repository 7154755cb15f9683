"""MPRGP: published counts, the paper's bookkeeping, every kind of operator, failures."""

import tracemalloc

import numpy as np
import pytest
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from solver import MPRGP, BoxQP, Reason, Step, expansion_names
from solver.qp.expansion import ProjectedLineSearch
from solver.qp.iterate import Iterate
from tests.solver.qp.problems import ALL, kkt_residual, membrane, random_hessian, string_obstacle


@pytest.mark.parametrize(
    ("expansion", "alpha_u", "counts"),
    [("fixed", 2.0, (200, 156, 18, 7)), ("projcg", 1.9, (175, 134, 14, 12))],
)
def test_string_obstacle_takes_the_counts_of_permon(expansion, alpha_u, counts):
    """Source: PERMON 3.18 on Debian's PETSc, its example of a string over an obstacle."""
    A, b, lower = string_obstacle()
    result = MPRGP(expansion, alpha_u, rtol=1e-5).solve(BoxQP(A, b, lower=lower))
    found = result.counts
    assert (found.hessian, found.cg, found.expansion, found.proportioning) == counts
    assert 0.5 * result.x @ (A @ result.x) - b @ result.x == pytest.approx(-0.2917673, abs=5e-8)


def test_every_name_of_the_paper_is_known():
    assert set(expansion_names()) == set(ALL)


@pytest.mark.parametrize("expansion", ALL)
def test_products_add_up_as_in_table_1(expansion):
    result = MPRGP(expansion).solve(membrane(12))
    counts = result.counts
    each = 3 if expansion.endswith("-opt") else 2
    assert result.converged
    assert counts.expansion > 0
    assert counts.hessian == 1 + counts.cg + each * counts.expansion + counts.proportioning
    assert counts.inner == len(result.history) - 1


@pytest.mark.ratchet
def test_without_bounds_it_is_the_conjugate_gradient_method():
    rng = np.random.default_rng(1)
    A = random_hessian(rng, np.linspace(1.0, 5.0, 5).repeat(4))
    b = rng.standard_normal(20)
    result = MPRGP(rtol=1e-12).solve(BoxQP(A, b))
    assert result.counts.hessian == 1 + result.counts.cg
    assert result.counts.cg <= 5  # as many steps as different eigenvalues
    np.testing.assert_allclose(result.x, np.linalg.solve(A, b), rtol=1e-10)


class _Shell:
    def __init__(self, A):
        self.A = A

    def mult(self, mat, x, y):
        y.setArray(self.A @ x.getArray(readonly=True))


@pytest.mark.parametrize(
    "kind", ["sparse", "matrix", "linear operator", "petsc", "dense petsc", "shell"]
)
def test_every_kind_of_matrix_gives_the_same_answer(kind):
    rng = np.random.default_rng(2)
    A = random_hessian(rng, np.geomspace(1.0, 100.0, 15))
    b, lower = rng.standard_normal(15), np.full(15, -0.05)
    expected = MPRGP().solve(BoxQP(A, b, lower))
    matrix = {
        "sparse": lambda: sparse.coo_matrix(A),
        "matrix": lambda: A.tolist(),
        "linear operator": lambda: LinearOperator(A.shape, matvec=lambda x: A @ x),
        "petsc": lambda: PETSc.Mat().createAIJ(A.shape, csr=_csr(A), comm=PETSc.COMM_SELF),
        "dense petsc": lambda: PETSc.Mat().createDense(A.shape, array=A, comm=PETSc.COMM_SELF),
        "shell": lambda: _shell(A),
    }[kind]()
    result = MPRGP().solve(BoxQP(matrix, b, lower))
    assert result.counts == expected.counts
    np.testing.assert_allclose(result.x, expected.x, atol=1e-12)


def _csr(A):
    S = sparse.csr_matrix(A)
    return S.indptr.astype(PETSc.IntType), S.indices.astype(PETSc.IntType), S.data


def _shell(A):
    mat = PETSc.Mat().createPython(A.shape, _Shell(A), comm=PETSc.COMM_SELF)
    mat.setUp()
    return mat


def test_the_answer_comes_as_the_kind_that_b_was():
    A = sparse.identity(4, format="csr")
    b = PETSc.Vec().createWithArray(np.arange(4.0), comm=PETSc.COMM_SELF)
    result = MPRGP().solve(BoxQP(A, b, upper=2.0))
    assert isinstance(result.x, PETSc.Vec)
    np.testing.assert_array_equal(result.x.getArray(), [0.0, 1.0, 2.0, 2.0])


def test_monitor_gets_every_step_and_can_stop():
    steps: list[Step] = []
    result = MPRGP().solve(membrane(8), monitor=steps.append)
    assert steps == result.history
    assert [s.type for s in steps[:1]] == ["start"]
    assert {s.type for s in steps[1:]} <= {"cg", "expansion", "proportioning"}
    assert [s.iteration for s in steps] == list(range(len(steps)))
    stopped = MPRGP().solve(membrane(8), monitor=lambda step: step.iteration == 3)
    assert stopped.reason is Reason.STOPPED
    assert not stopped.converged
    assert len(stopped.history) == 4


def test_an_expansion_can_be_passed_as_an_object():
    mine = ProjectedLineSearch("mine", along="gr", measure="gf", alpha_u=1.5)
    assert MPRGP(mine).solve(membrane(8)).converged


def test_unknown_expansion_is_an_error_that_lists_the_names():
    with pytest.raises(ValueError, match="projgc.*projcg-safe"):
        MPRGP("projgc").solve(membrane(3))
    with pytest.raises(ValueError, match="alpha_u is 2.5"):
        MPRGP("fixed", 2.5).solve(membrane(3))


@pytest.mark.parametrize("expansion", ALL)
@pytest.mark.parametrize(("time", "length"), [(2.0**20, 1.0), (1.0, 2.0**-30), (2.0**-10, 2.0**40)])
def test_units_change_nothing(expansion, time, length):
    """A by t and lengths by s: the same counts to the last one (powers of two round nothing)."""
    A, b, lower = string_obstacle(40)
    upper = np.full(40, 0.5)
    plain = MPRGP(expansion).solve(BoxQP(A, b, lower, upper))
    scaled = MPRGP(expansion).solve(
        BoxQP(time * A, time * length * b, length * lower, length * upper)
    )
    assert scaled.counts == plain.counts
    np.testing.assert_array_equal(scaled.x, length * plain.x)


class _Jacobi:
    def __init__(self, diagonal):
        self.diagonal = diagonal

    def apply(self, r, free_mask, out):
        np.divide(r, self.diagonal, out=out)


@pytest.mark.parametrize("expansion", ["fixed", "projcg", "projcg-safe", "gfgf-opt"])
@pytest.mark.ratchet
def test_preconditioning_in_the_face_pays_and_finds_the_same_point(expansion):
    rng = np.random.default_rng(3)
    scale = np.geomspace(1.0, 1e3, 60)
    A = scale[:, None] * random_hessian(rng, np.linspace(1.0, 3.0, 60)) * scale
    b = scale * rng.standard_normal(60)
    lower = -0.3 / scale
    qp = BoxQP(A, b, lower)
    plain = MPRGP(expansion, rtol=1e-8).solve(qp)
    preconditioned = MPRGP(expansion, rtol=1e-8, preconditioner=_Jacobi(np.diag(A))).solve(qp)
    assert preconditioned.converged
    assert preconditioned.counts.hessian < 0.7 * plain.counts.hessian
    assert kkt_residual(A, b, preconditioned.x, lower) <= 1.01e-8 * np.linalg.norm(b)


@pytest.mark.parametrize("expansion", ["fixed", "projcg", "projcg-safe", "gfgr-opt"])
def test_no_vector_is_allocated_in_the_loop(expansion):
    n = 200_000
    diagonal = np.linspace(1.0, 50.0, n)

    class Diagonal:
        from mpi4py import MPI

        comm, size = MPI.COMM_SELF, n

        def apply(self, x, out):
            np.multiply(diagonal, x, out=out)

    qp = BoxQP(Diagonal(), np.sin(np.arange(n)), lower=-0.01, upper=0.02)
    solver = MPRGP(expansion, rtol=1e-10, norm=50.0)
    it = Iterate(qp, norm=50.0)
    it.measure_b()
    solver.strategy.prepare(it)
    it.evaluate()
    tracemalloc.start()
    reason = solver.minimise(
        it, lambda it: Reason.CONVERGED if it.projected_gradient_norm < 1e-8 else None
    )
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert reason is Reason.CONVERGED
    assert it.counts.expansion > 0
    assert peak < n  # bytes: an eighth of one vector


def test_a_rerun_from_the_solution_needs_one_product():
    qp = membrane(8)
    first = MPRGP().solve(qp)
    assert MPRGP().solve(qp, first.x).counts.hessian == 1


def test_a_solve_from_zero_can_do_without_its_first_product():
    qp = membrane(8)
    usual, spared = MPRGP().solve(qp), MPRGP().solve(qp, from_zero=True)
    assert spared.counts.hessian == usual.counts.hessian - 1
    np.testing.assert_array_equal(spared.x, usual.x)
