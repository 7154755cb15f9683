"""Solve a dual problem with the cheapest method it admits, until the certificate passes.

What a scene needs decides the method: no contact rows, projected conjugate gradients; no coarse
problem, MPRGP on the contact rows alone; no rows at all, one solve. Only a scene with both goes
through SMALBE-M. Each ends when the answer, not a dual residual, meets the tolerance: an
approximate answer is recovered and certified, and if it falls short the solve goes on from where
it stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.certificate import certify
from contact_app.checkpoint import Checkpoint
from contact_app.scene import SolverOptions
from contact_app.solution import Solution
from contact_app.target import Assess, Target, aim
from solver import MPRGP, SMALBE, BoxQP, Counts, OuterState, Reason
from solver.operators import estimate_norm
from solver.result import Monitor
from solver.smalbe import Restart
from solver.tfeti.coarse import ProjectorEquality
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier, largest_magnitude
from solver.tfeti.preconditioner import FacePreconditioner
from solver.tfeti.recovery import displacements as recover
from solver.tfeti.recovery import interface_displacements, kernel_coefficients

INNER = 0.1
"""Residual relative to the right-hand side of the dual that a tolerance is worth."""

NORM_ACCURACY = 1e-2
"""Relative change at which the power method for ‖PFP‖ ends; penalty and M need no better."""

LOOKS = (1e-1, 1e-2, 1e-3)
"""Relative residuals at which a solve without contact looks whether a gap is violated."""

PATIENCE = 16
"""Outer iterations after which a slow SMALBE hands its active set to `_active_sets`."""

FACES = 15
"""Active sets tried before SMALBE goes on."""

OUTSIDE = 10.0
"""Residual that conjugate gradients leave, over the part of the right-hand side that rounding
puts outside the range of P, which no step can remove."""

MEMORY = 10
"""Pairs that MPRGP remembers on the contact rows of whole bodies: they are short beside a product,
and slender bodies, whose F is ill-conditioned, do not end without."""

TIGHTENINGS = 12
"""How often a solve without contact is continued with a smaller residual."""


def reason_text(solution: Solution) -> str:
    """Why the solve ended, in a sentence for the user."""
    if solution.converged:
        return "Every number of the certificate is below the tolerance."
    if solution.reason is Reason.STOPPED:
        return "The run was interrupted; what it had reached is written."
    if solution.reason.converged:
        return "The certificate could not be brought below the tolerance: round-off is in the way."
    return str(solution.reason.value)


def solve(
    problem: DualProblem,
    options: SolverOptions,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None = None,
    assess: Assess | None = None,
) -> Solution:
    """Solve to `options.tolerance`, as the certificate measures it.

    Parameters
    ----------
    checkpoint
        Where the state of each outer iteration is kept, and where a stopped solve goes on from.
        Solves without outer iterations are short and leave none.
    assess
        Estimates the errors of an answer; an automatic tolerance needs it.
    """
    target = aim(options, assess)
    if problem.comm.allreduce(problem.size) == 0:
        return target.judge(_answer(problem, target, np.zeros(0), None))
    inner = MPRGP(
        expansion=options.expansion,
        alpha_u=options.alpha_u,
        gamma=options.gamma,
        rtol=INNER * target.tolerance,
        atol=problem.round_off,
        max_iterations=options.max_iterations,
    )
    if problem.coarse is None or problem.lower is None:
        return _solve_mprgp(problem, target, inner, monitor)
    return _solve_smalbe(problem, target, inner, monitor, checkpoint)


@dataclass(frozen=True, eq=False)
class _Start:
    """A multiplier in equilibrium, and the force of the multiplier of Gλ = e that goes with it.

    Attributes
    ----------
    x, equality_force : (dual,)
        Homogenised multiplier and t = Cᵀ μ, to start SMALBE from or to recover an answer.
    displacements
        u on the interface.
    residual : (dual,)
        B u - c: the penetration on contact rows.
    """

    x: NDArray[np.float64]
    equality_force: NDArray[np.float64]
    displacements: NDArray[np.float64]
    residual: NDArray[np.float64]


class _Face:
    """Conjugate gradients with some contact rows closed and the others open."""

    def __init__(self, problem: DualProblem, touching: NDArray[np.bool_]) -> None:
        self.problem = problem
        self.glued = problem.face(touching)
        self.qp = BoxQP(self.glued.projected, self.glued.rhs)
        # no penalty here: steps that leave the range of P would meet no curvature
        self.preconditioner = FacePreconditioner(self.glued, math.inf)
        self.x: NDArray[np.float64] | None = None
        self.counts = Counts()
        assert self.glued.coarse is not None
        outside = np.empty(problem.size)
        self.glued.coarse.apply(self.glued.rhs, outside)
        square = problem.comm.allreduce(float(outside @ outside))
        self.unreachable = OUTSIDE * math.sqrt(square)

    def start_from(self, multiplier: NDArray[np.float64]) -> None:
        """Begin at the nearest multiplier in equilibrium."""
        assert self.glued.coarse is not None
        self.x = multiplier - self.glued.offset
        self.glued.coarse.project(self.x, self.x)

    def solve(self, inner: MPRGP, rtol: float, monitor: Monitor | None) -> Reason:
        """Go on to a relative residual; `inner.max_iterations` limits the face, not the call."""
        result = replace(
            inner,
            rtol=rtol,
            atol=max(self.glued.round_off, self.unreachable),
            preconditioner=self.preconditioner,
            max_iterations=inner.max_iterations - self.counts.inner,
        ).solve(self.qp, x0=self.x, monitor=monitor)
        self.x = result.x
        self.counts = _sum(self.counts, result.counts)
        return result.reason

    def state(self) -> _Start:
        """What the face's solution means for the whole problem."""
        problem, glued = self.problem, self.glued
        assert problem.coarse is not None
        assert self.x is not None
        multiplier = glued.offset + self.x
        alpha = kernel_coefficients(glued, multiplier, None)
        u = interface_displacements(glued, multiplier, alpha)
        # t = Q (F λ - d) - Gᵀ α, so that the recovery finds α again
        force, kernel_part = np.empty(problem.size), np.empty(problem.size)
        problem.F.apply(multiplier, force)
        force -= problem.d
        problem.coarse.apply(force, force)
        problem.coarse.extend(alpha, kernel_part)
        force -= kernel_part
        residual = problem.residual(u)
        return _Start(multiplier - problem.offset, force, u, residual)


