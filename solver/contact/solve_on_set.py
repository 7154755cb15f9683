"""The solve on one active set, until the set has to change or its answer is accepted.

A set is solved only as accurately as the next decision needs: after a first reduction of the
residual the contact law decides from the state which rows change. Only a set that needs no change
is solved until its answer passes the stopping test.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic

from solver.backend import ConstraintHierarchy, S, SetSolve, Statuses
from solver.contact.active_set_update import SetRules, changed_rows
from solver.qp.iterate import Watch
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.vectors import Mask

SaveState = Callable[[Callable[[], S], Counts], None]
"""Called at each step with a function that returns the state, and the work up to it.

It saves the state where that is due."""


@dataclass(frozen=True)
class StoppingTest(Generic[S]):
    """The test of the answer of a set; the same on all ranks."""

    required_reduction: Callable[[S], float]
    """Factor by which the error of a state has to fall before it is certified; one or less where
    the state should be certified now. Called again after each rejected answer."""
    accept: Callable[[S], bool]
    """Certifies the answer of a state and returns whether the certificate passes."""
    may_end_early: bool = False
    """Whether an answer may be accepted although its set still changes."""


@dataclass(frozen=True, eq=False)
class Outcome(Generic[S]):
    """Outcome of the solve on a set, or of the whole loop."""

    reason: Reason | None
    """`ACCEPTED`, another reason why the solver ended, or None where the set has to change."""
    state: S | None
    """The last evaluated state."""
    following: Statuses
    """The statuses of the next set."""
    counts: Counts
    """Work of the set, or of all of them."""
    released: Mask | None = None  # (rows,)
    """Tangential rows of points that the law released before the state showed that they slide; None
    if the set was not changed."""
    hierarchy: ConstraintHierarchy | None = None
    """Level of the constraint hierarchy that changed the set; None if it was not changed."""


def solve_on_set(
    on_set: SetSolve[S],
    rules: SetRules[S],
    test: StoppingTest[S],
    inner: MPRGP,
    monitor: Monitor | None = None,
    watch: Watch | None = None,
) -> Outcome[S]:
    """Solve on an active set until the set has to change, or its answer is accepted (collective).

    Parameters
    ----------
    rules
        Reduction of the residual before the first evaluation, and the update of the set.
    """
    update, options, comm = rules.update, rules.update.options, rules.update.backend.comm
    tolerance = rules.reduction * on_set.residual
    evaluations = 0
    while True:
        ended = on_set.solve(inner, tolerance, monitor, watch)
        state = on_set.state()
        if (
            ended.converged
            and not on_set.at_round_off  # without strains the relative error is one and stays one
            and on_set.error(state.strained) > options.largest_error
        ):
            tolerance *= options.tighten
            continue
        following, released, hierarchy = update.following(on_set, state)
        update = replace(update, hierarchy=hierarchy)
        if not (ended.converged or ended is Reason.ROUND_OFF):
            return Outcome(ended, state, following, on_set.counts)
        changes = changed_rows(comm, on_set.statuses, following)
        is_tested = test.may_end_early or not changes or not update.law.settles
        required = test.required_reduction(state) if is_tested else math.inf
        at_end = not changes and on_set.at_round_off
        if required <= 1.0 or at_end:
            if test.accept(state):
                return Outcome(Reason.ACCEPTED, state, following, on_set.counts)
            if at_end:
                return Outcome(Reason.ROUND_OFF, state, following, on_set.counts)
            required = max(test.required_reduction(state), options.margin / options.tighten)
        if changes:
            return Outcome(None, state, following, on_set.counts, released, hierarchy)
        evaluations += 1
        tolerance = options.margin * on_set.residual / max(required, 1.0)
        if test.may_end_early or evaluations < options.evaluations:
            tolerance = max(tolerance, options.next_reduction * on_set.residual)
