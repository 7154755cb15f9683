"""Solve a dual problem with the cheapest method it admits, until the certificate passes.

What a scene needs decides the method: no contact rows, projected conjugate gradients; no coarse
problem, MPRGP on the contact rows alone; no rows at all, one solve. A scene with both is solved on
faces (`solver.contact.active_set`), beginning with what touches when all subdomains are rigid, on
springs. Where faces do not settle SMALBE-M, whose convergence is proved, goes on to the end. Each
ends when the answer, not a dual residual, meets the tolerance: an approximate answer is recovered
and certified, and if it falls short the solve goes on from where it stands.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver import MPRGP, SMALBE, BoxQP, Counts, OuterState, Reason
from solver.contact.active_set import Guess, Keep, Outcome, State, follow
from solver.contact.certificate import certify
from solver.contact.checkpoint import Checkpoint, Saver, without_outer_iterations
from solver.contact.duality_gap import duality_gap
from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.contact.stopping import Assess, Target, aim
from solver.qp.iterate import Iterate
from solver.qp.operators import estimate_norm
from solver.qp.result import Monitor
from solver.qp.smalbe import Restart
from solver.tfeti.bodies import body_lengths
from solver.tfeti.columns import on_columns
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier
from solver.tfeti.preconditioner import FacePreconditioner
from solver.tfeti.projected import ProjectorEquality
from solver.tfeti.recovery import displacements as recover
from solver.tfeti.recovery import interface_displacements, kernel_coefficients
from solver.tfeti.winkler import bedded, lies_flat

INNER = 0.1
"""Residual relative to the right-hand side of the dual that a tolerance is worth."""

NORM_ACCURACY = 1e-2
"""Relative change at which the power method for ‖PFP‖ ends; penalty and M need no better."""

ENDS = (Reason.ACCEPTED, Reason.STOPPED, Reason.MAX_ITERATIONS)
"""Why faces end a solve; for other reasons SMALBE goes on."""

LOOSE = 1e-2
"""Share of an iterate's jumps that is left where its duality gap only tells how far it is."""

PATIENCE = 16
"""Outer iterations after which a slow SMALBE hands its active set over once more."""

MEMORY = 10
"""Pairs that MPRGP remembers on contact rows of whole bodies: they are short beside a product."""


ROUNDED_AWAY = (
    "Rounding errors hold the solver up: the bodies give way to some forces so much more than to "
    "others that no digits of the latter are left."
)
"""Where the dual problem seems to be unbounded: equilibrium was checked before, so it is not."""


def reason_text(solution: Solution) -> str:
    """Why the solve ended, in a sentence for the user."""
    if solution.converged:
        return "Every number of the certificate is below the tolerance."
    if solution.reason is Reason.STOPPED:
        return "The run was interrupted; what it had reached is written."
    if solution.reason is Reason.DIVERGED:
        return ROUNDED_AWAY
    if solution.reason.converged:
        return "The certificate could not be brought below the tolerance: round-off is in the way."
    return str(solution.reason.value)


def solve(
    problem: DualProblem,
    options: SolverOptions,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None = None,
    assess: Assess | None = None,
    start: NDArray[np.float64] | None = None,
) -> Solution:
    """Solve to `options.tolerance`, as the certificate measures it.

    Parameters
    ----------
    checkpoint
        Where the state is saved at steps where that is due, and where a stopped solve goes on from.
        The state that a solve ended with is held for a run that is stopped later.
    assess
        Estimates the errors of an answer; an automatic tolerance needs it.
    start : (dual,)
        Multipliers to begin with.
    """
    target = aim(options, assess)
    warm = start is not None
    if problem.comm.allreduce(problem.size) == 0:
        return target.judge(_answer(problem, target, np.zeros(0), None))
    inner = MPRGP(
        expansion=options.expansion,
        alpha_u=options.alpha_u,
        gamma=options.gamma,
        rtol=INNER * target.tolerance,
        max_iterations=options.max_iterations,
    )
    if problem.coarse is None or not problem.one_sided:
        found = _solve_mprgp(problem, target, inner, monitor, checkpoint, start)
        found = replace(found, warm=warm)
    else:
        found = _solve_smalbe(problem, target, inner, monitor, checkpoint, start)
    if checkpoint is not None and found.reason is not Reason.STOPPED:
        touching = problem.inequality & (found.multiplier > 0.0)
        checkpoint.hold(without_outer_iterations(found.multiplier, touching, found.counts))
    return found