def _without_contact(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    monitor: Monitor | None,
) -> tuple[_Start | None, Solution | None, Counts]:
    """Conjugate gradients on gluing and held rows alone, as far as contact stays undecided.

    Where the displacements cross an obstacle by more than their error the solve stops and serves
    as a start; where they cross none it goes on to the tolerance and is the answer, as it is where
    the solve was stopped. Nothing where a body is kept by contact alone.
    """
    if not problem.held_without_contact:
        return None, None, Counts()
    face = _Face(problem, np.zeros(problem.size, bool))
    for look in range(len(LOOKS) + TIGHTENINGS):
        tolerance = target.tolerance
        rtol = max(LOOKS[look] if look < len(LOOKS) else 0.0, INNER * tolerance)
        reason = face.solve(inner, rtol, monitor)
        start = face.state()
        if reason in (Reason.STOPPED, Reason.MAX_ITERATIONS):
            solution = _answer(problem, target, start.x, start.equality_force)
            return start, replace(solution, reason=reason), face.counts
        penetration = np.where(problem.inequality, start.residual, 0.0).max(initial=0.0)
        penetration = problem.comm.allreduce(float(penetration), op=MPI.MAX)
        if penetration > rtol * largest_magnitude(problem.comm, start.displacements):
            return start, None, face.counts
        if rtol <= INNER * tolerance:
            solution = _answer(problem, target, start.x, start.equality_force)
            solution = target.judge(solution)
            if solution.converged:
                return start, solution, face.counts
            if target.tolerance == tolerance:
                break
    return start, None, face.counts


