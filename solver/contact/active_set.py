"""Primal-dual active sets.

The contact rows of the active set hold with equality, and the multipliers of the other rows are
prescribed; a backend (`solver.backend`) solves this problem. The solution of the right active set
is the solution of the contact problem. `active_set_loop` looks for this set. It solves on an active
set only as accurately as the next decision needs. Rows whose tensile multiplier exceeds the error
leave the set, and rows that are penetrated by more than the error join it (Hintermüller, Ito,
Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, 2002). Only a set that
needs no change is solved to the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Generic

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.backend import Backend, Hierarchy, S, SetSolve, Statuses
from solver.contact.active_set_options import ActiveSetOptions, Turnover
from solver.contact.law import ContactLaw, Found, Frictionless
from solver.contact.monitoring import on_active_set
from solver.errors import QPError
from solver.qp.iterate import Iterate, Watch
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
    alternative
        A function that returns another initial active set (collective). The loop calls it where
        contact peels off from the first set on: if a body lies flat and most of it lifts off, the
        loop alone would remove row after row.
    statuses
        Statuses of the first set; those that the law takes from `active` if None.
    """

    active: Mask
    multiplier: NDArray[np.float64] | None = None
    alternative: Callable[[], Mask] | None = None
    statuses: Statuses | None = None


@dataclass(frozen=True)
class StoppingTest(Generic[S]):
    """The test of the answer of a set; the same on all ranks.

    Attributes
    ----------
    required_reduction
        Factor by which the error of a state has to fall before it is certified; one or less where
        the state should be certified now. Called again after each rejected answer.
    accept
        Certifies the answer of a state and returns whether the certificate passes.
    may_end_early
        Whether an answer may be accepted although its set still changes.
    """

    required_reduction: Callable[[S], float]
    accept: Callable[[S], bool]
    may_end_early: bool = False


@dataclass(frozen=True)
class StateSaver(Generic[S]):
    """Saves the state of a set at steps where one is wanted.

    Attributes
    ----------
    due
        Whether a state has to be saved at this step; the same on all ranks.
    save
        Called with the state and the work up to it.
    before
        Work of earlier sets.
    """

    due: Callable[[], bool]
    save: Callable[[S, Counts], None]
    before: Counts = field(default_factory=Counts)

    def watch(self, on_set: SetSolve[S]) -> Watch:
        """Sees the iterates of a set."""

        def saw(it: Iterate) -> None:
            if self.due():
                self.save(on_set.state(), self.before + on_set.counts)

        return saw


