"""SMALBE-M around MPRGP to a certified answer.

Two ways. `solve_as_in_the_paper` is the algorithm of Kružík et al. (2020): the rules of its section
5.1, MPRGP with the named expansion, from zero, no preconditioner. `solve_by_smalbe` goes on where
active sets do not settle, from where they stand, with this solver's own rules and with the
preconditioner of the active sets; its active sets are tried once more on the way.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.contact.active_set import Outcome, Start, StateSaver
from solver.contact.answers import answer_of_iterate
from solver.contact.by_active_sets import solve_from
from solver.contact.checkpoint import Saver
from solver.contact.solution import Solution
from solver.contact.task import Task
from solver.qp.box_qp import BoxQP
from solver.qp.operators import estimate_norm
from solver.qp.result import Counts, Reason
from solver.qp.smalbe import SMALBE, OuterState, Restart
from solver.tfeti.active_set_problem import State
from solver.tfeti.bodies import body_lengths
from solver.tfeti.dual import DualProblem
from solver.tfeti.preconditioner import FacePreconditioner
from solver.tfeti.projected import ProjectorEquality
from solver.tfeti.recovery import interface_displacements, kernel_coefficients

METHOD = "smalbe"

NORM_ACCURACY = 1e-2
"""Relative change at which the power method for ‖PFP‖ ends; penalty and M need no better."""

PATIENCE = 16
"""Outer iterations after which a slow SMALBE hands its active set over once more."""


def solve_as_in_the_paper(task: Task) -> Solution:
    """The paper's algorithm from zero, or from where a stopped solve had come to (collective)."""
    problem = task.problem
    assert problem.coarse is not None
    norm, products = estimate_norm(problem.projected)
    counts = Counts(norm_estimation=products)
    saver = Saver(task.checkpoint, counts)
    judge = _OuterJudge(task, saver, hands_over=False)
    result = SMALBE.paper(replace(task.inner, norm=norm, atol=problem.round_off)).solve(
        BoxQP(problem.projected, problem.rhs, lower=problem.lower),
        ProjectorEquality(problem.coarse),
        monitor=task.monitor,
        accept=judge.accepts,
        save=saver,
        restart=task.checkpoint.load(problem) if task.checkpoint else None,
        due=lambda: saver.due,
    )
    answer = judge.answer
    if answer is None or result.reason is not Reason.ACCEPTED:
        answer = judge.certify(result.x, result.multiplier)
    return replace(answer, counts=counts + result.counts, reason=result.reason, method=METHOD)


def solve_by_smalbe(task: Task, before: Outcome | None, restart: Restart | None) -> Solution:
    """Go on where active sets did not settle, or where a stopped SMALBE had come to (collective).

    Parameters
    ----------
    before
        What the active sets came to, and their work.
    """
    problem = task.problem
    assert problem.coarse is not None
    norm, products = estimate_norm(problem.projected, NORM_ACCURACY)
    spent = before.counts if before is not None else Counts()
    counts = spent + Counts(norm_estimation=products)
    preconditioner = FacePreconditioner(problem, norm)
    inner = replace(
        task.inner,
        norm=norm,
        atol=problem.round_off,
        preconditioner=preconditioner,
        max_iterations=task.inner.max_iterations - counts.inner,
    )
    start = before.state if before is not None else None
    x0, multiplier0 = start.homogenised(problem) if start else (None, None)
    saver = Saver(task.checkpoint, counts)
    judge = _OuterJudge(replace(task, inner=inner), saver, hands_over=True)
    result = SMALBE(inner).solve(
        BoxQP(problem.projected, problem.rhs, lower=problem.lower),
        ProjectorEquality(problem.coarse, preconditioner.set_penalty),
        x0=x0,
        multiplier0=multiplier0,
        monitor=task.monitor,
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
    return replace(answer, counts=counts, reason=reason, method=METHOD)


class _OuterJudge:
    """Decides after each outer iteration of SMALBE whether its answer will do.

    Its active set is handed over to the active-set loop after the first one where contact alone
    holds a body, for which the sets tried before began with a guess, and later where SMALBE is
    slow. An answer of SMALBE's own is certified where its jumps and its penetration are small
    enough for a certificate to have a chance.

    Attributes
    ----------
    answer
        The last answer that was certified, or None.
    ended
        Why, where active sets ended the solve.
    spent
        Work of the active sets that were tried.
    """

    def __init__(self, task: Task, saver: Saver, hands_over: bool) -> None:
        self.answer: Solution | None = None
        self.ended: Reason | None = None
        self.spent = Counts()
        self._task, self._saver, self._hands_over = task, saver, hands_over
        self._problem, self._rule = task.problem, task.rule
        self._lengths: NDArray[np.float64] | None = None
        self._residuals: list[float] = []
        self._next_certificate = self._failures = 0

    def certify(self, x: NDArray[np.float64], force: NDArray[np.float64]) -> Solution:
        """The answer that an iterate and its force Cᵀ μ stand for."""
        answer = answer_of_iterate(self._problem, self._rule, x, force)
        self._lengths = body_lengths(
            self._problem.bodies, answer.measures.displacements, self._problem.free_lengths
        )
        self.answer = self._rule.judge(answer)
        return self.answer

    def accepts(self, state: OuterState) -> bool:
        """Whether `answer` meets the tolerance, or the solve was stopped (collective)."""
        problem = self._problem
        self._residuals.append(state.residual_norm)
        outer = len(self._residuals)
        if self._is_near(state) and state.counts.hessian >= self._next_certificate:
            tolerance = self._rule.tolerance
            if self.certify(state.x, state.transposed_multiplier).converged:
                return True
            if self._rule.tolerance == tolerance:
                wait = min(self._failures, self._rule.patience)
                self._next_certificate = state.counts.hessian + wait
                self._failures += 1
        if not self._hands_over:
            return False
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

        active = problem.inequality & (state.x > problem.lower)
        start = Start(active, problem.offset + state.x)
        found, answer = solve_from(self._task, start, StateSaver(lambda: self._saver.due, keep))
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
        return worst <= self._rule.tolerance


def _lengths(problem: DualProblem, state: OuterState) -> NDArray[np.float64]:
    """Estimate of the displacement of each body, (bodies,), from an iterate far from the answer."""
    multiplier = problem.offset + state.x
    alpha = kernel_coefficients(problem, multiplier, state.transposed_multiplier)
    return problem.lengths(interface_displacements(problem, multiplier, alpha))
