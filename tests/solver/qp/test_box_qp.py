"""Bad data are named: which array, which component, what is wrong."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from solver import MPRGP, BoxQP, IndefiniteError, NotFiniteError, QPError, Reason, UnboundedError
from tests.solver.qp.problems import ALL, random_hessian

EYE = np.eye(3)
ONES = np.ones(3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.ones((2, 3)), ONES), "2 x 3; it must be square"),
        ((ONES, ONES), "1 dimensions"),
        ((EYE + np.diag([5.0, 0.0], 1), ONES), r"not symmetric: entry \(0, 1\) is 5"),
        ((sparse.csr_array(EYE + np.diag([5.0, 0.0], 1)), ONES), "not symmetric at entry"),
        ((np.diag([1.0, np.nan, 1.0]), ONES), r"entry \(1, 1\) is nan"),
        ((EYE, np.ones(4)), r"b has shape \(4,\); the Hessian needs \(3,\)"),
        ((EYE, [1.0, np.nan, 1.0]), "component 1: b is nan"),
        ((EYE, ONES, np.ones(2)), "the lower bound has shape"),
        ((EYE, ONES, [0.0, np.nan, 0.0]), "component 1: the lower bound is nan"),
        ((EYE, ONES, None, [0.0, 0.0, -np.inf]), "component 2: the upper bound is -inf"),
        ((EYE, ONES, 2.0, [3.0, 3.0, 1.0]), "component 2: the lower bound 2 exceeds the upper"),
    ],
)
def test_bad_data(arguments, message):
    with pytest.raises(QPError, match=message):
        BoxQP(*arguments)


def test_bad_initial_guess():
    with pytest.raises(NotFiniteError, match="component 2: the initial guess"):
        MPRGP().solve(BoxQP(EYE, ONES), [0.0, 0.0, np.nan])
    with pytest.raises(QPError, match="x0 has shape"):
        MPRGP().solve(BoxQP(EYE, ONES), [0.0])


@pytest.mark.parametrize("expansion", ALL)
def test_an_indefinite_hessian_raises_an_error(expansion):
    A = np.array([[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(IndefiniteError, match=r"indefinite.*component 0"):
        MPRGP(expansion).solve(BoxQP(A, [1.0, 0.9]))


@pytest.mark.parametrize("expansion", ALL)
@pytest.mark.parametrize("lower", [None, 0.0])
def test_unbounded_cost_names_the_component(expansion, lower):
    with pytest.raises(UnboundedError, match="unbounded below.*component 1") as caught:
        MPRGP(expansion).solve(BoxQP(np.diag([1.0, 0.0, 2.0]), ONES, lower))
    assert caught.value.component == 1


@pytest.mark.parametrize("expansion", ALL)
def test_directions_in_the_kernel_end_at_the_bound(expansion):
    result = MPRGP(expansion).solve(BoxQP(np.diag([1.0, 0.0, 2.0]), ONES, 0.0, [9.0, 7.0, 9.0]))
    assert result.converged
    np.testing.assert_allclose(result.x, [1.0, 7.0, 0.5], rtol=1e-6)
    zero = MPRGP(expansion).solve(BoxQP(np.zeros((3, 3)), [1.0, -1.0, 0.0], -2.0, 3.0))
    np.testing.assert_array_equal(zero.x, [3.0, -2.0, 0.0])


@pytest.mark.parametrize("expansion", ALL)
def test_consistent_semidefinite_hessian_without_bounds(expansion):
    A = np.diag([2.0] * 10) - np.eye(10, k=1) - np.eye(10, k=-1)
    A[0, 0] = A[9, 9] = 1.0
    b = A @ np.sin(np.arange(10.0))
    result = MPRGP(expansion, rtol=1e-10).solve(BoxQP(A, b))
    assert result.converged
    np.testing.assert_allclose(A @ result.x, b, atol=1e-8)


def test_nan_from_the_operator_is_caught_at_once():
    calls = []

    def product(x):
        calls.append(1)
        y = 2.0 * x
        if len(calls) > 2:
            y[1] = np.nan
        return y

    qp = BoxQP(LinearOperator((3, 3), matvec=product, dtype=float), [1.0, 2.0, 3.0], upper=0.8)
    with pytest.raises(NotFiniteError, match="component 1"):
        MPRGP().solve(qp)
    assert len(calls) == 3


def test_growing_iterates_are_not_called_slow_convergence():
    """A recession direction inside a cone of bounds: no CG direction is ever free of curvature."""
    rng = np.random.default_rng(5)
    Z = rng.standard_normal((12, 2))
    b = np.linalg.qr(Z, mode="complete")[0][:, 2:] @ rng.standard_normal(10)
    qp = BoxQP(Z @ Z.T, np.abs(b), lower=-0.1)
    ended = []
    for expansion in ALL:
        try:
            ended.append(MPRGP(expansion, max_iterations=400).solve(qp).reason)
        except UnboundedError:
            ended.append(Reason.DIVERGED)
    assert ended == [Reason.DIVERGED] * len(ALL)


def test_a_tolerance_below_rounding_ends():
    rng = np.random.default_rng(6)
    A = random_hessian(rng, np.geomspace(1.0, 1e10, 30))
    result = MPRGP(rtol=1e-30, max_iterations=5000).solve(BoxQP(A, rng.standard_normal(30), -0.1))
    assert result.reason in (Reason.ROUND_OFF, Reason.MAX_ITERATIONS)
    assert str(result.reason).endswith(".")