@dataclass(frozen=True, eq=False)
class Outcome(Generic[S]):
    """Outcome of the solve on a set, or of the whole loop.

    Attributes
    ----------
    reason
        `ACCEPTED`, another reason why the solver ended, or None where the set has to change.
    state
        The last evaluated state.
    following
        The statuses of the next set.
    counts
        Work of the set, or of all of them.
    released : (rows,)
        Tangential rows of points that the law released before the state showed that they slide;
        None if the set was not changed.
    """

    reason: Reason | None
    state: S | None
    following: Statuses
    counts: Counts
    released: Mask | None = None


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
    found, failure = run.sets(start, law)
    if failure is _Failure.UNSETTLED:
        found, statuses = run.after(found).contact_without_friction(start, law)
        patient = replace(run, options=replace(options, settling=0))
        found, failure = patient.after(found).sets(replace(start, statuses=statuses), law)
    if failure is _Failure.AHEAD:  # the sets may settle if no point is released ahead of a state
        backend.forget()
        patient = replace(run, options=replace(options, looks_ahead=False, settling=0))
        found, _ = patient.after(found).sets(start, law)
    return found


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
    spent
        Work of earlier runs.
    """

    backend: Backend[S]
    test: StoppingTest[S]
    inner: MPRGP
    monitor: Monitor | None
    saver: StateSaver[S] | None
    options: ActiveSetOptions
    spent: Counts = field(default_factory=Counts)

    def after(self, found: Outcome[S]) -> _Run[S]:
        """The run after another one."""
        return replace(self, spent=found.counts)

    def contact_without_friction(
        self, start: Start, law: ContactLaw
    ) -> tuple[Outcome[S], Statuses | None]:
        """Active set without friction, and the statuses of the law at its state (collective).

        None where bodies are held by friction alone.
        """
        settled = StoppingTest[S](lambda state: 1.0, lambda state: True)
        found, _ = replace(self, test=settled).sets(start, Frictionless())
        state, before = found.state, found.following
        if found.reason is not Reason.ACCEPTED or state is None:
            return found, None
        error = self.options.significant * self.options.first_reduction
        data = Found.of(self.backend.comm, state, before.active, error)
        return found, law.following(before.active, data, before, False)[0]

    def sets(self, start: Start, law: ContactLaw) -> tuple[Outcome[S], _Failure]:
        """Solve on sets until they settle or fail (collective).

        Returns
        -------
        The last outcome with the work of all runs, and the reason if the sets failed.
        """
        backend, options, multiplier = self.backend, self.options, start.multiplier
        comm = backend.comm
        coarsened = multiplier is not None or not law.settles
        flat, turnovers = True, list[Turnover]()
        hierarchy, ahead = backend.hierarchy(coarsened=False), options.looks_ahead
        update = ActiveSetUpdate(backend, hierarchy, law, options, ahead)
        seen, counts, reduction = set[int](), self.spent, options.first_reduction
        statuses = start.statuses or law.initial(start.active, start.multiplier, ahead)
        released, again = np.zeros_like(start.active), np.zeros_like(start.active)
        found: Outcome[S] = Outcome(None, None, statuses, counts)
        for number in range(options.most_sets):
            if not coarsened and (number == options.sets_before_levels or options.peels(turnovers)):
                update, statuses = update.on_levels(statuses)
                coarsened = True
                if not update.hierarchy.finest:
                    reduction = options.coarse_reduction
            fingerprint = statuses.fingerprint(comm)
            if fingerprint in seen and not update.hierarchy.finest:  # the next level decides
                update.hierarchy.refine()
                seen.clear()
            elif fingerprint in seen:  # decided too early, or the sets do not settle
                reduction *= options.deeper
                update = replace(update, looks_ahead=False)
                seen.clear()
            seen.add(fingerprint)
            if options.patience and number and number % options.patience == 0:
                first = number == options.patience
                reduction *= options.tighten if first else options.careful
                update = update if first else update.with_error(options.careful)
            try:
                on_set = backend.on_set(statuses, multiplier)
            except ArithmeticError:  # a body is held by rows that have left the set
                break
            left = replace(self.inner, max_iterations=self.inner.max_iterations - counts.inner)
            saver = self.saver
            watch = replace(saver, before=saver.before + counts).watch(on_set) if saver else None
            active = comm.allreduce(int(statuses.active.sum()))
            tells = on_active_set(self.monitor, number + 1, active, counts.inner)
            try:
                found = solve_on_set(on_set, update, self.test, left, tells, watch, reduction)
            except QPError:  # the active rows hold a body so badly that rounding lets it go
                counts = counts + on_set.counts
                found = Outcome(None, None, statuses, counts)
                break
            counts = counts + found.counts
            del on_set, watch  # their memory is free before the next set allocates its own
            backend.release()
            if found.reason is not None or found.state is None:
                break
            following = found.following
            turnovers.append(_turnover(backend, statuses, following))
            flat = flat and turnovers[-1].peeled > options.peeled * turnovers[-1].closed
            if flat and number == 1 and start.alternative is not None:
                fewer = following.active & (start.alternative() | ~backend.contact_rows)
                following = law.consistent(replace(following, active=fewer))
            again |= released & following.active
            released |= found.released if found.released is not None else False
            update = update.without_failed(again, released)
            multiplier, statuses = found.state.multiplier, following
            if not law.settles and start.multiplier is None and options.is_unsettled(turnovers):
                return replace(found, counts=counts), _Failure.UNSETTLED
        early = bool(comm.allreduce(int(released.any())))
        failed_ahead = found.reason is None and (
            early or (ahead and _begins_ahead(comm, start, law))
        )
        return replace(found, counts=counts), _Failure.AHEAD if failed_ahead else _Failure.OTHER


def _begins_ahead(comm: MPI.Intracomm, start: Start, law: ContactLaw) -> bool:
    """Whether the law lets points slide in the first set that it could let stick (collective)."""
    one, other = (law.initial(start.active, start.multiplier, ahead) for ahead in (True, False))
    return _changes(comm, one, other) > 0


def solve_on_set(
    on_set: SetSolve[S],
    update: ActiveSetUpdate[S],
    test: StoppingTest[S],
    inner: MPRGP,
    monitor: Monitor | None = None,
    watch: Watch | None = None,
    first_reduction: float | None = None,
) -> Outcome[S]:
    """Solve on an active set until the set has to change, or its answer is accepted (collective).

    Parameters
    ----------
    first_reduction
        Reduction of the residual before the first evaluation; that of the options if None.
    """
    options, comm = update.options, update.backend.comm
    wanted = (first_reduction or options.first_reduction) * on_set.residual
    evaluations = 0
    while True:
        ended = on_set.solve(inner, wanted, monitor, watch)
        state = on_set.state()
        if (
            ended.converged
            and not on_set.at_round_off  # without strains the relative error is one and stays one
            and on_set.error(state.strained) > options.largest_error
        ):
            wanted *= options.tighten
            continue
        following, released = update.following(on_set, state)
        if not (ended.converged or ended is Reason.ROUND_OFF):
            return Outcome(ended, state, following, on_set.counts)
        changes = _changes(comm, on_set.statuses, following)
        asks = test.may_end_early or not changes or not update.law.settles
        lack = test.required_reduction(state) if asks else math.inf
        at_end = not changes and on_set.at_round_off
        if lack <= 1.0 or at_end:
            if test.accept(state):
                return Outcome(Reason.ACCEPTED, state, following, on_set.counts)
            if at_end:
                return Outcome(Reason.ROUND_OFF, state, following, on_set.counts)
            lack = max(test.required_reduction(state), options.margin / options.tighten)
        if changes:
            return Outcome(None, state, following, on_set.counts, released)
        evaluations += 1
        wanted = options.margin * on_set.residual / max(lack, 1.0)
        if test.may_end_early or evaluations < options.evaluations:
            wanted = max(wanted, options.next_reduction * on_set.residual)


@dataclass(frozen=True, eq=False)
class ActiveSetUpdate(Generic[S]):
    """The primal-dual update: the KKT residuals of a state decide on the next active set.

    Attributes
    ----------
    hierarchy
        Constraint hierarchy: the open rows that may join. Where no row changes, it goes to its next
        level.
    looks_ahead
        Whether the law may release points before a state shows that they slide.
    """

    backend: Backend[S]
    hierarchy: Hierarchy
    law: ContactLaw
    options: ActiveSetOptions
    looks_ahead: bool = True

    @classmethod
    def simple(cls, backend: Backend[S]) -> ActiveSetUpdate[S]:
        """All rows on one level, the frictionless law and default options."""
        return cls(backend, backend.hierarchy(coarsened=False), Frictionless(), ActiveSetOptions())

    def following(self, on_set: SetSolve[S], state: S) -> tuple[Statuses, Mask]:
        """The next statuses, and the tangential rows released early, (rows,) (collective)."""
        backend, before = self.backend, on_set.statuses
        active = before.active & backend.contact_rows
        error = self.options.significant * on_set.error(state.strained)
        found = Found.of(backend.comm, state, before.active, error)
        stays = self.law.may_stay_active(state.multiplier, found.force)
        for _ in range(2):
            joins = self.hierarchy.allowed & self.law.closes(state.distance, error)
            if not backend.comm.allreduce(int(active.sum())):
                joins &= self._first_to_close(state, joins)
            normals = backend.contact_rows & np.where(active, stays, joins)
            following, early = self.law.following(normals, found, before, self.looks_ahead)
            if self.hierarchy.finest or _changes(backend.comm, before, following):
                break
            self.hierarchy.refine()
        return following, early

    def on_levels(self, statuses: Statuses) -> tuple[ActiveSetUpdate[S], Statuses]:
        """The update from the coarsest level on, and the statuses on this level (collective)."""
        hierarchy = self.backend.hierarchy(coarsened=True)
        if hierarchy.finest:
            return self, statuses
        active = statuses.active & (hierarchy.allowed | ~self.backend.contact_rows)
        statuses = self.law.consistent(replace(statuses, active=active))
        return replace(self, hierarchy=hierarchy), statuses

    def with_error(self, factor: float) -> ActiveSetUpdate[S]:
        """The update from states whose largest error is this factor of the present one."""
        largest = factor * self.options.largest_error
        return replace(self, options=replace(self.options, largest_error=largest))

    def without_failed(self, again: Mask, released: Mask) -> ActiveSetUpdate[S]:
        """The update without early release if too many of its rows stick again (collective)."""
        good = _share(self.backend.comm, again, released) <= self.options.returning
        return replace(self, looks_ahead=self.looks_ahead and good)

    def _first_to_close(self, state: S, penetrated: Mask) -> Mask:
        """Penetrated rows that a growing load closes first; the other rows may then stay open."""
        share = self.backend.closing_share(state, penetrated)
        first = self.backend.comm.allreduce(float(share.min(initial=np.inf)), op=MPI.MIN)
        return np.asarray(share <= first + self.options.first_share * (1.0 - first))


def _changes(comm: MPI.Intracomm, statuses: Statuses, following: Statuses) -> int:
    """Rows whose status changes (collective)."""
    return int(comm.allreduce(int(statuses.changed(following).sum())))


def _share(comm: MPI.Intracomm, part: Mask, whole: Mask) -> float:
    """Number of rows of `part`, over the number of rows of `whole`, on all ranks (collective)."""
    few, all_rows = comm.allreduce(np.array([part.sum(), whole.sum()]))
    return float(few) / max(float(all_rows), 1.0)


def _turnover(backend: Backend[S], statuses: Statuses, following: Statuses) -> Turnover:
    """Contact rows that join and leave with the next set (collective)."""
    rows = backend.contact_rows
    active, next_active = statuses.active & rows, following.active & rows
    own = [(next_active & ~active).sum(), (active & ~next_active).sum(), active.sum()]
    joined, left, closed = backend.comm.allreduce(np.array(own))
    return Turnover(int(joined), int(left), int(closed))
