"""Expansions after a CG step: projected CG raises the cost in some, the safeguard in none."""

import numpy as np
import pytest

from solver import MPRGP, BoxQP
from solver.qp.iterate import Iterate

STRATEGIES = ("projcg", "projcg-safe", "fixed")

Steps = list[tuple[Iterate, float]]
"""The iterate after a CG step and an expansion by each strategy, and its cost."""


def _cost(qp: BoxQP, x: np.ndarray) -> float:
    return 0.5 * float(x @ _product(qp, x)) - float(qp.b @ x)


def _product(qp: BoxQP, x: np.ndarray) -> np.ndarray:
    product = np.empty(qp.size)
    qp.operator.apply(x, product)
    return product


def _random_start(seed: int) -> tuple[BoxQP, np.ndarray]:
    """A random problem in two to five variables, of condition up to 1e4, and a point inside."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 6))
    axes, _ = np.linalg.qr(random.standard_normal((n, n)))
    hessian = (axes * np.geomspace(1.0, 10.0 ** random.uniform(0.5, 4.0), n)) @ axes.T
    hessian = 0.5 * (hessian + hessian.T)
    lower = -np.abs(random.standard_normal(n))
    qp = BoxQP(hessian, hessian @ random.standard_normal(n), lower=lower)
    return qp, lower + 3.0 * np.abs(random.standard_normal(n))


def _expansion(qp: BoxQP, x0: np.ndarray, name: str) -> tuple[Iterate, float] | None:
    """The iterate after a CG step and an expansion, and the cost between; None for other steps."""
    it = Iterate(qp, x0)
    it.measure_b()
    strategy = MPRGP(name).strategy
    it.evaluate()
    alpha_cg, alpha_f = it.probe()
    if alpha_cg > alpha_f:
        return None
    it.advance(alpha_cg)
    it.conjugate()
    before = _cost(qp, it.x)
    alpha_cg, alpha_f = it.probe()
    if alpha_cg <= 1.001 * alpha_f:
        return None
    strategy.prepare(it)
    strategy.expand(it, alpha_cg, alpha_f)
    return it, before


@pytest.fixture(scope="module")
def expansions() -> list[tuple[BoxQP, float, Steps]]:
    """Problems, costs before the expansion, and the expansions of all strategies."""
    result = []
    for seed in range(2000):
        qp, x0 = _random_start(seed)
        ends = [_expansion(qp, x0, name) for name in STRATEGIES]
        steps = [(end[0], _cost(qp, end[0].x)) for end in ends if end is not None]
        if len(steps) == len(STRATEGIES) and ends[0] is not None:
            result.append((qp, ends[0][1], steps))
    return result


def test_the_safeguard_always_descends_and_projected_cg_does_not(expansions) -> None:
    rises, further = 0, 0
    for _, before, ((plain, raised), (safe, cost), (_, standard)) in expansions:
        more = safe.counts.hessian - plain.counts.hessian
        assert cost <= before
        if raised > before:
            rises, further = rises + 1, further + more
            assert cost <= standard + 1e-9 * abs(standard - before)
        else:
            assert more == 0
    assert len(expansions) > 300
    assert rises > 30
    assert further < 0.3 * rises


def test_a_further_product_decides_only_where_it_must(expansions) -> None:
    """The step ends at the lower of the minima on both segments, with the gradient there."""
    taken = set()
    for qp, before, ((plain, raised), (safe, _), _) in expansions:
        if raised > before:
            taken.add(safe.counts.hessian - plain.counts.hessian)
            exact = _product(qp, safe.x)
            np.testing.assert_allclose(safe.g, exact - qp.b, atol=1e-9 * np.abs(exact).max())
            assert (safe.x >= qp.lower).all()
    assert taken == {0, 1}
