"""The coarse problem in a solve: what SMALBE carries along instead of projecting again."""

import numpy as np
import pytest

from solver import MPRGP, SMALBE, BoxQP
from solver.qp.iterate import Iterate
from solver.qp.operators import estimate_norm
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.dual import DualProblem
from solver.tfeti.projected import PenalisedOperator, ProjectorEquality
from tests import scenes


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    return scenes.problem(scenes.ALL["wall"]("hexahedron", 6), [3, 3, 3])


class Counted(ProjectorEquality):
    """Projections that SMALBE asks for itself."""

    projections = 0

    def apply(self, x: np.ndarray, out: np.ndarray) -> None:
        """Q x."""
        self.projections += 1
        super().apply(x, out)


class Silent(PenalisedOperator):
    """P F P + ρ Q without an image, so that SMALBE projects at every step."""

    def __init__(self, projected: object, rho: float) -> None:
        super().__init__(projected, rho)
        self._hidden = self.image
        del self.image

    def apply(self, x: np.ndarray, out: np.ndarray) -> None:
        """P F P x + ρ Q x."""
        self.image = self._hidden
        super().apply(x, out)
        del self.image


class Uncarried(Counted):
    """Equalities whose operator leaves no image."""

    def penalised(self, operator: object, rho: float) -> Silent:
        """x to P F P x + ρ Q x."""
        return Silent(operator, rho)


@pytest.mark.ratchet
@pytest.mark.parametrize("expansion", ["projcg", "projcg-safe", "gfgr-opt"])
def test_carrying_the_residual_along_saves_projections_and_changes_no_count(
    problem: DualProblem, expansion: str
) -> None:
    assert problem.coarse is not None
    norm, _ = estimate_norm(problem.projected)
    solver = SMALBE(MPRGP(expansion, rtol=1e-7, norm=norm))
    carried, projected = Counted(problem.coarse), Uncarried(problem.coarse)
    results = [
        solver.solve(BoxQP(problem.projected, problem.rhs, lower=problem.lower), C)
        for C in (carried, projected)
    ]
    assert results[0].converged
    assert results[0].counts == results[1].counts
    assert results[0].counts.expansion > 0
    np.testing.assert_array_equal(results[0].x, results[1].x)
    inner = results[0].counts.inner
    assert projected.projections - carried.projections > 0.4 * inner


@pytest.mark.parametrize("expansion", ["projcg", "projcg-safe", "gfgr-opt"])
def test_the_image_carried_along_is_that_of_the_iterate(
    problem: DualProblem, expansion: str
) -> None:
    assert problem.coarse is not None
    norm, _ = estimate_norm(problem.projected)
    operator = ProjectorEquality(problem.coarse).penalised(problem.projected, norm)
    it = Iterate(BoxQP(operator, problem.rhs, lower=problem.lower), norm=2.0 * norm)
    solver = MPRGP(expansion, max_iterations=60)
    it.measure_b()
    solver.strategy.prepare(it)
    it.evaluate()
    solver.minimise(it, lambda it: None)
    projected = np.empty(problem.size)
    problem.coarse.apply(it.x, projected)
    assert it.image is not None
    assert it.counts.expansion > 0
    assert operator.image_norm(it.image) == pytest.approx(np.linalg.norm(projected), rel=1e-9)


def test_a_factor_takes_the_place_of_one_that_is_no_longer_in_use(problem: DualProblem) -> None:
    """Not of one that is, and what it solves with is what it was given."""
    coarse = problem.coarse
    assert coarse is not None
    rng = np.random.default_rng(1)
    rhs = rng.standard_normal(coarse.kernels)

    def made() -> CoarseProblem:
        assert coarse is not None
        return coarse.weighted(np.where(problem.inequality, rng.random(problem.size), 1.0))

    def residual(of: CoarseProblem) -> float:
        multiplier, back = np.empty(of.size), np.empty(of.kernels)
        of.least_multiplier(rhs, multiplier)
        of.restrict(multiplier, back)
        return float(np.abs(back - rhs).max())

    first, second = made(), made()
    assert first.factor is not second.factor
    freed = id(first.factor)
    del first
    third = made()
    assert id(third.factor) == freed
    for weighted in (second, third, coarse):
        assert residual(weighted) < 1e-9
