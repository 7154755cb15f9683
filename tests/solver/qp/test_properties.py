"""Whatever the problem: a KKT point, or a reason; never an endless loop, never a point outside."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from solver import MPRGP, SMALBE, BoxQP, QPError, Reason, UnboundedError
from solver.qp.iterate import Iterate
from tests.solver.qp.problems import ALL, kkt_residual, random_hessian

SETTINGS = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
LIMIT = 3000
KINDS = ("plain", "ill-conditioned", "semidefinite", "degenerate", "diagonal")


@st.composite
def problems(draw):
    """Hessian, right-hand side and bounds with a known optimum or none."""
    n = draw(st.sampled_from([1, 2, 3, 5, 10, 25]))
    kind = draw(st.sampled_from(KINDS))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    spectrum = 0.05 + rng.random(n)
    if kind == "ill-conditioned":
        spectrum = np.geomspace(1.0, draw(st.sampled_from([1e4, 1e8, 1e12])), n)
    elif kind == "semidefinite":
        spectrum[rng.random(n) < 0.5] = 0.0
    stiffness, length = (10.0 ** draw(st.integers(-6, 6)) for _ in range(2))
    A = stiffness * (np.diag(spectrum) if kind == "diagonal" else random_hessian(rng, spectrum))
    lower, upper = -np.abs(rng.standard_normal(n)), np.abs(rng.standard_normal(n))
    if draw(st.booleans()):
        lower *= 0.0
    for bound, infinity in ((lower, -np.inf), (upper, np.inf)):
        if draw(st.integers(0, 3)) == 0:
            bound[rng.random(n) < 0.5] = infinity
    if draw(st.integers(0, 3)) == 0:
        same = (rng.random(n) < 0.3) & np.isfinite(lower)
        upper[same] = lower[same]
    lower, upper = length * lower, length * upper
    size = float(np.abs(A).max(initial=0.0)) or stiffness
    match draw(st.integers(0, 5)):
        case 0:
            b = np.zeros(n)
        case 1 | 2:
            b = size * length * rng.standard_normal(n)
        case _:  # a known optimum, strictly complementary or not
            x = np.clip(length * rng.standard_normal(n), lower, upper)
            multiplier = np.where(
                x <= lower, rng.random(n), np.where(x >= upper, -rng.random(n), 0)
            )
            if kind == "degenerate":
                multiplier[rng.random(n) < 0.7] = 0.0
            b = A @ x - size * length * multiplier
    return A, b, lower, upper


def rounding(A, b, x):
    """Errors of evaluating the gradient."""
    n = b.size
    return 1e-14 * n * (np.linalg.norm(A, 2) * np.linalg.norm(x) + np.linalg.norm(b))


def nearly_singular(A):
    values = np.linalg.eigvalsh(A)
    return values[0] <= 1e-10 * values[-1]


@pytest.mark.parametrize("expansion", ALL)
@SETTINGS
@given(problem=problems(), alpha_u=st.sampled_from([0.5, 1.0, 1.9, 2.0]))
def test_a_kkt_point_or_a_reason(expansion, problem, alpha_u):
    A, b, lower, upper = problem
    solver = MPRGP(expansion, alpha_u, max_iterations=LIMIT)
    try:
        result = solver.solve(BoxQP(A, b, lower, upper))
    except UnboundedError:
        assert nearly_singular(A)
        assert np.isinf(lower).any() or np.isinf(upper).any()
        return
    assert (lower <= result.x).all()
    assert (result.x <= upper).all()
    assert result.counts.inner in range(LIMIT + 1)
    residual = kkt_residual(A, b, result.x, lower, upper)
    scale = np.linalg.norm(b) or np.linalg.norm(A @ np.clip(0.0, lower, upper))
    if result.converged:
        assert residual <= 1.01e-6 * scale + rounding(A, b, result.x)
    else:
        # a path to the optimum beyond double precision, or none to be had
        assert nearly_singular(A)
        assert result.reason in (Reason.ROUND_OFF, Reason.MAX_ITERATIONS, Reason.DIVERGED)


@SETTINGS
@given(problem=problems())
def test_the_default_never_raises_the_cost(problem):
    A, b, lower, upper = problem
    costs: list[float] = []
    qp = BoxQP(A, b, lower, upper)

    it = Iterate(qp)
    it.measure_b()
    solver = MPRGP("projcg-safe", max_iterations=500)
    it.evaluate()
    noise = 0.0

    def watch(it):
        nonlocal noise
        costs.append(0.5 * float(it.x @ (it.g - b)))
        noise = max(noise, rounding(A, b, it.x) * float(np.linalg.norm(it.x)))
        small = it.projected_gradient_norm <= 1e-6 * it.b_norm
        return Reason.CONVERGED if small else None

    try:
        solver.minimise(it, watch)
    except QPError:
        assert nearly_singular(A)
    assert (np.diff(costs) <= 10.0 * noise + 1e-12 * np.abs(costs[1:])).all()


@SETTINGS
@given(problem=problems(), rows=st.integers(1, 4), seed=st.integers(0, 1000))
def test_smalbe_reaches_a_kkt_point_with_equalities(problem, rows, seed):
    A, b, lower, upper = problem
    A = A + 0.05 * (np.abs(A).max() or 1.0) * np.eye(b.size)
    rng = np.random.default_rng(seed)
    C = rng.standard_normal((min(rows, b.size), b.size))
    low, high = np.where(np.isinf(lower), -1.0, lower), np.where(np.isinf(upper), 1.0, upper)
    c = C @ (low + rng.random(b.size) * (high - low))  # consistent with the bounds
    result = SMALBE(MPRGP(max_iterations=LIMIT)).solve(BoxQP(A, b, lower, upper), C, c)
    assert (lower <= result.x).all()
    assert (result.x <= upper).all()
    if result.converged:
        scale = max(np.linalg.norm(b), np.linalg.norm(A, 2) * np.linalg.norm(c))
        right = b - C.T @ result.multiplier
        residual = kkt_residual(A, right, result.x, lower, upper)
        assert residual <= 1e-5 * scale + rounding(A, right, result.x)
        jump = np.linalg.norm(C @ result.x - c)
        assert np.linalg.norm(A, 2) / np.linalg.norm(C, 2) * jump <= 1e-5 * scale
    else:
        assert result.reason in (
            Reason.MAX_OUTER_ITERATIONS,
            Reason.ROUND_OFF,
            Reason.MAX_ITERATIONS,
        )