def _on_faces(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    multiplier: NDArray[np.float64] | None,
    touching: NDArray[np.bool_],
    monitor: Monitor | None,
    keep: Keep | None,
    fewer: Guess | None = None,
) -> tuple[Outcome, Solution | None]:
    """`follow` active sets to a certified answer, or to the best there is where it was stopped."""
    answer: Solution | None = None
    judged: State | None = None

    def accept(state: State) -> bool:
        nonlocal answer, judged
        answer, judged = _answer_of(problem, target, state), state
        return answer.converged

    def lacks(state: State) -> float:
        worst = state.worst(problem)
        multiplier = state.multiplier.copy()
        multiplier[problem.inequality] = np.maximum(multiplier[problem.inequality], 0.0)

        def gap(sharp: bool) -> float:
            steps = target.relaxations if sharp else 0
            return duality_gap(problem, multiplier, state.displacements, steps, LOOSE)

        lack = target.lacks(worst, state.strained, gap)
        if state is judged and answer is not None:  # the certificate knows more than the jumps
            lack = max(lack, target.lacks_certified(answer))
        return lack

    found = follow(
        problem, inner, multiplier, touching, lacks, accept, monitor, keep, target.eager, fewer
    )
    if found.reason not in ENDS:
        return found, None
    if found.reason is not Reason.ACCEPTED:
        assert found.state is not None
        answer = _answer_of(problem, target, found.state)
    assert answer is not None
    return found, replace(answer, reason=found.reason)


