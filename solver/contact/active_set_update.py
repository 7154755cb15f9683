"""How an active set becomes the next one, and how accurately each set is solved.

`ActiveSetUpdate` is the primal-dual update of one state. `SetRules` has the update and the accuracy
of a set, which follow from the sets before it. Contact that peels off goes on by the levels of the
constraint hierarchy. Sets are solved more accurately where one returns or many do not settle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
from mpi4py import MPI

from solver.backend import Backend, ConstraintHierarchy, S, SetSolve, Statuses
from solver.contact.active_set_options import ActiveSetOptions, Turnover
from solver.contact.law import ContactLaw, StateError
from solver.vectors import Mask


@dataclass(frozen=True, eq=False)
class ActiveSetUpdate(Generic[S]):
    """The primal-dual update: the KKT residuals of a state decide on the next active set."""

    backend: Backend[S]
    hierarchy: ConstraintHierarchy
    """Constraint hierarchy: the open rows that may join."""
    law: ContactLaw
    options: ActiveSetOptions
    early_release: bool = True
    """Whether the law may release points before a state shows that they slide."""

    def following(
        self, on_set: SetSolve[S], state: S
    ) -> tuple[Statuses, Mask, ConstraintHierarchy]:
        """The next statuses, the tangential rows (rows,) released early, the level (collective).

        Where no row changes, the next level decides.
        """
        backend, before = self.backend, on_set.statuses
        active = before.active & backend.contact_rows
        error = self.options.significant * on_set.error(state.strained)
        zero = StateError.of(backend.comm, state, before.active, error)
        tension = max(zero.force, self.options.negligible * zero.strongest)
        stays = self.law.may_stay_active(state.multiplier, tension)
        hierarchy = self.hierarchy
        for _ in range(2):
            joins = hierarchy.allowed & self.law.closes(state.closing, zero.distance)
            if not backend.comm.allreduce(int(active.sum())):
                joins &= self._first_to_close(state, joins)
            normals = backend.contact_rows & np.where(active, stays, joins)
            following, early = self.law.following(normals, state, zero, before, self.early_release)
            if hierarchy.finest or changed_rows(backend.comm, before, following):
                break
            hierarchy = hierarchy.finer()
        return following, early, hierarchy

    def on_levels(self, statuses: Statuses) -> "tuple[ActiveSetUpdate[S], Statuses]":
        """The update from the coarsest level on, and the statuses on this level (collective)."""
        hierarchy = self.backend.hierarchy(coarsened=True)
        if hierarchy.finest:
            return self, statuses
        active = statuses.active & (hierarchy.allowed | ~self.backend.contact_rows)
        statuses = self.law.consistent(replace(statuses, active=active))
        return replace(self, hierarchy=hierarchy), statuses

    def with_error(self, factor: float) -> "ActiveSetUpdate[S]":
        """The update from states whose largest error is this factor of the present one."""
        largest = factor * self.options.largest_error
        return replace(self, options=replace(self.options, largest_error=largest))

    def _first_to_close(self, state: S, penetrated: Mask) -> Mask:
        """Penetrated rows that a growing load closes first; the other rows may then stay open.

        Without contact B u grows with the load, so a row closes at the share c / B u of it.
        """
        gap, moved = np.maximum(self.backend.c, 0.0), state.jumps + self.backend.c
        share = np.where(penetrated, gap / np.where(moved > 0.0, moved, 1.0), np.inf)
        first = self.backend.comm.allreduce(float(share.min(initial=np.inf)), op=MPI.MIN)
        return np.asarray(share <= first + self.options.first_share * (1.0 - first))


@dataclass(frozen=True, eq=False)
class SetRules(Generic[S]):
    """How the next set is solved and changed, given the sets before it."""

    update: ActiveSetUpdate[S]
    """The primal-dual update."""
    reduction: float
    """Reduction of the residual before the first evaluation on a set."""
    coarsened: bool
    """Whether the constraint hierarchy has been built, or never will be."""
    visited: frozenset[int] = frozenset()
    """Fingerprints of the sets since the rules were changed."""

    def for_set(
        self, number: int, statuses: Statuses, turnovers: Sequence[Turnover]
    ) -> "tuple[SetRules[S], Statuses]":
        """The rules and the statuses of a set, numbered from 0 (collective)."""
        rules, statuses = self._on_levels(number, statuses, turnovers)
        fingerprint = statuses.fingerprint(self.update.backend.comm)
        return rules._after_visit(fingerprint)._after_many_sets(number), statuses

    def on_level(self, hierarchy: ConstraintHierarchy) -> "SetRules[S]":
        """The rules on a level of the constraint hierarchy."""
        return replace(self, update=replace(self.update, hierarchy=hierarchy))

    def _on_levels(
        self, number: int, statuses: Statuses, turnovers: Sequence[Turnover]
    ) -> "tuple[SetRules[S], Statuses]":
        """The rules on the coarsest level of the hierarchy, if contact peels off or takes long."""
        options = self.update.options
        if self.coarsened or not (number == options.sets_before_levels or options.peels(turnovers)):
            return self, statuses
        update, statuses = self.update.on_levels(statuses)
        reduction = self.reduction if update.hierarchy.finest else options.coarse_reduction
        return replace(self, update=update, reduction=reduction, coarsened=True), statuses

    def _after_visit(self, fingerprint: int) -> "SetRules[S]":
        """The rules of a set; if it returns, it was changed too early, or sets do not settle."""
        if fingerprint not in self.visited:
            return replace(self, visited=self.visited | {fingerprint})
        visited = frozenset({fingerprint})
        if not self.update.hierarchy.finest:  # the next level decides
            return replace(self.on_level(self.update.hierarchy.finer()), visited=visited)
        reduction = self.reduction * self.update.options.deeper
        update = replace(self.update, early_release=False)
        return replace(self, update=update, reduction=reduction, visited=visited)

    def _after_many_sets(self, number: int) -> "SetRules[S]":
        """More accurate solves where many sets have not settled."""
        options = self.update.options
        if not options.patience or not number or number % options.patience:
            return self
        if number == options.patience:
            return replace(self, reduction=self.reduction * options.tighten)
        update = self.update.with_error(options.careful)
        return replace(self, update=update, reduction=self.reduction * options.careful)


def changed_rows(comm: MPI.Intracomm, statuses: Statuses, following: Statuses) -> int:
    """Rows whose status changes (collective)."""
    return int(comm.allreduce(int(statuses.changed(following).sum())))
