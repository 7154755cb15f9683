"""Primal-dual active sets.

The contact rows of the active set hold with equality, and the multipliers of the other rows are
prescribed; a backend (`solver.backend`) solves this problem. The solution of the right active set
is the solution of the contact problem. `active_set_loop` looks for this set (Hintermüller, Ito,
Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, 2002).

`solve_on_set` solves on a set only as accurately as the next decision needs, and evaluates its KKT
residuals. By `ActiveSetUpdate`, rows whose tensile multiplier exceeds the error leave the set, and
rows that are penetrated by more than the error join it. Where the sets do not settle,
`solver.contact.retries` begins the loop anew with other rules, and the caller at last goes on with
SMALBE-M.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Generic

import numpy as np
from mpi4py import MPI

from solver.backend import Backend, S, Statuses
from solver.contact.active_set_options import ActiveSetOptions, Failure, Turnover
from solver.contact.active_set_update import ActiveSetUpdate, SetRules, changed_rows
from solver.contact.law import ContactLaw
from solver.contact.loop_state import LoopState
from solver.contact.monitoring import on_active_set
from solver.contact.solve_on_set import Outcome, SaveState, StoppingTest, solve_on_set
from solver.errors import QPError
from solver.qp.iterate import Iterate
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.vectors import Array, Mask


@dataclass(frozen=True, eq=False)
class Start:
    """Initial data of the loop."""

    active: Mask  # (rows,)
    """The normal rows of the initial active set."""
    multiplier: Array | None = None  # (rows,)
    """Initial multiplier of the first set; the smallest multiplier in equilibrium if None."""
    is_flat: bool = False
    """Whether the first set has all contact rows because all gaps are zero. If many of them open in
    the first two sets, only those of `Backend.estimated_contact` stay: the loop alone would remove
    row after row."""
    statuses: Statuses | None = None
    """Statuses of the first set; those that the law takes from `active` if None."""
    jumps: Array | None = None  # (rows,)
    """B u - c near that of the first set; None if unknown."""


@dataclass(frozen=True, eq=False)
class ActiveSetMethod(Generic[S]):
    """The method of active sets for one problem."""

    backend: Backend[S]
    """Solves on a set."""
    test: StoppingTest[S]
    """Accepts or rejects the answer of a set."""
    inner: MPRGP
    """MPRGP; it limits the iterations of all sets together."""
    monitor: Monitor | None = None
    """Called with each iteration."""
    save: SaveState[S] | None = None
    """Saves states for a checkpoint."""
    options: ActiveSetOptions = ActiveSetOptions()
    law: ContactLaw = ContactLaw()
    work_before: Counts = field(default_factory=Counts)
    """Work before the first set."""

    def after(self, outcome: Outcome[S]) -> "ActiveSetMethod[S]":
        """The same method after an outcome, whose work counts."""
        return replace(self, work_before=outcome.counts)

    def with_options(self, **options: Any) -> "ActiveSetMethod[S]":
        """The same method with other options."""
        return replace(self, options=replace(self.options, **options))


def active_set_loop(method: ActiveSetMethod[S], start: Start) -> tuple[Outcome[S], Failure | None]:
    """Solve on active sets, one after another, until an answer is accepted (collective).

    Returns
    -------
    The last outcome with the work of all sets, and the reason if the sets did not settle. The
    caller may then go on with SMALBE-M, whose convergence is proved.
    """
    loop = _initial_active_set(method, start)
    for _ in range(method.options.most_sets):
        loop = _with_rules(method, loop)
        loop, solved = _solve_and_evaluate_kkt(method, loop)
        if solved is None or solved.released is None:  # a body is not held, or no row changes
            return loop.result, _failure_at_end(method, start, loop)
        loop = _with_changes(method, loop, solved)
        failure = method.law.failure(method.options, loop.history, start.multiplier is None)
        if failure is not None:
            return loop.result, failure
        loop = _update_set(method, start, loop, solved)
    return loop.result, _failure_at_end(method, start, loop)


def _initial_active_set(method: ActiveSetMethod[S], start: Start) -> LoopState[S]:
    """The state before the first set."""
    backend, options, law = method.backend, method.options, method.law
    levels = backend.hierarchy(coarsened=False)
    update = ActiveSetUpdate(backend, levels, law, options, options.early_release)
    coarsened = start.multiplier is not None or not law.settles
    statuses = start.statuses or law.initial(
        start.active, start.multiplier, options.early_release, start.jumps
    )
    return LoopState(
        SetRules(update, options.first_reduction, coarsened),
        statuses,
        start.multiplier,
        Outcome(None, None, statuses, method.work_before),
        method.work_before,
    )


def _with_rules(method: ActiveSetMethod[S], loop: LoopState[S]) -> LoopState[S]:
    """The state with the rules of its set, and statuses that follow from these (collective).

    Sliding points yield where all points slide and many stuck again after two such sets.
    """
    rules, statuses = loop.rules.for_set(loop.number, loop.statuses, loop.history.turnovers)
    loop = replace(loop, rules=rules, statuses=statuses)
    law, backend, state = method.law, method.backend, loop.outcome.state
    if state is None or statuses.tractions is None:  # no point may slide
        return loop
    tangential, share = ~backend.contact_rows, method.options.stuck_again
    loop = replace(loop, sliding=loop.sliding.after(backend.comm, statuses, tangential, share))
    if not loop.sliding.yielded:
        return loop
    return replace(loop, statuses=law.yielding(statuses, state.jumps) or statuses)


def _solve_and_evaluate_kkt(
    method: ActiveSetMethod[S], loop: LoopState[S]
) -> tuple[LoopState[S], Outcome[S] | None]:
    """Solve on the set until its KKT residuals decide on the next one (collective).

    If the set leaves a body unheld, sliding points yield like springs; after many such sets
    friction is said not to hold the body.

    Returns
    -------
    The state after the solve, and the outcome on the set; None where the set leaves a body unheld.
    """
    outcome, unheld = _outcome_on_set(method, loop), loop.unheld
    state, statuses = loop.outcome.state, None
    if outcome is None and state is not None:
        statuses = method.law.yielding(loop.statuses, state.jumps)
    if statuses is not None:
        unheld += 1
        if unheld == method.options.sliding:
            return replace(loop, outcome=replace(loop.outcome, reason=Reason.SLIDES)), None
        loop = replace(loop, statuses=statuses)
        outcome = _outcome_on_set(method, loop)
    elif outcome is not None:
        unheld = 0
    if outcome is None:
        return loop, None
    method.backend.release()
    counts = loop.counts + outcome.counts
    return replace(loop, outcome=outcome, counts=counts, unheld=unheld), outcome


def _outcome_on_set(method: ActiveSetMethod[S], loop: LoopState[S]) -> Outcome[S] | None:
    """Solve on one set, after the work of earlier sets (collective).

    Returns
    -------
    The outcome with the work on this set. It has no state where the active rows constrain a body
    too weakly: rounding errors exceed its resistance. None where they leave a body free.
    """
    backend, before, save = method.backend, loop.counts, method.save
    try:
        on_set = backend.on_set(loop.statuses, loop.multiplier)
    except ArithmeticError:
        return None
    inner = replace(method.inner, max_iterations=method.inner.max_iterations - before.inner)

    def watch(it: Iterate) -> None:
        if save is not None:
            save(on_set.state, before + on_set.counts)

    active = backend.comm.allreduce(int(loop.statuses.active.sum()))
    monitor = on_active_set(method.monitor, loop.number + 1, active, before.inner)
    try:
        return solve_on_set(on_set, loop.rules, method.test, inner, monitor, watch)
    except QPError:
        return Outcome(None, None, loop.statuses, on_set.counts)


def _with_changes(
    method: ActiveSetMethod[S], loop: LoopState[S], solved: Outcome[S]
) -> LoopState[S]:
    """The state with the rows in its history that change after a set (collective)."""
    assert solved.state is not None
    assert solved.released is not None
    assert solved.hierarchy is not None
    turnover = _turnover(method.backend, loop.statuses, solved.following)
    return replace(
        loop,
        rules=loop.rules.on_level(solved.hierarchy),
        history=loop.history.after(turnover, solved.hierarchy.finest, solved.state.strained),
        released=loop.released or bool(solved.released.any()),
    )


def _failure_at_end(method: ActiveSetMethod[S], start: Start, loop: LoopState[S]) -> Failure | None:
    """The reason why the last set has no answer; None if it has one (collective)."""
    if loop.outcome.reason not in (None, Reason.SLIDES):
        return None
    comm, ahead = method.backend.comm, method.options.early_release
    released = comm.allreduce(int(loop.released)) or (
        ahead and _begins_ahead(comm, start, method.law)
    )
    return Failure.AHEAD if released else Failure.OTHER


def _begins_ahead(comm: MPI.Intracomm, start: Start, law: ContactLaw) -> bool:
    """Whether the law lets points slide in the first set that it could let stick (collective)."""
    one, other = (law.initial(start.active, start.multiplier, ahead) for ahead in (True, False))
    return changed_rows(comm, one, other) > 0


def _update_set(
    method: ActiveSetMethod[S], start: Start, loop: LoopState[S], solved: Outcome[S]
) -> LoopState[S]:
    """The state with the next set, by the KKT residuals of the last one (collective).

    Where flat contact opens in the first two sets, only the estimated contact stays. Where many
    rows leave, the backend may correct the set. Where forces of friction and contact only cause
    each other, all contact opens.
    """
    backend, options = method.backend, method.options
    assert solved.state is not None
    statuses, history, turnovers = solved.following, loop.history, loop.history.turnovers
    multiplier: Array | None = solved.state.multiplier
    if start.is_flat and len(turnovers) == 2 and options.all_peel(turnovers):
        statuses = _with_contact(method, statuses, backend.estimated_contact())
    elif method.law.settles and loop.rules.update.hierarchy.finest and options.drops(turnovers[-1]):
        corrected = backend.corrected_contact(solved.state.multiplier)
        if corrected is not None:
            active = np.where(backend.contact_rows, corrected, statuses.active)
            statuses = replace(statuses, active=active)
    if method.law.may_vanish and options.vanish(history.strained):
        statuses = _with_contact(method, statuses, np.zeros_like(statuses.active))
        multiplier, history = None, replace(history, strained=())
    return replace(
        loop, number=loop.number + 1, statuses=statuses, multiplier=multiplier,
        history=history,
    )  # fmt: skip


def _with_contact(method: ActiveSetMethod[S], statuses: Statuses, contact: Mask) -> Statuses:
    """The statuses without the contact rows outside of a mask (rows,) (collective)."""
    active = statuses.active & (contact | ~method.backend.contact_rows)
    return method.law.consistent(replace(statuses, active=active))


def _turnover(backend: Backend[S], statuses: Statuses, following: Statuses) -> Turnover:
    """Contact rows that join and leave with the next set (collective)."""
    rows = backend.contact_rows
    active, next_active = statuses.active & rows, following.active & rows
    counts = [(next_active & ~active).sum(), (active & ~next_active).sum(), active.sum()]
    joined, left, closed = backend.comm.allreduce(np.array(counts))
    return Turnover(int(joined), int(left), int(closed))