class _OuterJudge:
    """Decides after each outer iteration of SMALBE whether its answer will do.

    The first one's active set is handed over to `follow` where contact alone keeps a body, for
    which the faces tried before began with a guess; so are later ones where SMALBE is slow. An
    answer of SMALBE's own is certified where its jumps and its penetration are small enough for a
    certificate to have a chance.

    Attributes
    ----------
    answer
        The last answer that was certified, or None.
    ended
        Why, where active sets ended the solve.
    spent
        Work of the active sets that were tried.
    """

    def __init__(
        self,
        problem: DualProblem,
        target: Target,
        inner: MPRGP,
        monitor: Monitor | None,
        saver: Saver,
    ) -> None:
        self.answer: Solution | None = None
        self.ended: Reason | None = None
        self.spent = Counts()
        self._problem, self._target, self._inner = problem, target, inner
        self._monitor, self._saver = monitor, saver
        self._lengths: NDArray[np.float64] | None = None
        self._residuals: list[float] = []
        self._next_certificate = self._failures = 0

    def certify(self, x: NDArray[np.float64], force: NDArray[np.float64]) -> Solution:
        """The answer that an iterate and its force Cᵀ μ stand for."""
        answer = _answer(self._problem, self._target, x, force)
        self._lengths = body_lengths(
            self._problem.bodies, answer.measures.displacements, self._problem.free_lengths
        )
        self.answer = self._target.judge(answer)
        return self.answer

    def accepts(self, state: OuterState) -> bool:
        """Whether `answer` meets the tolerance, or the solve was stopped (collective)."""
        problem = self._problem
        self._residuals.append(state.residual_norm)
        outer = len(self._residuals)
        if self._is_near(state) and state.counts.hessian >= self._next_certificate:
            tolerance = self._target.tolerance
            if self.certify(state.x, state.transposed_multiplier).converged:
                return True
            if self._target.tolerance == tolerance:
                wait = min(self._failures, self._target.patience)
                self._next_certificate = state.counts.hessian + wait
                self._failures += 1
        slow = outer % PATIENCE == 0 and self._residuals[-1] > 0.1 * self._residuals[-PATIENCE // 2]
        first = outer == 1 and not problem.held_without_contact
        return self._hand_over(state) if first or slow else False

    def _hand_over(self, state: OuterState) -> bool:
        """Whether active sets from those of an outer iteration end the solve."""
        problem = self._problem
        assert problem.lower is not None

        def keep(found: State, spent: Counts) -> None:
            self._saver(
                Restart(
                    state.iteration, *found.homogenised(problem), state.rho, state.M,
                    state.target, -math.inf, (), state.counts + spent,
                )
            )  # fmt: skip

        found, answer = _on_faces(
            problem,
            self._target,
            self._inner,
            problem.offset + state.x,
            problem.inequality & (state.x > problem.lower),
            self._monitor,
            Keep(lambda: self._saver.due, keep),
        )
        self.spent = self.spent + found.counts
        if answer is None:
            return False
        self.answer, self.ended = answer, found.reason
        return True

    def _is_near(self, state: OuterState) -> bool:
        """Whether jumps and penetration, -gradient by the recovery's identity, are small enough."""
        problem = self._problem
        gap = np.where(problem.inequality, np.maximum(-state.gradient, 0.0), np.abs(state.gradient))
        if self._lengths is None:
            self._lengths = _lengths(problem, state)
        share = gap / (problem.spread * problem.bodies.of_rows(self._lengths))
        worst = problem.comm.allreduce(float(share.max(initial=0.0)), op=MPI.MAX)
        return worst <= self._target.tolerance


def _solve_smalbe(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    guess: NDArray[np.float64] | None,
) -> Solution:
    """SMALBE-M around MPRGP on the projected, homogenised dual."""
    assert problem.coarse is not None
    restart = checkpoint.load(problem) if checkpoint else None
    start, counts, saver = None, Counts(), Saver(checkpoint)
    if restart is None or not restart.rho:
        found, answer = _from_first_face(problem, target, inner, restart, monitor, saver, guess)
        if guess is not None and found.state is None:  # what touched does not keep some body
            guess, counts = None, found.counts
            saver = saver.after(counts)
            found, answer = _from_first_face(problem, target, inner, restart, monitor, saver, None)
            found = replace(found, counts=counts + found.counts)
        if answer is not None:
            return replace(answer, counts=found.counts, warm=guess is not None)
        start, counts, restart = found.state, found.counts, None
    norm, products = estimate_norm(problem.projected, NORM_ACCURACY)
    counts = counts + Counts(norm_estimation=products)
    preconditioner = FacePreconditioner(problem, norm)
    inner = replace(
        inner,
        norm=norm,
        atol=problem.round_off,
        preconditioner=preconditioner,
        max_iterations=inner.max_iterations - counts.inner,
    )
    x0, multiplier0 = start.homogenised(problem) if start else (None, None)
    saver = Saver(checkpoint, counts)
    judge = _OuterJudge(problem, target, inner, monitor, saver)
    result = SMALBE(inner).solve(
        BoxQP(problem.projected, problem.rhs, lower=problem.lower),
        ProjectorEquality(problem.coarse, preconditioner.set_penalty),
        x0=x0,
        multiplier0=multiplier0,
        monitor=monitor,
        accept=judge.accepts,
        save=lambda state: saver.after(judge.spent)(state),
        restart=restart,
        due=lambda: saver.due,
    )
    answer = judge.answer
    if answer is None or result.reason is not Reason.ACCEPTED:
        answer = judge.certify(result.x, result.multiplier)
    counts = counts + judge.spent + result.counts
    reason = judge.ended or result.reason
    return replace(answer, counts=counts, reason=reason, warm=guess is not None)


def _from_first_face(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    restart: Restart | None,
    monitor: Monitor | None,
    saver: Saver,
    guess: NDArray[np.float64] | None,
) -> tuple[Outcome, Solution | None]:
    """Faces from a first one on, or from where a stopped solve had come to.

    The first is what pushes in a guess of the multipliers; without one it is all contact where
    bodies lie flat, since rigid subdomains do not bulge, else what touches when all subdomains are
    rigid, on springs. What is saved of a face is λ itself and what touches on it, without a
    multiplier of Gλ = e.
    """
    multiplier, before, fewer = guess, Counts(), None
    if restart is not None:
        multiplier, before = restart.x, restart.counts
        touching = problem.inequality & (restart.multiplier > 0.5)
    elif multiplier is not None:
        touching = problem.inequality & (multiplier > 0.0)
    elif lies_flat(problem):
        touching, fewer = problem.inequality, partial(bedded, problem)
    else:
        touching = bedded(problem)

    saver = saver.after(before)

    def save(state: State, spent: Counts) -> None:
        saver(without_outer_iterations(state.multiplier, state.touching, spent))

    keep = Keep(lambda: saver.due, save)
    found, answer = _on_faces(problem, target, inner, multiplier, touching, monitor, keep, fewer)
    return replace(found, counts=before + found.counts), answer


def _solve_mprgp(
    problem: DualProblem,
    target: Target,
    inner: MPRGP,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    start: NDArray[np.float64] | None,
) -> Solution:
    """MPRGP alone; without bounds it is the conjugate gradient method."""
    qp, columns = BoxQP(problem.projected, problem.rhs, lower=problem.lower), 0
    inner, before = replace(inner, atol=problem.round_off), Counts()
    restart = checkpoint.load(problem) if checkpoint else None
    if restart is not None:
        start, before = restart.x, restart.counts
    if problem.coarse is None and problem.one_sided:
        inner = replace(inner, memory=MEMORY)
        if start is None:
            start, columns = on_columns(problem)
    if start is not None and problem.coarse is not None:
        start = start - problem.offset
        problem.coarse.project(start, start)
    answer: Solution | None = None

    def certify(x: NDArray[np.float64]) -> Solution:
        nonlocal answer
        answer = target.judge(_answer(problem, target, x, None))
        return answer

    before = before + Counts(hessian=columns)
    saver = Saver(checkpoint, before)

    def watch(it: Iterate) -> None:
        if saver.due:
            none = np.zeros(problem.size, bool)
            saver(without_outer_iterations(problem.offset + it.x, none, replace(it.counts)))

    result = inner.solve(
        qp, x0=start, monitor=monitor, accept=lambda x: certify(x).converged, watch=watch
    )
    if answer is None or not answer.converged:
        answer = certify(result.x)
    counts = before + result.counts
    return replace(answer, counts=counts, reason=result.reason)


def _answer_of(problem: DualProblem, target: Target, state: State) -> Solution:
    """The answer that a face's solution stands for, judged."""
    multiplier = feasible_multiplier(problem, state.multiplier, state.touching)
    return target.judge(
        _certified(problem, multiplier, state.motions, target.tolerance, target.relaxations)
    )


def _answer(
    problem: DualProblem,
    target: Target,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
) -> Solution:
    """`certified_answer` held against what a target asks for now."""
    return certified_answer(problem, x, equality_force, target.tolerance, target.relaxations)


def certified_answer(
    problem: DualProblem,
    x: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
    tolerance: float,
    relaxations: int = 0,
) -> Solution:
    """Recover and certify what an iterate of the solver stands for.

    Contact rows above their bound carry force.

    Parameters
    ----------
    tolerance
        What the certificate is held against.
    relaxations
        Of the certificate: steps that sharpen the duality gap.
    """
    balanced = x.copy()
    if problem.coarse is not None:
        problem.coarse.project(x, balanced)
    touching = np.zeros(problem.size, bool)
    if problem.lower is not None:
        touching = x > problem.lower
    multiplier = feasible_multiplier(problem, problem.offset + balanced, touching)
    alpha = kernel_coefficients(problem, multiplier, equality_force)
    return _certified(problem, multiplier, alpha, tolerance, relaxations)


def _certified(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    alpha: NDArray[np.float64],
    tolerance: float,
    relaxations: int,
) -> Solution:
    u = recover(problem, multiplier, alpha)
    certificate, measures = certify(problem, multiplier, u, tolerance, relaxations)
    return Solution(multiplier, u, certificate, measures, Counts(), Reason.CONVERGED, tolerance)


def _lengths(problem: DualProblem, state: OuterState) -> NDArray[np.float64]:
    """Estimate of the displacement of each body, (bodies,), from an iterate far from the answer."""
    multiplier = problem.offset + state.x
    alpha = kernel_coefficients(problem, multiplier, state.transposed_multiplier)
    return problem.lengths(interface_displacements(problem, multiplier, alpha))
