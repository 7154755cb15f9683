"""Active sets to a certified answer."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from solver.contact.active_set import (
    ActiveSetOptions,
    Outcome,
    Start,
    StateSaver,
    StoppingTest,
    active_set_loop,
)
from solver.contact.checkpoint import Saver, without_outer_iterations
from solver.contact.friction_law import Friction
from solver.contact.law import ContactLaw, Frictionless
from solver.contact.slip_front import SlipFront
from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.qp.outer_state import Restart
from solver.qp.result import Counts, Reason
from solver.tfeti.active_set_problem import State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.certify import friction_residual
from solver.tfeti.dual import DualProblem
from solver.tfeti.duality_gap import duality_gap
from solver.tfeti.methods.answers import answer_of_state
from solver.tfeti.methods.task import Task
from solver.tfeti.winkler import gaps_are_zero, winkler_contact

METHOD = "active-set"

ENDS = (Reason.ACCEPTED, Reason.STOPPED, Reason.MAX_ITERATIONS)
"""Why active sets end a solve; for other reasons SMALBE-M may go on."""

FRICTION = 1
"""Active sets that are tried with friction, over those without: slip limits take their own."""

PATIENCE = 12
"""Sets with friction after which each is solved further before it decides: 300 sets of a cube of
20³ cells on a rough wall wandered, decided at a tenth of their error. Six took 5 % more operator
applications (`contact_app.studies.friction_cost`), none at all as many."""

GIVE = 0.03
"""Compliance of a point that sticks while its node is closed in another contact, over that of the
node: slips of others fall to about that share in each set."""

LARGEST_ERROR = 0.3
"""Error at which sets with friction decide nothing: rows of sliding points with small slip limits
have large compliances, in which a small residual leaves a large error."""

SURE = 0.3
"""Share of the tolerance below which the certificate's numbers of friction have to be before it is
worth trying. It bounds them by the load, and the answer follows them: displacements of answers at
1e-6 were right to 9e-7, with 1 to 3e-6 only. Histories begin with the last answer, too."""

LOOSE = 1e-2
"""Share of an iterate's jumps that is left where its duality gap only tells how far it is."""


def solve_from_first_set(
    task: Task, restart: Restart | None, saver: Saver, guess: NDArray[np.float64] | None
) -> tuple[Outcome[State], Solution | None]:
    """Active sets from an initial one on, or from where a stopped solve had come to (collective).

    The initial active set is that of the compressive multipliers of a guess. Without a guess it is
    every contact row if all gaps are zero, since rigid subdomains do not bulge, and otherwise the
    contact of rigid subdomains on a Winkler foundation. A guess that does not hold some body is
    given up.

    Returns
    -------
    The outcome of the loop and the certified answer; None where SMALBE-M has to go on.
    """
    found, answer = _solve(task, restart, saver, guess)
    if guess is not None and found.state is None:
        before = found.counts
        found, answer = _solve(task, restart, saver.after(before), None)
        found, guess = replace(found, counts=before + found.counts), None
    if answer is not None:
        answer = replace(answer, counts=found.counts, warm=guess is not None)
    return found, answer


def _solve(
    task: Task, restart: Restart | None, saver: Saver, guess: NDArray[np.float64] | None
) -> tuple[Outcome[State], Solution | None]:
    """As `solve_from_first_set`, for one initial set."""
    start, before = initial_active_set(task.problem, guess), Counts()
    if restart is not None:
        active = task.problem.inequality & (restart.multiplier > 0.5)
        start, before = Start(active, restart.x), restart.counts
    saver = saver.after(before)

    def save(state: State, spent: Counts) -> None:
        saver(without_outer_iterations(state.multiplier, state.active, spent))

    found, answer = solve_from(task, start, StateSaver(lambda: saver.due, save))
    return replace(found, counts=before + found.counts), answer


def initial_active_set(problem: DualProblem, guess: NDArray[np.float64] | None) -> Start:
    """Where the loop begins (collective).

    Parameters
    ----------
    guess : (dual,)
        Multipliers of a problem that is nearly the same, None if there is none.
    """
    if guess is not None:
        return Start(problem.inequality & (guess > 0.0), guess)
    if gaps_are_zero(problem):
        return Start(problem.inequality, None, partial(winkler_contact, problem))
    return Start(winkler_contact(problem))


def solve_from(
    task: Task, start: Start, saver: StateSaver[State] | None
) -> tuple[Outcome[State], Solution | None]:
    """The loop from an initial active set, with the certificate as its test (collective).

    Returns
    -------
    The outcome, and the certified answer, or the best one where the loop was stopped; None where
    the sets did not settle.
    """
    test = _CertificateTest(task.problem, task.rule)
    asks = StoppingTest(test.required_reduction, test.accept, task.rule.may_end_early)
    law = contact_law(task.problem)
    options = options_of(task.problem, task.active_sets)
    found = active_set_loop(
        TotalFeti(task.problem), start, asks, task.inner, task.monitor, saver, options, law
    )
    if found.reason not in ENDS:
        return found, None
    answer = test.answer
    if found.reason is not Reason.ACCEPTED:
        assert found.state is not None
        answer = answer_of_state(task.problem, task.rule, found.state)
    assert answer is not None
    return found, replace(answer, reason=found.reason, method=METHOD)


def options_of(problem: DualProblem, options: ActiveSetOptions) -> ActiveSetOptions:
    """Those of the loop, with what friction changes of them."""
    if problem.friction is None:
        return options
    return replace(
        options,
        most_sets=FRICTION * options.most_sets,
        patience=PATIENCE,
        largest_error=LARGEST_ERROR,
    )


def contact_law(problem: DualProblem) -> ContactLaw:
    """The law of the contacts of a problem."""
    points = problem.friction
    if points is None:
        return Frictionless()
    give = None
    if problem.comm.allreduce(len(points.shared)):
        give = GIVE / problem.row_stiffness(problem.tangential)
    front = SlipFront(points, problem.comm, problem.held_without_contact)
    return Friction(points=points, comm=problem.comm, give=give, front=front)


class _CertificateTest:
    """Certifies answers of active sets, and tells how far a state is from a certificate.

    Attributes
    ----------
    answer
        The last answer that was certified.
    """

    def __init__(self, problem: DualProblem, rule: StoppingRule) -> None:
        self.answer: Solution | None = None
        self._problem, self._rule = problem, rule
        self._certified: State | None = None

    def accept(self, state: State) -> bool:
        """Whether the answer of a state passes (collective)."""
        self.answer = answer_of_state(self._problem, self._rule, state)
        self._certified = state
        return self.answer.converged

    def required_reduction(self, state: State) -> float:
        """Factor by which the error has to fall before a certificate is worth it (collective)."""
        problem, rule = self._problem, self._rule
        worst = state.worst(problem)
        multiplier = state.multiplier.copy()
        multiplier[problem.inequality] = np.maximum(multiplier[problem.inequality], 0.0)
        lengths = problem.lengths(state.displacements)

        def gap(sharp: bool) -> float:
            steps = rule.relaxations if sharp else 0
            return duality_gap(problem, multiplier, state.displacements, steps, LOOSE)

        worst = max(worst, friction_residual(problem, multiplier, state.jumps, lengths) / SURE)
        required = rule.required_reduction(worst, state.strained, gap)
        if state is self._certified and self.answer is not None:
            # the certificate knows more than the jumps
            required = max(required, rule.required_of_certified(self.answer))
        return required