def _active_sets(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    x: NDArray[np.float64],
    monitor: Monitor | None,
) -> tuple[Solution | None, Counts]:
    """Primal-dual active sets from the contact rows that touch now; None if they do not settle.

    Each face is solved with its own coarse problem, so that nothing is left to augmented
    Lagrangians; then rows that pull open and rows that are crossed close (Hintermüller, Ito,
    Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, 2002).
    """
    assert problem.lower is not None
    counts = Counts()
    touching = problem.inequality & (x > problem.lower)
    multiplier = problem.offset + x
    face = None
    for _ in range(FACES):
        if face is None:
            face = _Face(problem, touching)
            face.start_from(np.where(problem.inequality & ~touching, 0.0, multiplier))
        tolerance, before = target.tolerance, face.counts
        left = replace(inner, max_iterations=inner.max_iterations - counts.inner + before.inner)
        reason = face.solve(left, 0.1 * INNER * tolerance, monitor)
        counts = _sum(counts, face.counts, before)
        if reason in (Reason.STOPPED, Reason.MAX_ITERATIONS):
            break
        state = face.state()
        multiplier = problem.offset + state.x
        largest = largest_magnitude(problem.comm, state.displacements)
        crossed = state.residual > 1e-2 * tolerance * largest
        following = problem.inequality & np.where(touching, multiplier > 0.0, crossed)
        if not problem.comm.allreduce(int((following != touching).sum())):
            solution = target.judge(
                _answer(problem, target, state.x, state.equality_force, touching)
            )
            if solution.converged:
                return solution, counts
            if target.tolerance == tolerance:
                break
        else:
            touching, face = following, None
    return None, counts


