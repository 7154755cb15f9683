"""Solve a dual problem with the cheapest method it admits, until the certificate passes.

`solver.method: auto` chooses by the problem: without contact rows projected conjugate gradients;
without a coarse problem MPRGP on the contact rows alone; without any rows one solve. A problem with
both is solved by active sets (`solver.contact.active_set`). If all gaps are zero, the solver starts
with every contact row active. Otherwise it starts from the contact of rigid subdomains on a Winkler
foundation (`solver.tfeti.winkler`). Where the sets do not settle, SMALBE-M, whose convergence is
proved, goes on to the end. Each method ends when the answer, not a dual residual, meets the
tolerance: an approximate answer is recovered and certified, and if it falls short the solve goes on
from where it stands.

`active-set` does the same without SMALBE-M behind it. `smalbe` is the algorithm of Kružík et al.
(2020) and nothing else: SMALBE-M with the paper's rules around MPRGP with the named expansion, from
zero, without a preconditioner. Friction is no part of the paper: with it `smalbe` has the rules and
the preconditioner of `auto`, without active sets.

`primal` solves for the displacements of undecomposed bodies (`solver.primal`), also by active sets.
Its problems are made without factors, which is how the driver knows them.
"""

from dataclasses import replace

import numpy as np

from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.checkpoint import Checkpoint, Saver, without_outer_iterations
from solver.contact.monitoring import with_bounds
from solver.contact.options import Method, SolverOptions
from solver.contact.solution import Guess, Solution
from solver.contact.stopping import Assess, stopping_rule
from solver.problem.answer import certified, without_rounded_forces
from solver.problem.least_motion import with_least_motion
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from solver.qp.result import Monitor, Reason
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.answers import answer_of_state, certified_answer
from solver.tfeti.methods.by_active_sets import METHOD, solve_from_first_set
from solver.tfeti.methods.by_mprgp import solve_by_mprgp
from solver.tfeti.methods.by_smalbe import solve_as_in_the_paper, solve_by_smalbe

INNER = 0.1
"""Residual over the right-hand side of the dual problem, for one unit of the tolerance."""

ROUNDED_AWAY = (
    "Rounding errors stop the solver: the bodies are so much more compliant to some forces than to "
    "others that displacements under the latter have no correct digits."
)
"""Reason where the dual problem seems unbounded.

Equilibrium was checked before, so only rounding errors can make it seem so.
"""


def reason_text(solution: Solution) -> str:
    """The reason why the solve ended, as a sentence for the user."""
    if solution.converged:
        return "Every number of the certificate is below the tolerance."
    if solution.reason is Reason.STOPPED:
        return "The run was interrupted; the results reached so far are written."
    if solution.reason is Reason.DIVERGED:
        return ROUNDED_AWAY
    if solution.reason is Reason.MAX_OUTER_ITERATIONS:  # constraints of a scene are consistent
        return (
            "SMALBE-M reached its limit of outer iterations before the tolerance; with friction it "
            "need not converge. A looser solver.tolerance may help, or another solver.method. If "
            "friction alone holds a body, smaller loads may help: it may slide away."
        )
    if solution.reason.converged:
        return "Rounding errors keep the certificate from coming below the tolerance."
    return str(solution.reason.value)


def solve(
    problem: DualProblem,
    options: SolverOptions,
    monitor: Monitor | None = None,
    checkpoint: Checkpoint | None = None,
    assess: Assess | None = None,
    start: Guess | None = None,
    active_sets: ActiveSetOptions | None = None,
) -> Solution:
    """Solve to `options.tolerance`, as the certificate measures it (collective).

    Parameters
    ----------
    checkpoint
        Saves the state at due steps, and gives the state from which an interrupted solve goes on.
        It also holds the final state of the solve for a run that is stopped later.
    assess
        Estimates the errors of an answer; an automatic tolerance needs it.
    start
        Initial guess; the paper's algorithm ignores it and begins at zero.
    active_sets
        Options of the active-set loop.
    """
    rule = stopping_rule(options, assess)
    if problem.factored and problem.comm.allreduce(problem.size) == 0:
        return rule.judge(certified_answer(problem, np.zeros(0), None, rule.tolerance))
    inner = MPRGP(
        expansion=options.expansion,
        alpha_u=options.alpha_u,
        gamma=options.gamma,
        rtol=INNER * rule.tolerance,
        max_iterations=options.max_iterations,
    )
    contact_rows = problem.comm.allreduce(int(problem.inequality.sum()))
    monitor = with_bounds(monitor, contact_rows)
    task = Task(problem, rule, inner, monitor, checkpoint, active_sets or ActiveSetOptions())
    solution = _solved(task, options.method, start)
    if problem.factored:
        solution = without_rounded_forces(problem, rule, solution)
    if checkpoint is not None and solution.reason is not Reason.STOPPED:
        active = problem.inequality & (solution.multiplier > 0.0)
        checkpoint.hold(without_outer_iterations(solution.multiplier, active, solution.counts))
    return with_least_motion(problem, solution)


def _rests(problem: DualProblem, start: Guess | None) -> bool:
    """Whether nothing loads the bodies and all rows hold without displacements (collective).

    Slips before count only at points that the answer before, the initial guess, gave a slip limit.
    """
    loads, rows, points = problem.load_case, problem.inequality, problem.friction
    unmet = np.where(rows, np.minimum(problem.c, 0.0), problem.c)
    if start is not None:
        unmet[points.rows] *= (points.slip_limits(start.multiplier) > 0.0)[points.point]
    moved = unmet.any() or any(values.any() for values in (*loads.forces, *loads.lifting))
    return not problem.comm.allreduce(int(moved))


def _at_rest(task: Task[DualProblem]) -> Solution:
    """The answer without displacements and forces, with its certificate (collective)."""
    problem, rule = task.problem, task.rule
    rest = np.zeros(problem.size), [np.zeros_like(forces) for forces in problem.forces]
    return rule.judge(certified(problem, *rest, rule.tolerance))


def _solved(task: Task[DualProblem], method: Method, start: Guess | None) -> Solution:
    """The answer of a method (collective)."""
    problem = task.problem
    if _rests(problem, start):
        return _at_rest(task)
    if not problem.factored:
        from solver.primal.by_active_sets import solve_by_multigrid

        return solve_by_multigrid(task, start, task.restart())
    if method == "smalbe":
        if problem.coarse is not None and problem.friction.acts:
            return solve_by_smalbe(task, None, task.restart(), active_sets=False)
        if problem.coarse is not None:
            return solve_as_in_the_paper(task)
        return replace(solve_by_mprgp(task, None, accelerated=False), method=method)
    if problem.coarse is None or not problem.one_sided:
        return solve_by_mprgp(task, None if start is None else start.multiplier)
    restart = task.restart()
    if restart is not None and restart.rho:
        return solve_by_smalbe(task, None, restart)
    outcome, answer = solve_from_first_set(task, restart, Saver(task.checkpoint), start)
    if answer is not None:
        return answer
    if method == "auto":
        return solve_by_smalbe(task, outcome, None)
    if outcome.state is None:  # nothing better than the loads shared out among the constraints
        answer = certified_answer(problem, np.zeros(problem.size), None, task.rule.tolerance)
    else:
        answer = answer_of_state(problem, task.rule, outcome.state)
    return replace(answer, counts=outcome.counts, reason=Reason.UNSETTLED, method=METHOD)
