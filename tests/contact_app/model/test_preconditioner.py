"""The lumped preconditioner on a small torn cube."""

import numpy as np
import pytest

from solver import MPRGP, BoxQP
from solver.qp.operators import estimate_norm
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from solver.tfeti.preconditioner import DualPreconditioner
from tests import scenes


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    return scenes.problem(scenes.ALL["wall"]("hexahedron", 6), [3, 3, 3])


def test_it_is_symmetric_and_positive(problem: DualProblem) -> None:
    norm, _ = estimate_norm(problem.projected)
    preconditioner = DualPreconditioner(problem, norm)
    x, y = np.random.default_rng(0).normal(size=(2, problem.size))
    Mx, My = np.empty_like(x), np.empty_like(y)
    preconditioner.apply(x, None, Mx)
    preconditioner.apply(y, None, My)
    assert x @ My == pytest.approx(y @ Mx, rel=1e-6)  # single precision inside
    assert x @ Mx > 0
    assert y @ My > 0


@pytest.mark.ratchet
def test_it_halves_the_iterations_of_the_glued_problem(problem: DualProblem) -> None:
    glued = with_active(problem, np.zeros(problem.size, bool))
    norm, _ = estimate_norm(glued.projected)
    qp = BoxQP(glued.projected, glued.rhs)
    plain = MPRGP(rtol=1e-8).solve(qp)
    lumped = MPRGP(rtol=1e-8, preconditioner=DualPreconditioner(glued, norm)).solve(qp)
    assert lumped.converged
    assert lumped.counts.hessian < 0.6 * plain.counts.hessian
    difference = np.empty(problem.size)
    glued.projected.apply(plain.x - lumped.x, difference)
    assert np.linalg.norm(difference) < 1e-6 * np.linalg.norm(glued.rhs)
