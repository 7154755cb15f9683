"""The random search for expansions that raise the cost, and the safeguard in it."""

from __future__ import annotations

import numpy as np

from contact_app.studies.safeguard import cost, random_start, search, second_step


def test_over_many_expansions_the_safeguard_descends_always_and_projected_cg_does_not():
    found = search(2000)
    assert found.expansions > 300
    assert found.rises > 30
    assert found.safe_rises == 0
    assert found.losses == 0
    assert found.elsewhere == 0  # no product more where projected CG does not raise the cost
    assert found.further_multiplications < 0.3 * found.rises


def test_a_further_product_decides_only_where_it_must():
    """The step ends at the lower of the minima on both segments, with the gradient there."""
    taken = set()
    for seed in range(1000):
        qp, x0 = random_start(seed)
        plain, safe = (second_step(qp, x0, name) for name in ("projcg", "projcg-safe"))
        if plain is None or safe is None or cost(qp, plain[0].x) <= plain[1]:
            continue
        it = safe[0]
        taken.add(it.counts.hessian - plain[0].counts.hessian)
        exact = np.empty(qp.size)
        qp.operator.apply(it.x, exact)
        np.testing.assert_allclose(it.g, exact - qp.b, atol=1e-9 * np.abs(exact).max())
        assert (it.x >= qp.lower).all()
    assert taken == {0, 1}
