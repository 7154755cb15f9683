"""SMALBE-M: bounds and equalities, multipliers, update rules, the caller's own test."""

import numpy as np
import pytest
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from solver import MPRGP, SMALBE, BoxQP, OuterState, QPError, Reason
from tests.solver.qp.problems import kkt_residual, random_hessian


def problem(seed=0, n=40, m=6):
    rng = np.random.default_rng(seed)
    A = random_hessian(rng, np.geomspace(1.0, 1e3, n))
    C = rng.standard_normal((m, n))
    c = C @ np.maximum(0.0, rng.standard_normal(n))
    return A, 10.0 * rng.standard_normal(n), C, c


def check(A, b, C, c, result, tolerance=1e-5):
    assert result.converged
    assert (result.x >= 0.0).all()
    assert np.linalg.norm(C @ result.x - c) <= tolerance * np.linalg.norm(c)
    right = b - C.T @ result.multiplier
    assert kkt_residual(A, right, result.x, np.zeros(b.size)) <= 1e-5 * np.linalg.norm(b)


RULES = {"default": SMALBE, "paper": SMALBE.paper}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("expansion", ["projcg", "projcg-safe", "fixed", "gfgf-opt"])
def test_kkt_point_with_multiplier(rule, expansion):
    A, b, C, c = problem()
    result = RULES[rule](MPRGP(expansion, rtol=1e-7)).solve(BoxQP(A, b, lower=0.0), C, c)
    check(A, b, C, c, result)
    assert result.counts.outer > 0


@pytest.mark.parametrize("seed", range(4))
def test_default_needs_fewer_products_than_the_published_rule(seed):
    A, b, C, c = problem(seed)
    qp = BoxQP(A, b, lower=0.0)
    default, paper = (
        RULES[rule](MPRGP("projcg-safe")).solve(qp, C, c).counts.hessian for rule in RULES
    )
    assert default < paper


def test_products_add_up_with_one_an_outer_iteration_as_the_paper_counts():
    A, b, C, c = problem()
    counts = SMALBE.paper().solve(BoxQP(A, b, lower=0.0), C, c).counts
    steps = counts.cg + 2 * counts.expansion + counts.proportioning
    assert counts.hessian == counts.outer + steps
    counts = SMALBE().solve(BoxQP(A, b, lower=0.0), C, c).counts
    steps = counts.cg + 2 * counts.expansion + counts.proportioning
    assert counts.hessian == 1 + steps


@pytest.mark.parametrize("kind", ["sparse", "linear operator", "petsc"])
def test_every_kind_of_equalities(kind):
    A, b, C, c = problem()
    expected = SMALBE().solve(BoxQP(A, b, lower=0.0), C, c)
    S = sparse.csr_matrix(C)
    matrix = {
        "sparse": lambda: S,
        "linear operator": lambda: LinearOperator(
            C.shape, matvec=lambda x: C @ x, rmatvec=lambda y: C.T @ y, dtype=float
        ),
        "petsc": lambda: PETSc.Mat().createAIJ(
            C.shape,
            csr=(S.indptr.astype(PETSc.IntType), S.indices.astype(PETSc.IntType), S.data),
            comm=PETSc.COMM_SELF,
        ),
    }[kind]()
    result = SMALBE().solve(BoxQP(A, b, lower=0.0), matrix, c)
    np.testing.assert_allclose(result.x, expected.x, atol=1e-8)


@pytest.mark.parametrize(
    ("t", "s", "r"), [(2.0**12, 1.0, 1.0), (1.0, 2.0**20, 1.0), (1.0, 1.0, 2.0**-15)]
)
def test_units_change_nothing(t, s, r):
    """Hessian by t, lengths by s, equalities by r: the same counts."""
    A, b, C, c = problem()
    plain = SMALBE().solve(BoxQP(A, b, lower=0.0, upper=2.0), C, c)
    scaled = SMALBE().solve(BoxQP(t * A, t * s * b, 0.0, 2.0 * s), r * C, r * s * c)
    assert scaled.counts == plain.counts
    np.testing.assert_allclose(scaled.x, s * plain.x, rtol=1e-12)
    np.testing.assert_allclose(scaled.multiplier, t * s / r * plain.multiplier, rtol=1e-9)


def test_the_callers_test_alone_decides():
    A, b, C, c = problem()
    seen: list[int] = []

    def accept(state: OuterState) -> bool:
        seen.append(state.iteration)
        np.testing.assert_allclose(state.residual, C @ state.x - c, atol=1e-9)
        np.testing.assert_allclose(
            state.gradient, A @ state.x - b + C.T @ state.next_multiplier, atol=1e-6
        )
        np.testing.assert_allclose(
            state.transposed_multiplier, C.T @ state.next_multiplier, atol=1e-6
        )
        return state.residual_norm < 1e-11 * np.linalg.norm(c)

    result = SMALBE(MPRGP(rtol=1e-2)).solve(BoxQP(A, b, lower=0.0), C, c, accept=accept)
    assert result.reason is Reason.ACCEPTED
    assert result.counts.outer == len(seen)
    assert result.equality_residual < 1e-11 * np.linalg.norm(c)


def test_monitor_counts_outer_iterations_and_can_stop():
    A, b, C, c = problem()
    qp = BoxQP(A, b, lower=0.0)
    result = SMALBE().solve(qp, C, c)
    assert {step.outer for step in result.history} == set(range(1, result.counts.outer + 1))
    iterations = [step.iteration for step in result.history]
    assert iterations == sorted(iterations)
    stopped = SMALBE().solve(qp, C, c, monitor=lambda step: step.outer == 2)
    assert stopped.reason is Reason.STOPPED
    assert stopped.counts.outer == 2


@pytest.mark.ratchet
def test_known_multiplier_shortens_the_solve():
    A, b, C, c = problem()
    qp = BoxQP(A, b, lower=0.0)
    first = SMALBE().solve(qp, C, c)
    again = SMALBE().solve(qp, C, c, x0=first.x, multiplier0=first.multiplier)
    assert again.counts.hessian < first.counts.hessian / 3


def test_dependent_and_zero_equalities_do_no_harm():
    A, b, C, c = problem()
    twice = np.vstack([C, C, np.zeros((1, C.shape[1]))])
    result = SMALBE(MPRGP(rtol=1e-7)).solve(BoxQP(A, b, lower=0.0), twice, np.r_[c, c, 0.0])
    check(A, b, twice, np.r_[c, c, 0.0], result)


def test_inconsistent_equalities_end_with_a_reason():
    result = SMALBE(max_outer=30).solve(
        BoxQP(np.eye(2), [1.0, 1.0], lower=0.0), [[1.0, 1.0]], [-1.0]
    )
    assert not result.converged
    assert result.reason is Reason.MAX_OUTER_ITERATIONS


def test_wrong_sizes_are_named():
    A, b, C, _ = problem()
    with pytest.raises(QPError, match="c has 2 components; C has 6 rows"):
        SMALBE().solve(BoxQP(A, b), C, [1.0, 2.0])
