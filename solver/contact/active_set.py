"""Primal-dual active sets.

The contact rows of the active set hold with equality, and the multipliers of the other rows are
prescribed; a backend (`solver.backend`) solves this problem. The solution of the right active set
is the solution of the contact problem. `active_set_loop` looks for this set (Hintermüller, Ito,
Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, 2002).

`_Run.sets` is the loop. `solve_on_set` solves on a set only as accurately as the next decision
needs, and evaluates its KKT residuals. By `ActiveSetUpdate`, rows whose tensile multiplier exceeds
the error leave the set, and rows that are penetrated by more than the error join it. Where the sets
do not settle, `active_set_loop` begins anew with other rules, and at last leaves the problem to
SMALBE-M.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Generic

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.backend import Backend, S, Statuses
from solver.contact.active_set_options import ActiveSetOptions, Turnover
from solver.contact.active_set_update import (
    ActiveSetUpdate,
    EarlyReleases,
    SetRules,
    changed_rows,
)
from solver.contact.law import ContactLaw, Frictionless, StateData
from solver.contact.monitoring import on_active_set
from solver.contact.solve_on_set import Outcome, StateSaver, StoppingTest, solve_on_set
from solver.errors import QPError
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Start:
    """Initial data of the loop.

    Attributes
    ----------
    active : (rows,)
        The normal rows of the initial active set.
    multiplier : (rows,)
        Initial multiplier of the first set; the smallest multiplier in equilibrium if None.
    is_flat
        Whether the first set has all contact rows because all gaps are zero. If many of them open
        in the first two sets, only those of `Backend.estimated_contact` stay: the loop alone would
        remove row after row.
    statuses
        Statuses of the first set; those that the law takes from `active` if None.
    """

    active: Mask
    multiplier: NDArray[np.float64] | None = None
    is_flat: bool = False
    statuses: Statuses | None = None


def active_set_loop(
    backend: Backend[S],
    start: Start,
    test: StoppingTest[S],
    inner: MPRGP,
    monitor: Monitor | None = None,
    saver: StateSaver[S] | None = None,
    options: ActiveSetOptions | None = None,
    law: ContactLaw | None = None,
) -> Outcome[S]:
    """Solve on active sets, one after another, until an answer is accepted (collective).

    Parameters
    ----------
    inner
        Limits the iterations of all sets together.

    Returns
    -------
    The last outcome, with the work of all sets; its reason is None where the sets do not settle.
    The caller may then go on with SMALBE-M, whose convergence is proved.
    """
    options, law = options or ActiveSetOptions(), law or Frictionless()
    run = _Run(backend, test, inner, monitor, saver, options)
    outcome, failure = run.sets(start, law)
    if failure is _Failure.UNSETTLED:
        outcome, statuses = run.after(outcome).contact_without_friction(start, law)
        patient = replace(run, options=replace(options, settling=0))
        outcome, failure = patient.after(outcome).sets(replace(start, statuses=statuses), law)
    guessed = start.statuses is not None and outcome.reason in (None, Reason.SLIDES)
    if failure is _Failure.AHEAD or guessed:  # sets may settle if no point is released too early
        backend.forget()
        patient = replace(run, options=replace(options, looks_ahead=False, settling=0))
        outcome, _ = patient.after(outcome).sets(replace(start, statuses=None), law)
    return outcome


class _Failure(Enum):
    """Why sets did not settle."""

    AHEAD = "points were released ahead of a state"
    UNSETTLED = "with friction each set has other contact"
    OTHER = "other reasons"


@dataclass(frozen=True, eq=False)
class _Run(Generic[S]):
    """One run of sets, after the work of earlier runs.

    Attributes
    ----------
    backend, test, inner, monitor, saver, options
        Arguments of `active_set_loop`.
    work_before
        Work of earlier runs.
    """

    backend: Backend[S]
    test: StoppingTest[S]
    inner: MPRGP
    monitor: Monitor | None
    saver: StateSaver[S] | None
    options: ActiveSetOptions
    work_before: Counts = field(default_factory=Counts)

    def after(self, outcome: Outcome[S]) -> _Run[S]:
        """The run after another one."""
        return replace(self, work_before=outcome.counts)

    def contact_without_friction(
        self, start: Start, law: ContactLaw
    ) -> tuple[Outcome[S], Statuses | None]:
        """Active set without friction, and the statuses of the law at its state (collective).

        None where bodies are held by friction alone.
        """
        settled = StoppingTest[S](lambda state: 1.0, lambda state: True)
        outcome, _ = replace(self, test=settled).sets(start, Frictionless())
        state, before = outcome.state, outcome.following
        if outcome.reason is not Reason.ACCEPTED or state is None:
            return outcome, None
        error = self.options.significant * self.options.first_reduction
        data = StateData.of(self.backend.comm, state, before.active, error)
        return outcome, law.following(before.active, data, before, False)[0]

    def sets(self, start: Start, law: ContactLaw) -> tuple[Outcome[S], _Failure]:
        """Solve on sets until they settle or fail (collective).

        Returns
        -------
        The last outcome with the work of all runs, and the reason if the sets failed.
        """
        loop = _Loop(self, start, law)  # with the initial active set
        for number in range(self.options.most_sets):
            if not loop.solve_and_evaluate(number):
                break
            failure = loop.failure()
            if failure is not None:
                return loop.result(), failure
            loop.update()
            if loop.lifts_off():
                loop.keep(self.backend.estimated_contact())
            if loop.forces_vanish():
                loop.open_all()
        return loop.result(), _Failure.AHEAD if loop.failed_ahead() else _Failure.OTHER

    def solve(
        self,
        number: int,
        statuses: Statuses,
        multiplier: NDArray[np.float64] | None,
        rules: SetRules[S],
        before: Counts,
    ) -> Outcome[S] | None:
        """Solve on one set, after the work of earlier sets (collective).

        Returns
        -------
        The outcome with the work on this set; without a state where the active rows hold a body so
        badly that rounding errors let it go. None where they do not hold some body at all.
        """
        try:
            on_set, saver = self.backend.on_set(statuses, multiplier), self.saver
        except ArithmeticError:
            return None
        inner = replace(self.inner, max_iterations=self.inner.max_iterations - before.inner)
        watch = replace(saver, before=saver.before + before).watch(on_set) if saver else None
        active = self.backend.comm.allreduce(int(statuses.active.sum()))
        monitor = on_active_set(self.monitor, number + 1, active, before.inner)
        try:
            return solve_on_set(
                on_set, rules.update, self.test, inner, monitor, watch, rules.reduction
            )
        except QPError:
            return Outcome(None, None, statuses, on_set.counts)


class _Loop(Generic[S]):
    """The sets of one run: the next set, and the history of those before it.

    `_Run.sets` calls its methods, one for each step from a set to the next.
    """

    def __init__(self, run: _Run[S], start: Start, law: ContactLaw) -> None:
        self._run, self._start, self._law = run, start, law
        backend, options, ahead = run.backend, run.options, run.options.looks_ahead
        update = ActiveSetUpdate(backend, backend.hierarchy(coarsened=False), law, options, ahead)
        coarsened = start.multiplier is not None or not law.settles
        self._rules = SetRules(update, options.first_reduction, coarsened)
        self._multiplier = start.multiplier
        self._statuses = start.statuses or law.initial(start.active, start.multiplier, ahead)
        self._outcome: Outcome[S] = Outcome(None, None, self._statuses, run.work_before)
        self._counts, self._unheld = run.work_before, 0
        self._turnovers, self._on_all_rows = list[Turnover](), list[Turnover]()
        self._sliding, self._stuck_again, self._yielded, self._sticks = 0, 0, 0, False
        self._strained, self._early = list[float](), EarlyReleases.none(start.active)

    def result(self) -> Outcome[S]:
        """The outcome of the last set, with the work of all."""
        return replace(self._outcome, counts=self._counts)

    def solve_and_evaluate(self, number: int) -> bool:
        """Solve on the next set and evaluate its KKT residuals (collective).

        If a set leaves a body unheld, sliding points yield like springs; after many such sets
        friction is said not to hold the body. They also yield where all points slide and many of
        them stuck again after two such sets: friction of given size and direction moves the bodies
        too far then.

        Returns
        -------
        Whether the residuals ask for another set.
        """
        run, law, state = self._run, self._law, self._outcome.state
        self._rules, self._statuses = self._rules.for_set(number, self._statuses, self._turnovers)
        if not law.settles and state is not None and self._sticks_after_sliding():
            self._statuses = law.yielding(self._statuses, state.jumps)
        solved = self._solved(number)
        self._unheld = self._unheld + 1 if solved is None else 0
        if self._unheld and state is not None and not law.settles:
            if self._unheld == run.options.sliding:
                self._outcome = replace(self._outcome, reason=Reason.SLIDES)
                return False
            self._statuses = law.yielding(self._statuses, state.jumps)
            solved = self._solved(number)
        if solved is None:
            return False
        self._outcome, self._counts = solved, self._counts + solved.counts
        run.backend.release()
        if solved.reason is not None or solved.state is None or solved.released is None:
            return False
        self._turnovers.append(_turnover(run.backend, self._statuses, solved.following))
        if self._rules.update.hierarchy.finest:
            self._on_all_rows.append(self._turnovers[-1])
        self._strained.append(solved.state.strained)
        self._early = self._early.after(solved.following.active, solved.released)
        return True

    def _sticks_after_sliding(self) -> bool:
        """Whether all points slide, and many stuck after two such sets before (collective).

        Then also after the next such sets, if any point stuck after the last one; and points yield
        for more sets each time.
        """
        backend, statuses, options = self._run.backend, self._statuses, self._run.options
        tangential = ~backend.contact_rows
        tractions = np.zeros(0) if statuses.tractions is None else statuses.tractions[tangential]
        local = [int((statuses.holding & tangential).sum()), np.count_nonzero(tractions)]
        sticking_rows, sliding_rows = backend.comm.allreduce(np.array(local))
        if self._sliding:
            again = self._stuck_again >= 2
            self._sticks = sticking_rows >= (1 if again else options.stuck_again * self._sliding)
            self._stuck_again += int(self._sticks)
        self._sliding = 0 if sticking_rows else int(sliding_rows)
        goes_on = self._sticks or 0 < self._yielded < self._stuck_again
        yields = bool(self._sliding) and self._stuck_again >= 2 and goes_on
        self._yielded = self._yielded + 1 if yields else 0
        return yields

    def _solved(self, number: int) -> Outcome[S] | None:
        return self._run.solve(number, self._statuses, self._multiplier, self._rules, self._counts)

    def failure(self) -> _Failure | None:
        """The reason why the sets do not settle, by their history; None while they may."""
        options, law = self._run.options, self._law
        if law.settles:
            sets = self._on_all_rows
            peels = options.peels(sets) and options.all_peel(sets[-2:])
            stops = (peels and not options.may_peel) or options.jumps(sets)
            return _Failure.OTHER if stops else None
        if self.forces_vanish() and not law.may_vanish:
            self._outcome = replace(self._outcome, state=None)  # SMALBE-M begins without forces
            return _Failure.OTHER
        unsettled = self._start.multiplier is None and options.is_unsettled(self._turnovers)
        return _Failure.UNSETTLED if unsettled else None

    def update(self) -> None:
        """Make the next set, from the KKT residuals of the last state (collective)."""
        outcome, run = self._outcome, self._run
        assert outcome.state is not None
        early = self._early.are_right(run.backend.comm, run.options.returning)
        self._rules = self._rules.with_ahead(early)
        self._multiplier, self._statuses = outcome.state.multiplier, outcome.following

    def lifts_off(self) -> bool:
        """Whether many rows of flat contact open in the first two sets."""
        is_second = len(self._turnovers) == 2
        return self._start.is_flat and is_second and self._run.options.all_peel(self._turnovers)

    def keep(self, contact: Mask) -> None:
        """Take all contact rows out of the next set but those of a mask (rows,) (collective)."""
        active = self._statuses.active & (contact | ~self._run.backend.contact_rows)
        self._statuses = self._law.consistent(replace(self._statuses, active=active))

    def forces_vanish(self) -> bool:
        """Whether forces that only cause each other fall from set to set."""
        return not self._law.settles and self._run.options.vanish(self._strained)

    def open_all(self) -> None:
        """Take all contact rows out of the next set, and begin it without forces (collective)."""
        self._multiplier = None
        self.keep(np.zeros_like(self._statuses.active))
        self._strained.clear()

    def failed_ahead(self) -> bool:
        """Whether the sets failed after points were released ahead of a state (collective)."""
        if self._outcome.reason not in (None, Reason.SLIDES):
            return False
        comm, start = self._run.backend.comm, self._start
        ahead = self._run.options.looks_ahead
        return self._early.any(comm) or (ahead and _begins_ahead(comm, start, self._law))


def _begins_ahead(comm: MPI.Intracomm, start: Start, law: ContactLaw) -> bool:
    """Whether the law lets points slide in the first set that it could let stick (collective)."""
    one, other = (law.initial(start.active, start.multiplier, ahead) for ahead in (True, False))
    return changed_rows(comm, one, other) > 0


def _turnover(backend: Backend[S], statuses: Statuses, following: Statuses) -> Turnover:
    """Contact rows that join and leave with the next set (collective)."""
    rows = backend.contact_rows
    active, next_active = statuses.active & rows, following.active & rows
    counts = [(next_active & ~active).sum(), (active & ~next_active).sum(), active.sum()]
    joined, left, closed = backend.comm.allreduce(np.array(counts))
    return Turnover(int(joined), int(left), int(closed))
