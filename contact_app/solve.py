"""Solve a dual problem with the cheapest method it admits, until the certificate passes.

What a scene needs decides the method: no contact rows, projected conjugate gradients; no coarse
problem, MPRGP on the contact rows alone; no rows at all, one solve. Only a scene with both goes
through SMALBE-M. Each ends when the answer, not a dual residual, meets the tolerance: an
approximate answer is recovered and certified, and if it falls short the solve goes on from where
it stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.certificate import Certificate, Measures, certify
from contact_app.scene import SolverOptions
from solver import MPRGP, SMALBE, BoxQP, Counts, OuterState, Reason
from solver.result import Monitor
from solver.tfeti.coarse import ProjectorEquality
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier
from solver.tfeti.recovery import displacements as recover
from solver.tfeti.recovery import kernel_coefficients

TIGHTENINGS = 12
"""How often a solve without outer iterations is continued with a tenfold smaller residual."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An answer and what it took; local parts.

    Attributes
    ----------
    multiplier : (dual,)
        λ.
    displacements : one (n, members) array a class
        u.
    counts, reason
        Work of the solver and why it ended.
    """

    multiplier: NDArray[np.float64]
    displacements: list[NDArray[np.float64]]
    certificate: Certificate
    measures: Measures
    counts: Counts
    reason: Reason
    converged: bool


def solve(problem: DualProblem, options: SolverOptions, monitor: Monitor | None) -> Solution:
    """Solve to `options.tolerance`, as the certificate measures it."""
    if problem.comm.allreduce(problem.size) == 0:
        return _answer(problem, np.zeros(0), None, options, Counts(), Reason.CONVERGED)
    inner = MPRGP(
        expansion=options.expansion,
        alpha_u=options.alpha_u,
        gamma=options.gamma,
        rtol=0.1 * options.tolerance,
        max_iterations=options.max_iterations,
    )
    if problem.coarse is not None and problem.lower is not None:
        return _solve_smalbe(problem, options, inner, monitor)
    return _solve_mprgp(problem, options, inner, monitor)


def _solve_smalbe(
    problem: DualProblem, options: SolverOptions, inner: MPRGP, monitor: Monitor | None
) -> Solution:
    assert problem.coarse is not None
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    found: list[Solution] = []
    spread = np.ones(problem.size)
    spread[problem.inequality] = np.sqrt(problem.contact.copies)

    def promising(state: OuterState) -> bool:
        """Whether jumps and penetration, which are -gradient, are near the tolerance."""
        if not found:
            return True
        gap = np.where(
            problem.inequality, np.maximum(-state.gradient, 0.0), np.abs(state.gradient)
        )
        worst = float((gap / spread).max(initial=0.0))
        worst = problem.comm.allreduce(worst, op=MPI.MAX)
        return worst <= 2.0 * options.tolerance * found[0].measures.displacement

    def accept(state: OuterState) -> bool:
        if not promising(state):
            return False
        solution = _answer(
            problem, state.x, state.transposed_multiplier, options, Counts(), Reason.ACCEPTED
        )
        found[:] = [solution]
        return solution.certificate.passed

    result = SMALBE(inner).solve(qp, ProjectorEquality(problem.coarse), monitor=monitor,
                                 accept=accept)  # fmt: skip
    if result.reason is not Reason.ACCEPTED or not found:
        found[:] = [
            _answer(problem, result.x, result.multiplier, options, result.counts, result.reason)
        ]
    return _finished(found[0], result.counts, result.reason)


def _solve_mprgp(
    problem: DualProblem, options: SolverOptions, inner: MPRGP, monitor: Monitor | None
) -> Solution:
    """MPRGP alone; without bounds it is the conjugate gradient method."""
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    x, counts, rtol = None, Counts(), inner.rtol
    solution = None
    for _ in range(TIGHTENINGS):
        result = MPRGP(**{**inner.__dict__, "rtol": rtol}).solve(qp, x0=x, monitor=monitor)
        x = result.x
        counts = _sum(counts, result.counts)
        solution = _answer(problem, x, None, options, counts, result.reason)
        if solution.certificate.passed or result.reason is not Reason.CONVERGED:
            break
        rtol *= 0.1
    assert solution is not None
    return _finished(solution, counts, solution.reason)


def _answer(
    problem: DualProblem,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
    options: SolverOptions,
    counts: Counts,
    reason: Reason,
) -> Solution:
    """Recover and certify what an iterate of the solver stands for."""
    balanced = x.copy()
    if problem.coarse is not None:
        problem.coarse.project(x, balanced)
    touching = np.zeros(problem.size, bool)
    if problem.lower is not None:
        touching = x > problem.lower
    multiplier = feasible_multiplier(problem, balanced, touching)
    alpha = kernel_coefficients(problem, multiplier, equality_force)
    u = recover(problem, multiplier, alpha)
    certificate, measures = certify(problem, multiplier, u, options.tolerance)
    return Solution(multiplier, u, certificate, measures, counts, reason, certificate.passed)


def _finished(solution: Solution, counts: Counts, reason: Reason) -> Solution:
    converged = solution.certificate.passed
    return Solution(
        **{**solution.__dict__, "counts": counts, "reason": reason, "converged": converged}
    )


def _sum(a: Counts, b: Counts) -> Counts:
    return Counts(**{name: value + getattr(b, name) for name, value in a.__dict__.items()})
