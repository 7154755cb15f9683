"""MPRGP alone to a certified answer, for problems without equalities besides the projector."""

from dataclasses import replace

import numpy as np

from solver.contact.checkpoint import Saver, without_outer_iterations
from solver.contact.solution import Solution
from solver.problem.task import Task
from solver.qp.box_qp import BoxQP
from solver.qp.iterate import Iterate
from solver.qp.result import Counts, Reason
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.answers import certified_answer
from solver.vectors import Array

METHOD = "mprgp"

STEPS_PER_ROW, FEWEST_STEPS = 2, 1000
"""Steps for undecomposed bodies after which rounding errors stop the solve: per row, and at least.
MPRGP takes fewer on random scenes, and does not end on a body 500 times as long as thick."""


def solve_by_mprgp(
    task: Task[DualProblem], start: Array | None, accelerated: bool = True
) -> Solution:
    """Solve by MPRGP; without contact rows it is the conjugate gradient method (collective).

    Parameters
    ----------
    start : (dual,)
        Initial multipliers.
    accelerated
        Whether the solve of undecomposed bodies spares the first multiplication, and stops at
        rounding errors; the paper's algorithm does neither.
    """
    problem, rule, checkpoint = task.problem, task.rule, task.checkpoint
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    inner, before = replace(task.inner, atol=problem.round_off), Counts()
    restart = task.restart()
    warm = start is not None
    if restart is not None:
        start, before = restart.x, restart.counts
    accelerated = accelerated and problem.coarse is None and problem.one_sided
    if accelerated:
        steps = max(FEWEST_STEPS, STEPS_PER_ROW * problem.comm.allreduce(problem.size))
        inner = replace(inner, max_iterations=min(inner.max_iterations, steps))
    if start is not None and problem.coarse is not None:
        start = start - problem.offset
        problem.coarse.project(start, start)
    answer: Solution | None = None

    def certify(x: Array) -> Solution:
        nonlocal answer
        answer = rule.judge(certified_answer(problem, x, None, rule.tolerance))
        return answer

    saver = Saver(checkpoint, before)

    def watch(it: Iterate) -> None:
        if saver.due:
            none = np.zeros(problem.size, bool)
            saver(without_outer_iterations(problem.offset + it.x, none, replace(it.counts)))

    result = inner.solve(
        qp,
        x0=start,
        monitor=task.monitor,
        accept=lambda x: certify(x).converged,
        watch=watch,
        from_zero=accelerated and start is None,
    )
    if answer is None or not answer.converged:
        answer = certify(result.x)
    counts, reason = before + result.counts, result.reason
    if reason is Reason.MAX_ITERATIONS and inner.max_iterations < task.inner.max_iterations:
        reason = Reason.DIVERGED
    return replace(answer, counts=counts, reason=reason, method=METHOD, warm=warm)
