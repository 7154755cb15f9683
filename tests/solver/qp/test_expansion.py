"""Problems on which strategies fail, and the safeguarded strategy on them (paper, section 3.2)."""

import numpy as np
import pytest

from solver import MPRGP, BoxQP, Reason
from solver.qp.examples import cycling_problem, figure_1
from solver.qp.iterate import Iterate
from solver.qp.operators import MatrixOperator
from tests.solver.qp.problems import ALL, random_hessian


def first_expansion(qp: BoxQP, expansion: str, x0: np.ndarray, alpha_u: float = 1.9):
    """Cost before and after the first step, which must be an expansion."""
    solver = MPRGP(expansion, alpha_u, max_iterations=1)
    result = solver.solve(qp, x0)
    assert result.counts.expansion == 1
    return result


def cost(qp, x):
    product = np.empty(qp.size)
    qp.operator.apply(np.ascontiguousarray(x), product)
    return 0.5 * float(x @ product) - float(qp.b @ x)


def test_projected_cg_raises_the_cost_in_the_papers_figure_1():
    qp, x0 = figure_1()
    before = cost(qp, x0)
    assert cost(qp, first_expansion(qp, "projcg", x0).x) > before
    assert cost(qp, first_expansion(qp, "fixed", x0).x) < before
    assert cost(qp, first_expansion(qp, "projcg-safe", x0).x) < before


@pytest.mark.parametrize("name", ["grgr-opt", "gfgr-opt", "gfgf-opt"])
def test_opt_with_alpha_1_solves_figure_1_in_one_step_as_in_the_paper(name):
    qp, x0 = figure_1()
    result = first_expansion(qp, name, x0, alpha_u=1.0)
    assert result.converged
    np.testing.assert_allclose(result.x, MPRGP(rtol=1e-12).solve(qp).x, atol=1e-12)


def test_the_safeguard_solves_figure_1_in_one_step_without_a_further_product():
    qp, x0 = figure_1()
    result = first_expansion(qp, "projcg-safe", x0)
    assert result.converged
    assert result.counts.hessian == 3  # gradient at x0 and the two of the projected CG step


def test_projected_cg_can_cycle_for_ever_and_the_safeguard_cannot():
    qp = cycling_problem()
    plain = MPRGP("projcg", max_iterations=2000).solve(qp)
    assert plain.reason is Reason.MAX_ITERATIONS
    norms = np.array([step.projected_gradient_norm for step in plain.history])
    np.testing.assert_allclose(norms[-7:], norms[-14:-7], rtol=1e-6)
    safe = MPRGP("projcg-safe", max_iterations=2000).solve(qp)
    assert safe.converged


@pytest.mark.parametrize("expansion", ALL)
def test_half_step_lands_on_the_bound_exactly(expansion):
    """A bound at zero has no scale of its own: what reaches it must be put on it."""
    rng = np.random.default_rng(4)
    A = random_hessian(rng, np.geomspace(1.0, 30.0, 12))
    result = MPRGP(expansion, rtol=1e-10).solve(
        BoxQP(A, rng.standard_normal(12), lower=0.0), np.full(12, 1.0)
    )
    assert result.converged
    assert ((result.x == 0.0) | (result.x > 1e-8)).all()


class Watched(MatrixOperator):
    """A matrix that leaves 3 x beside each product, where the next one overwrites it."""

    def __init__(self, matrix: np.ndarray) -> None:
        super().__init__(matrix)
        self.image = np.empty(self.size)

    def apply(self, x: np.ndarray, out: np.ndarray) -> None:
        super().apply(x, out)
        np.multiply(3.0, x, out=self.image)


def test_a_direction_that_is_taken_back_has_the_image_it_had() -> None:
    rng = np.random.default_rng(2)
    qp = BoxQP(
        Watched(random_hessian(rng, np.linspace(1.0, 5.0, 8))), rng.standard_normal(8), lower=-1.0
    )
    it = Iterate(qp)
    it.measure_b()
    it.evaluate()
    it.probe()
    it.aim_reduced_beside(0.1)
    it.probe()
    it.take_back()
    it.advance(0.3)
    assert it.image is not None
    np.testing.assert_allclose(it.image, 3.0 * it.x, atol=1e-14)
