"""Primal-dual active sets on the dual problem of Total FETI.

The contact rows of the active set hold with equality, the others are left out
(`solver.tfeti.active_set_problem`). The solution of the right active set is the solution of the
contact problem. `active_set_loop` looks for it: an active set is solved no further than a decision
needs; rows whose tensile multiplier exceeds the error leave the set, and with them their mirror
image across the edge of contact (`solver.tfeti.constraints.contact_edge`); rows that are penetrated
by more than the error join it (Hintermüller, Ito, Kunisch, *The primal-dual active set strategy as
a semismooth Newton method*, 2002). Only a set that needs no change is solved to the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.contact.law import ContactLaw, Frictionless
from solver.errors import QPError
from solver.qp.iterate import Iterate, Watch
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.tfeti.active_set_problem import ActiveSetProblem, State
from solver.tfeti.constraints.contact_edge import mirrored
from solver.tfeti.constraints.hierarchy import RowLevels
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import largest_magnitude
from solver.tfeti.recycling import Directions

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ActiveSetOptions:
    """The tuned numbers of the active-set loop.

    Attributes
    ----------
    most_sets
        Active sets that are tried: where contact peels off row by row, each set is a handful of
        operator applications.
    first_reduction, next_reduction
        Reduction of the residual before the first evaluation of the KKT residuals on a set and
        between later ones.
    early_reduction
        The same between evaluations that may end a solve before the set is settled.
    coarse_reduction
        `first_reduction` on the coarser levels of the constraint hierarchy: the next level has to
        undo what a coarser one decides wrongly.
    evaluations
        Evaluations on a set before it is solved to the end.
    significant
        Forces and distances that change a set, relatively, over the estimate of its error.
    first_share
        Share of the load, from where it first closes a contact on, whose contacts join an empty
        set.
    margin
        Share of the largest jump allowed at which an answer is shown to the stopping test.
    tighten
        Factor on the residual after an answer that was not accepted.
    deeper
        Factor on `first_reduction` each time the loop comes back to a set that it had.
    peeled
        Share of the active rows that leave, set after set, where contact peels off.
    release_at_edge
        Whether rows leave together with their mirror image across the edge of contact.
    rejoining
        Share of the rows released as mirror images that may join later sets again. More of them
        show that the front is not where the rule expects it, as where a base lifts off for the
        most part: the sets would nearly cycle, so the rule is switched off.
    """

    most_sets: int = 60
    first_reduction: float = 0.3
    next_reduction: float = 0.1
    early_reduction: float = 0.5
    coarse_reduction: float = 0.1
    evaluations: int = 3
    significant: float = 0.1
    first_share: float = 0.02
    margin: float = 0.7
    tighten: float = 0.3
    deeper: float = 0.1
    peeled: float = 0.1
    release_at_edge: bool = True
    rejoining: float = 0.25


@dataclass(frozen=True, eq=False)
class Start:
    """Where the loop begins.

    Attributes
    ----------
    active : (dual,)
        The initial active set.
    multiplier : (dual,)
        Where the first set begins; the smallest multiplier in equilibrium if None.
    alternative
        Gives another initial active set (collective). It is asked where contact peels off from the
        first set on: of bodies that lie flat and lift off for the most part, the loop alone would
        remove row after row.
    """

    active: Mask
    multiplier: NDArray[np.float64] | None = None
    alternative: Callable[[], Mask] | None = None


@dataclass(frozen=True)
class StoppingTest:
    """What the loop asks about the answer of a set; the same on all ranks.

    Attributes
    ----------
    required_reduction
        Factor by which the error of a state has to fall before it is worth a certificate; one or
        less where it is worth one as it stands. Asked again after each answer that fails.
    accept
        Certifies the answer of a state; whether it passes.
    may_end_early
        Whether an answer will do although its set still changes.
    """

    required_reduction: Callable[[State], float]
    accept: Callable[[State], bool]
    may_end_early: bool = False


@dataclass(frozen=True)
class StateSaver:
    """Saves the state of a set at steps where one is wanted.

    Attributes
    ----------
    due
        Whether a state is wanted at this step; the same on all ranks.
    save
        Told of the state and of the work up to it.
    before
        Work of earlier sets.
    """

    due: Callable[[], bool]
    save: Callable[[State, Counts], None]
    before: Counts = field(default_factory=Counts)

    def watch(self, on_set: ActiveSetProblem) -> Watch:
        """Sees the iterates of a set."""

        def saw(it: Iterate) -> None:
            if self.due():
                self.save(on_set.state(), self.before + on_set.counts)

        return saw


@dataclass(frozen=True, eq=False)
class Outcome:
    """How the solve on a set, or the loop, ended.

    Attributes
    ----------
    reason
        `ACCEPTED`, why the solver ended, or None where another set is asked for.
    state
        The last one evaluated.
    following : (dual,)
        The active set from there on.
    counts
        Work of the set, or of all of them.
    released : (dual,)
        Rows that left although the law lets them stay, as mirror images across the contact edge.
    """

    reason: Reason | None
    state: State | None
    following: Mask
    counts: Counts
    released: Mask | None = None


def active_set_loop(
    problem: DualProblem,
    start: Start,
    test: StoppingTest,
    inner: MPRGP,
    monitor: Monitor | None = None,
    saver: StateSaver | None = None,
    options: ActiveSetOptions | None = None,
    law: ContactLaw | None = None,
) -> Outcome:
    """Solve active sets, each until it asks for another, until an answer is accepted (collective).

    Parameters
    ----------
    inner
        Limits the iterations of all sets together.

    Returns
    -------
    The last outcome, with the work of all sets; its reason is None where the sets do not settle:
    SMALBE-M, whose convergence is proved, then goes on from there.
    """
    options, law = options or ActiveSetOptions(), law or Frictionless()
    active, multiplier, alternative = start.active, start.multiplier, start.alternative
    hierarchy = RowLevels(problem, thinned=problem.held_without_contact and multiplier is None)
    update = ActiveSetUpdate(problem, hierarchy, law, options, options.release_at_edge)
    directions, seen, counts = Directions(problem), set[int](), Counts()
    reduction = options.first_reduction if hierarchy.finest else options.coarse_reduction
    active = active & hierarchy.allowed
    released, again = np.zeros(problem.size, bool), np.zeros(problem.size, bool)
    found = Outcome(None, None, active, counts)
    for number in range(options.most_sets):
        fingerprint = _fingerprint(problem.comm, active)
        if fingerprint in seen:  # decided too early, or the sets do not settle
            reduction *= options.deeper
            update = replace(update, release_at_edge=False)
            seen.clear()
        seen.add(fingerprint)
        try:
            on_set = ActiveSetProblem(problem, active, multiplier, directions)
        except ArithmeticError:  # a body is held by rows that have left the set
            break
        left = replace(inner, max_iterations=inner.max_iterations - counts.inner)
        watch = replace(saver, before=counts).watch(on_set) if saver else None
        try:
            found = solve_on_set(on_set, update, test, left, monitor, watch, reduction)
        except QPError:  # the active rows hold a body so badly that rounding lets it go
            counts = counts + on_set.counts
            found = Outcome(None, None, active, counts)
            break
        counts = counts + found.counts
        # its B and coarse problem, before the next has its own: petsc4py leaves them for later
        del on_set, watch
        PETSc.garbage_cleanup(problem.comm)
        if found.reason is not None or found.state is None:
            break
        following = found.following
        if alternative is not None and not _peels(problem.comm, active, following, options.peeled):
            alternative = None
        if alternative is not None and number == 1:  # the second set in a row peels
            following, alternative = following & alternative(), None
        if update.release_at_edge:
            again |= released & following
            released |= found.released if found.released is not None else False
            if _share(problem.comm, again, released) > options.rejoining:
                update = replace(update, release_at_edge=False)
        multiplier, active = found.state.multiplier, following
    return replace(found, counts=counts)


def solve_on_set(
    on_set: ActiveSetProblem,
    update: ActiveSetUpdate,
    test: StoppingTest,
    inner: MPRGP,
    monitor: Monitor | None = None,
    watch: Watch | None = None,
    first_reduction: float | None = None,
) -> Outcome:
    """Solve on an active set until the set has to change, or its answer is accepted (collective).

    Parameters
    ----------
    first_reduction
        Reduction of the residual before the first evaluation, if not that of the options.
    """
    options, comm = update.options, on_set.problem.comm
    wanted = (first_reduction or options.first_reduction) * on_set.residual
    evaluations = 0
    while True:
        ended = on_set.solve(inner, wanted, monitor, watch)
        state = on_set.state()
        following, released = update.following(on_set, state)
        if not (ended.converged or ended is Reason.ROUND_OFF):
            return Outcome(ended, state, following, on_set.counts)
        changes = _changes(comm, on_set.active, following)
        asks = test.may_end_early or not changes
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
        if test.may_end_early:
            wanted = max(wanted, options.early_reduction * on_set.residual)
        elif evaluations < options.evaluations:
            wanted = max(wanted, options.next_reduction * on_set.residual)


@dataclass(frozen=True, eq=False)
class ActiveSetUpdate:
    """The primal-dual update: the KKT residuals of a state decide on the next active set.

    Attributes
    ----------
    hierarchy
        Which open rows may join; where no row changes it goes on to its next level.
    release_at_edge
        Whether rows leave together with their mirror image across the edge of contact.
    """

    problem: DualProblem
    hierarchy: RowLevels
    law: ContactLaw
    options: ActiveSetOptions
    release_at_edge: bool = True

    @classmethod
    def simple(cls, problem: DualProblem) -> ActiveSetUpdate:
        """Without contact the rows of all levels, the frictionless law and default options."""
        return cls(problem, RowLevels(problem, thinned=False), Frictionless(), ActiveSetOptions())

    def following(self, on_set: ActiveSetProblem, state: State) -> tuple[Mask, Mask]:
        """The next active set, and the rows released as mirror images, (dual,) (collective)."""
        problem, active = self.problem, on_set.active
        distance = state.distance(problem)
        error = self.options.significant * on_set.error(state.strained)
        strongest = largest_magnitude(problem.comm, state.multiplier[active])
        stays = self.law.may_stay_active(state.multiplier, error * strongest)
        released = np.zeros(problem.size, bool)
        if self.release_at_edge:
            released = stays & mirrored(problem, active, active & ~stays)
            stays &= ~released
        for _ in range(2):
            joins = self.hierarchy.allowed & self.law.closes(distance, error)
            if not problem.comm.allreduce(int(active.sum())):
                joins &= self._first_to_close(state.jumps, joins)
            following = problem.inequality & np.where(active, stays, joins)
            if self.hierarchy.finest or _changes(problem.comm, active, following):
                break
            self.hierarchy.refine()
        return following, released

    def _first_to_close(self, jumps: NDArray[np.float64], penetrated: Mask) -> Mask:
        """Penetrated rows that a growing load closes first; others may then stay open.

        Parameters
        ----------
        jumps : (dual,)
            B u - c of the full load without contact; B u grows with the load.
        """
        problem = self.problem
        gaps = np.maximum(problem.c, 0.0)
        moved = np.where(penetrated, jumps + problem.c, 1.0)
        share = np.where(penetrated, gaps / np.where(moved > 0.0, moved, 1.0), np.inf)
        first = problem.comm.allreduce(float(share.min(initial=np.inf)), op=MPI.MIN)
        return np.asarray(share <= first + self.options.first_share * (1.0 - first))


def _fingerprint(comm: MPI.Intracomm, active: Mask) -> int:
    """A number that tells active sets apart (collective)."""
    return hash(tuple(comm.allgather(hash(active.tobytes()))))


def _changes(comm: MPI.Intracomm, active: Mask, following: Mask) -> int:
    """Rows that join or leave (collective)."""
    return int(comm.allreduce(int((following != active).sum())))


def _share(comm: MPI.Intracomm, part: Mask, whole: Mask) -> float:
    """How many rows of a mask are in part of it, over all of them (collective)."""
    few, all_rows = comm.allreduce(np.array([part.sum(), whole.sum()]))
    return float(few) / max(float(all_rows), 1.0)


def _peels(comm: MPI.Intracomm, active: Mask, following: Mask, share: float) -> bool:
    """Whether at least that share of the rows leaves and none joins (collective)."""
    joined, gone, before = comm.allreduce(
        np.array([(following & ~active).sum(), (active & ~following).sum(), active.sum()])
    )
    return not joined and bool(gone > share * before)
