"""Contact laws: which contact forces are admissible, and when a point opens or closes.

A law is one object. The active-set loop asks the law which active normal rows may stay active and
which open rows join them, and then for the statuses of all rows. The certificate measures the
conditions of the law. A new law is a new class: Tresca's and Coulomb's laws
(`solver.contact.friction_law`) keep active the tangential rows whose traction is below the slip
limit and prescribe the slip traction of the others. Tied boundaries have no law: their rows hold
with equality on every set, as gluing rows do (`docs/theory/active_sets.md`).
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.backend import SetState, Statuses
from solver.contact.active_set_options import ActiveSetOptions, Failure, SetHistory
from solver.vectors import Array, Mask, largest_magnitude


@dataclass(frozen=True)
class StateError:
    """Numbers of a state that count as zero, given its relative error."""

    force: float
    distance: float
    """Multipliers, and jumps over the displacement of the row's body, up to which they do."""
    strongest: float
    """The largest multiplier of an active row."""

    @classmethod
    def of(cls, comm: MPI.Intracomm, state: SetState, active: Mask, error: float) -> "StateError":
        """The numbers of a state with a relative error (collective).

        Parameters
        ----------
        active : (rows,)
            Active rows of the set that the state solves.
        """
        strongest = largest_magnitude(comm, state.multiplier[active])
        return cls(error * strongest, error, strongest)


@dataclass(frozen=True)
class ContactLaw:
    """A contact law as the active-set loop uses it; arrays are (rows,), local parts.

    This one has no friction: Signorini's conditions λ ≥ 0, B u ≤ c, λ (B u - c) = 0 in each contact
    row. Other laws replace what differs.
    """

    name: str = "frictionless"
    """Name of the law in messages."""
    settles: bool = True
    """Whether the sets reach the set of the answer after finitely many steps. Where prescribed
    forces follow the answer, the sets only approach it."""
    may_vanish: bool = False
    """Whether no body needs contact forces, so that they may fall to zero from set to set."""

    def failure(
        self, options: ActiveSetOptions, history: SetHistory, first: bool
    ) -> Failure | None:
        """The reason why the sets do not settle, by their history; None while they may.

        Without friction contact peels off row by row, or rows join in set after set.

        Parameters
        ----------
        first
            Whether they began without the multiplier of a similar problem.
        """
        sets = history.on_all_rows
        peels = not options.may_peel and options.peels_on(sets)
        return Failure.OTHER if peels or options.jumps(sets) else None

    def locking(self) -> "ContactLaw":
        """The law with springs at points that lock; none does without friction."""
        return self

    def with_limits(self, limits: Array) -> "ContactLaw":
        """The law with given slip limits (points,), whose sets do not run ahead of their states."""
        return self

    def may_stay_active(self, multiplier: Array, tolerance: float) -> Mask:
        """Active normal rows whose multiplier is not tensile, to a tolerance."""
        return multiplier > -tolerance

    def closes(self, distance: Array, tolerance: float) -> Mask:
        """Open normal rows that are penetrated, to a tolerance."""
        return distance > tolerance

    def initial(
        self, active: Mask, multiplier: Array | None, ahead: bool, jumps: Array | None = None
    ) -> Statuses:
        """Statuses for a set of active normal rows, near a multiplier if given (collective).

        Parameters
        ----------
        ahead
            Whether points that probably slide may do so from the first set on.
        jumps : (rows,)
            B u - c near that of the set, if known.
        """
        return Statuses(active)

    def consistent(self, statuses: Statuses) -> Statuses:
        """The statuses after normal rows were taken out of the active set (collective)."""
        return statuses

    def yielding(self, statuses: Statuses, jumps: Array) -> Statuses | None:
        """Statuses near statuses that leave a body unheld, but which hold it (collective).

        None on all ranks for a law without such statuses: normal rows do not yield.

        Parameters
        ----------
        jumps : (rows,)
            B u - c of the state before.
        """

    def following(
        self, normals: Mask, state: SetState, error: StateError, before: Statuses, ahead: bool
    ) -> tuple[Statuses, Mask]:
        """Statuses of the next set, given its active normal rows (collective).

        Parameters
        ----------
        before
            Statuses of the set that the state solves.
        ahead
            Whether the law may release points before the state alone shows that they slide.

        Returns
        -------
        The statuses, and the mask (rows,) of the tangential rows of points so released.
        """
        return Statuses(normals), np.zeros_like(normals)