class _OuterJudge:
    """Decides after each outer iteration of SMALBE whether its answer will do.

    An answer is certified where its jumps and its penetration are small enough for a certificate
    to have a chance; where SMALBE is slow its active set is tried by `_active_sets`.

    Attributes
    ----------
    answer
        The last answer that was certified, or None.
    spent
        Work of the active sets that were tried.
    """

    def __init__(self, problem: DualProblem, target: Target, inner: MPRGP) -> None:
        self.answer: Solution | None = None
        self.spent = Counts()
        self._problem, self._target, self._inner = problem, target, inner
        self._largest = 0.0
        self._residuals: list[float] = []
        self._next_certificate = self._failures = 0

    def certify(self, x: NDArray[np.float64], force: NDArray[np.float64]) -> Solution:
        """The answer that an iterate and its force Cᵀ μ stand for."""
        answer = _answer(self._problem, self._target, x, force)
        self._largest = answer.measures.displacement
        self.answer = self._target.judge(answer)
        return self.answer

    def accepts(self, state: OuterState, monitor: Monitor | None) -> bool:
        """Whether `answer` meets the tolerance (collective)."""
        self._residuals.append(state.residual_norm)
        outer = len(self._residuals)
        if self._is_near(state) and state.products >= self._next_certificate:
            tolerance = self._target.tolerance
            if self.certify(state.x, state.transposed_multiplier).converged:
                return True
            if self._target.tolerance == tolerance:
                wait = min(self._failures, self._target.patience)
                self._next_certificate = state.products + wait
                self._failures += 1
        due = outer % PATIENCE == 0 and self._problem.held_without_contact
        if due and self._residuals[-1] > 0.1 * self._residuals[-PATIENCE // 2]:
            found, counts = _active_sets(self._problem, self._target, self._inner, state.x, monitor)
            self.spent = _sum(self.spent, counts)
            if found is not None:
                self.answer = found
                return True
        return False

    def _is_near(self, state: OuterState) -> bool:
        """Whether jumps and penetration, -gradient by the recovery's identity, are small enough."""
        problem = self._problem
        gap = np.where(problem.inequality, np.maximum(-state.gradient, 0.0), np.abs(state.gradient))
        worst = float((gap / problem.spread).max(initial=0.0))
        worst = problem.comm.allreduce(worst, op=MPI.MAX)
        if not self._largest:
            self._largest = _largest_displacement(problem, state)
        return worst <= self._target.tolerance * self._largest


def _solve_smalbe(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
) -> Solution:
    """SMALBE-M around MPRGP on the projected, homogenised dual."""
    assert problem.coarse is not None
    norm, products = estimate_norm(problem.projected, NORM_ACCURACY)
    preconditioner = FacePreconditioner(problem, norm)
    inner = replace(inner, norm=norm, preconditioner=preconditioner)
    restart = checkpoint.load(problem) if checkpoint else None
    start, answer, counts = None, None, Counts()
    if restart is None:
        start, answer, counts = _without_contact(problem, target, inner, monitor)
    counts.norm_estimation += products
    if answer is not None:
        return replace(answer, counts=counts)
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    inner = replace(inner, max_iterations=inner.max_iterations - counts.inner)
    judge = _OuterJudge(problem, target, inner)

    def save(state: Restart) -> None:
        if checkpoint is not None:
            checkpoint(replace(state, counts=_sum(_sum(counts, judge.spent), state.counts)))

    result = SMALBE(inner).solve(
        qp,
        ProjectorEquality(problem.coarse, preconditioner.set_penalty),
        x0=start.x if start else None,
        multiplier0=start.equality_force if start else None,
        monitor=monitor,
        accept=lambda state: judge.accepts(state, monitor),
        save=save,
        restart=restart,
    )
    answer = judge.answer
    if answer is None or result.reason is not Reason.ACCEPTED:
        answer = judge.certify(result.x, result.multiplier)
    counts = _sum(_sum(counts, judge.spent), result.counts)
    return replace(answer, counts=counts, reason=result.reason)


def _solve_mprgp(
    problem: DualProblem, target: Target, inner: MPRGP, monitor: Monitor | None
) -> Solution:
    """MPRGP alone; without bounds it is the conjugate gradient method."""
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    if problem.coarse is None and problem.lower is not None:
        inner = replace(inner, memory=MEMORY)
    answer: Solution | None = None

    def certify(x: NDArray[np.float64]) -> Solution:
        nonlocal answer
        answer = target.judge(_answer(problem, target, x, None))
        return answer

    result = inner.solve(qp, monitor=monitor, accept=lambda x: certify(x).converged)
    if answer is None or not answer.converged:
        answer = certify(result.x)
    return replace(answer, counts=result.counts, reason=result.reason)


def _answer(
    problem: DualProblem,
    target: Target,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
    touching: NDArray[np.bool_] | None = None,
) -> Solution:
    """`certified_answer` held against what a target asks for now."""
    return certified_answer(
        problem, x, equality_force, target.tolerance, touching, target.relaxations
    )


def certified_answer(
    problem: DualProblem,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
    tolerance: float,
    touching: NDArray[np.bool_] | None = None,
    relaxations: int = 0,
) -> Solution:
    """Recover and certify what an iterate of the solver stands for.

    Parameters
    ----------
    tolerance
        What the certificate is held against.
    touching : (dual,)
        Contact rows that carry force; those above their bound unless given.
    relaxations
        Of the certificate: steps that sharpen the duality gap.
    """
    balanced = x.copy()
    if problem.coarse is not None:
        problem.coarse.project(x, balanced)
    if touching is None:
        touching = np.zeros(problem.size, bool)
        if problem.lower is not None:
            touching = x > problem.lower
    multiplier = feasible_multiplier(problem, balanced, touching)
    alpha = kernel_coefficients(problem, multiplier, equality_force)
    u = recover(problem, multiplier, alpha)
    certificate, measures = certify(problem, multiplier, u, tolerance, relaxations)
    return Solution(multiplier, u, certificate, measures, Counts(), Reason.CONVERGED, tolerance)


def _largest_displacement(problem: DualProblem, state: OuterState) -> float:
    """Estimate of the largest displacement from an iterate far from the solution."""
    multiplier = problem.offset + state.x
    alpha = kernel_coefficients(problem, multiplier, state.transposed_multiplier)
    return largest_magnitude(problem.comm, interface_displacements(problem, multiplier, alpha))


def _sum(a: Counts, b: Counts, less: Counts | None = None) -> Counts:
    """Work of two solves, less what was counted before."""
    known = less or Counts()
    return Counts(
        **{n: value + getattr(b, n) - getattr(known, n) for n, value in a.__dict__.items()}
    )
