"""Solve a dual problem with the cheapest method it admits, until the certificate passes.

What a scene needs decides the method: no contact rows, projected conjugate gradients; no coarse
problem, MPRGP on the contact rows alone; no rows at all, one solve. Only a scene with both goes
through SMALBE-M. Each ends when the answer, not a dual residual, meets the tolerance: an
approximate answer is recovered and certified, and if it falls short the solve goes on from where
it stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.certificate import Certificate, Measures, certify
from contact_app.scene import SolverOptions
from solver import MPRGP, SMALBE, BoxQP, Counts, OuterState, Reason
from solver.operators import estimate_norm
from solver.result import Monitor
from solver.tfeti.coarse import ProjectorEquality
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier
from solver.tfeti.preconditioner import LumpedPreconditioner
from solver.tfeti.recovery import displacements as recover
from solver.tfeti.recovery import kernel_coefficients

NORM_ACCURACY = 1e-2
"""Relative change at which the power method for ‖PFP‖ ends; penalty and M need no better."""

LOOKS = (1e-1, 1e-2, 1e-3)
"""Relative residuals at which a solve without contact looks whether a gap is violated."""

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

    @property
    def converged(self) -> bool:
        """Whether the certificate passes."""
        return self.certificate.passed


def reason_text(solution: Solution) -> str:
    """Why the solve ended, in a sentence for the user."""
    if solution.converged:
        return "Every number of the certificate is below the tolerance."
    if solution.reason is Reason.STOPPED:
        return "The run was interrupted; what it had reached is written."
    if solution.reason.converged:
        return "The certificate could not be brought below the tolerance: round-off is in the way."
    return str(solution.reason.value)


def solve(problem: DualProblem, options: SolverOptions, monitor: Monitor | None) -> Solution:
    """Solve to `options.tolerance`, as the certificate measures it."""
    if problem.comm.allreduce(problem.size) == 0:
        return certified_answer(problem, np.zeros(0), None, options)
    inner = MPRGP(
        expansion=options.expansion,
        alpha_u=options.alpha_u,
        gamma=options.gamma,
        rtol=0.1 * options.tolerance,
        atol=problem.round_off,
        max_iterations=options.max_iterations,
    )
    if problem.coarse is None or problem.lower is None:
        return _solve_mprgp(problem, options, inner, monitor)
    return _solve_smalbe(problem, options, inner, monitor)


@dataclass(frozen=True, eq=False)
class _Start:
    """A multiplier in equilibrium without contact forces, and where it leads.

    Attributes
    ----------
    x, equality_force : (dual,)
        Homogenised multiplier and the force of the multiplier of Gλ = e, to start SMALBE from.
    solution
        Set when no gap is violated: the answer.
    """

    x: NDArray[np.float64]
    equality_force: NDArray[np.float64]
    counts: Counts
    solution: Solution | None


def _without_contact(
    problem: DualProblem,
    options: SolverOptions,
    inner: MPRGP,
    norm: float,
    monitor: Monitor | None,
) -> _Start | None:
    """Conjugate gradients on gluing and held rows alone, as far as contact stays undecided.

    Where the displacements cross an obstacle by more than their error the solve stops and serves
    as a start; where they cross none it goes on to the tolerance and is the answer. None where a
    body is kept by contact alone.
    """
    if not problem.held_without_contact:
        return None
    glued = problem.without_contact()
    assert problem.coarse is not None
    assert glued.coarse is not None
    qp = BoxQP(glued.projected, glued.rhs)
    inner = replace(inner, preconditioner=LumpedPreconditioner(glued, norm))
    x, counts = None, Counts()
    force, kernel_part = np.empty(problem.size), np.empty(problem.size)
    for rtol in (*LOOKS, inner.rtol):
        result = replace(inner, rtol=rtol, atol=glued.round_off).solve(qp, x0=x, monitor=monitor)
        x = result.x
        counts = _sum(counts, result.counts)
        multiplier = glued.offset + x
        alpha = kernel_coefficients(glued, multiplier, None)
        u = recover(glued, multiplier, alpha)
        residual = problem.constraint_values(u) - problem.c
        penetration = np.where(problem.inequality, residual, 0.0).max(initial=0.0)
        penetration = problem.comm.allreduce(float(penetration), op=MPI.MAX)
        start = multiplier - problem.offset
        # t = Q (F λ - d) - Gᵀ α, so that the recovery finds α again
        problem.F.apply(multiplier, force)
        force -= problem.d
        problem.coarse.apply(force, force)
        problem.coarse.extend(alpha, kernel_part)
        force -= kernel_part
        if penetration > rtol * largest_of(problem, u):
            break
        if rtol == inner.rtol:
            solution = certified_answer(problem, start, force, options)
            if solution.certificate.passed:
                return _Start(start, force, counts, replace(solution, counts=counts))
    return _Start(start, force, counts, None)


def _solve_smalbe(
    problem: DualProblem, options: SolverOptions, inner: MPRGP, monitor: Monitor | None
) -> Solution:
    """SMALBE-M around MPRGP on the projected, homogenised dual."""
    assert problem.coarse is not None
    norm, products = estimate_norm(problem.projected, NORM_ACCURACY)
    inner = replace(inner, norm=norm, preconditioner=LumpedPreconditioner(problem, norm))
    start = _without_contact(problem, options, inner, norm, monitor)
    if start is not None and start.solution is not None:
        return start.solution
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    found: list[Solution] = []
    spread = np.ones(problem.size)
    spread[problem.inequality] = np.sqrt(problem.contact.copies)
    displacement = [0.0]

    def near(state: OuterState) -> bool:
        """Whether jumps and penetration, -gradient by the recovery's identity, are small enough."""
        gap = np.where(problem.inequality, np.maximum(-state.gradient, 0.0), np.abs(state.gradient))
        worst = float((gap / spread).max(initial=0.0))
        worst = problem.comm.allreduce(worst, op=MPI.MAX)
        if not displacement[0]:
            displacement[0] = _largest_displacement(problem, state)
        return worst <= options.tolerance * displacement[0]

    def accept(state: OuterState) -> bool:
        if not near(state):
            return False
        found[:] = [certified_answer(problem, state.x, state.transposed_multiplier, options)]
        displacement[0] = found[0].measures.displacement
        return found[0].certificate.passed

    result = SMALBE(inner).solve(
        qp,
        ProjectorEquality(problem.coarse),
        x0=start.x if start else None,
        multiplier0=start.equality_force if start else None,
        monitor=monitor,
        accept=accept,
    )
    result.counts.norm_estimation += products
    if result.reason is not Reason.ACCEPTED:
        found[:] = [certified_answer(problem, result.x, result.multiplier, options)]
    counts = _sum(start.counts, result.counts) if start else result.counts
    return replace(found[0], counts=counts, reason=result.reason)


