"""Active sets to a certified answer."""

from dataclasses import replace
from functools import partial

import numpy as np

from solver.contact.active_set import Start
from solver.contact.checkpoint import Saver
from solver.contact.retries import solve_with_retries
from solver.contact.solution import Guess, Solution
from solver.contact.solve_on_set import Outcome, SaveState
from solver.contact.stopping import CertificateTest, StoppingRule
from solver.problem.certify import friction_residual
from solver.problem.contact_law import FLAT, SURE
from solver.problem.duality_gap import duality_gap
from solver.problem.task import Task, saved_by
from solver.qp.outer_state import Restart
from solver.qp.result import Counts, Reason
from solver.tfeti.active_set_problem import State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.dual import DualProblem
from solver.tfeti.friction_share import may_hold
from solver.tfeti.methods.answers import answer_of_state
from solver.tfeti.winkler import winkler_contact
from solver.vectors import largest_magnitude

METHOD = "active-set"

ENDS = (Reason.ACCEPTED, Reason.STOPPED, Reason.MAX_ITERATIONS, Reason.SLIDES)
"""Reasons for which active sets end a solve; after other reasons SMALBE-M may go on.

It also goes on after `SLIDES` if friction at the contact forces of the answer holds the loads.
"""

LOOSE = 1e-2
"""Share of an iterate's jumps that may remain in û where the duality gap is only an estimate."""


def solve_from_first_set(
    task: Task[DualProblem], restart: Restart | None, saver: Saver, guess: Guess | None
) -> tuple[Outcome[State], Solution | None]:
    """Solve by active sets, from an initial set or the state of an interrupted solve (collective).

    The initial active set has the rows with compressive multipliers of a guess. Without a guess it
    is every contact row if all gaps are zero, since rigid subdomains do not bulge, and otherwise
    the contact of rigid subdomains on a Winkler foundation. A guess that does not hold some body is
    dropped.

    Returns
    -------
    The outcome of the loop and the certified answer; None where SMALBE-M has to go on.
    """
    problem, before = task.problem, Counts()
    if restart is None:
        start = initial_active_set(problem, guess)
    else:
        start, before = (
            Start(problem.inequality & (restart.multiplier > 0.5), restart.x),
            restart.counts,
        )
    outcome, answer = solve_from(task, start, saved_by(saver.after(before)))
    if guess is not None and outcome.state is None:
        before, guess = before + outcome.counts, None
        start = initial_active_set(problem, None)
        outcome, answer = solve_from(task, start, saved_by(saver.after(before)))
    outcome = replace(outcome, counts=before + outcome.counts)
    if answer is not None:
        answer = replace(answer, counts=outcome.counts, warm=guess is not None)
    return outcome, answer


def initial_active_set(problem: DualProblem, guess: Guess | None) -> Start:
    """The initial data of the loop (collective).

    Parameters
    ----------
    guess
        The answer to a nearly equal problem; None if there is none.
    """
    if guess is not None:
        active = problem.inequality & (guess.multiplier > 0.0)
        return Start(active, guess.multiplier, jumps=guess.jumps)
    if gaps_are_zero(problem):
        return Start(problem.inequality, is_flat=True)
    return Start(winkler_contact(problem))


def gaps_are_zero(problem: DualProblem) -> bool:
    """Whether all gaps are zero before any load and no two rows overlap (collective)."""
    comm, points = problem.comm, problem.contact.points
    size = largest_magnitude(comm, points)
    has_gap = np.abs(problem.contact.gaps) > FLAT * size
    overlaps = problem.overlap[problem.inequality] > 1.0 + FLAT
    return not comm.allreduce(int((has_gap | overlaps).sum()))


def solve_from(
    task: Task[DualProblem], start: Start, save: SaveState[State]
) -> tuple[Outcome[State], Solution | None]:
    """The loop from an initial active set, with the certificate as its test (collective).

    Returns
    -------
    The outcome and the certified answer (the best one if the loop was stopped); None where the sets
    did not settle.
    """
    test = CertificateTest(
        task.rule,
        partial(answer_of_state, task.problem, task.rule),
        partial(_required_reduction, task.problem, task.rule),
    )
    method = task.active_set_method(TotalFeti(task.problem), test, save)
    outcome = solve_with_retries(method, start)
    if outcome.reason not in ENDS:
        return outcome, None
    answer = test.answer
    if outcome.reason is not Reason.ACCEPTED:
        assert outcome.state is not None
        answer = test.certified(outcome.state)
    assert answer is not None
    if outcome.reason is Reason.SLIDES and may_hold(task.problem, answer):
        return outcome, None
    return outcome, replace(answer, reason=outcome.reason, method=METHOD)


def _required_reduction(problem: DualProblem, rule: StoppingRule, state: State) -> float:
    """Factor by which jumps, friction numbers and duality gap of a state have to fall (collective).

    The gap is that of the multiplier without tensile contact forces.
    """
    worst = problem.largest_distance(state)
    multiplier = state.multiplier.copy()
    multiplier[problem.inequality] = np.maximum(multiplier[problem.inequality], 0.0)
    lengths = problem.lengths(state.displacements)

    def gap() -> float:
        return duality_gap(problem, multiplier, state.displacements, LOOSE)

    worst = max(worst, friction_residual(problem, multiplier, state.jumps, lengths) / SURE)
    return rule.required_reduction(worst, state.strained, gap)