def _solve_mprgp(
    problem: DualProblem, options: SolverOptions, inner: MPRGP, monitor: Monitor | None
) -> Solution:
    """MPRGP alone; without bounds it is the conjugate gradient method."""
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    x, counts, rtol = None, Counts(), inner.rtol
    for _ in range(TIGHTENINGS):
        result = replace(inner, rtol=rtol).solve(qp, x0=x, monitor=monitor)
        x = result.x
        counts = _sum(counts, result.counts)
        solution = certified_answer(problem, x, None, options)
        if solution.certificate.passed or result.reason is not Reason.CONVERGED:
            break
        rtol *= 0.1
    return replace(solution, counts=counts, reason=result.reason)


def certified_answer(
    problem: DualProblem,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
    options: SolverOptions,
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
    return Solution(multiplier, u, certificate, measures, Counts(), Reason.CONVERGED)


def _largest_displacement(problem: DualProblem, state: OuterState) -> float:
    """Estimate of the largest displacement from an iterate far from the solution."""
    multiplier = problem.offset + state.x
    alpha = kernel_coefficients(problem, multiplier, state.transposed_multiplier)
    return largest_of(problem, recover(problem, multiplier, alpha))


def largest_of(problem: DualProblem, displacements: list[NDArray[np.float64]]) -> float:
    """Largest displacement component on all ranks."""
    local = max((float(np.abs(part).max()) for part in displacements if part.size), default=0.0)
    return float(problem.comm.allreduce(local, op=MPI.MAX))


def _sum(a: Counts, b: Counts) -> Counts:
    return Counts(**{name: value + getattr(b, name) for name, value in a.__dict__.items()})
