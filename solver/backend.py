"""What the active-set loop asks of a backend, which knows how to solve on a given active set.

A contact row is one direction at one contact point: its normal, or a direction of its tangential
frame. On a set the rows that are active hold with equality (closed in the normal, sticking in the
frame); the multipliers of all others are prescribed: zero where the point is open, the slip
traction where it slides. So a backend needs no contact law, and a law (`solver.contact.law`) needs
no backend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.qp.iterate import Watch
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Statuses:
    """What holds in each row while a backend solves; local parts.

    Attributes
    ----------
    active : (rows,)
        Contact rows that hold with equality.
    tractions : (rows,)
        Multipliers of the contact rows that are not active; None where all are zero.
    """

    active: Mask
    tractions: Array | None = None

    def changed(self, other: Statuses) -> Mask:
        """Rows whose status or prescribed multiplier differs."""
        differs = self.active != other.active
        if self.tractions is None and other.tractions is None:
            return differs
        own, others = (0.0 if s.tractions is None else s.tractions for s in (self, other))
        return differs | (~self.active & np.not_equal(own, others))

    def fingerprint(self, comm: MPI.Intracomm) -> int:
        """A number that tells statuses apart (collective)."""
        tractions = b"" if self.tractions is None else self.tractions.tobytes()
        return hash(tuple(comm.allgather(hash((self.active.tobytes(), tractions)))))


class SetState(Protocol):
    """The answer of a set as far as it is solved; arrays are (rows,), local parts."""

    @property
    def multiplier(self) -> Array:
        """λ."""

    @property
    def distance(self) -> Array:
        """B u - c, in contact rows the penetration, over the displacement of the row's body."""

    @property
    def strained(self) -> float:
        """a(u, u), twice the energy of the strains."""


S = TypeVar("S", bound=SetState)
Out = TypeVar("Out", bound=SetState, covariant=True)
In = TypeVar("In", bound=SetState, contravariant=True)


class SetSolve(Protocol[Out]):
    """The problem of one set, solved as far as it is asked to be."""

    @property
    def statuses(self) -> Statuses:
        """Of the set."""

    @property
    def residual(self) -> float:
        """Relative to the right-hand side."""

    @property
    def at_round_off(self) -> bool:
        """Whether no step can make the residual smaller."""

    @property
    def counts(self) -> Counts:
        """Work so far."""

    def solve(
        self, inner: MPRGP, residual: float, monitor: Monitor | None, watch: Watch | None = None
    ) -> Reason:
        """Go on to a relative residual; `inner` limits the iterations (collective)."""

    def state(self) -> Out:
        """Where the solve stands (collective)."""

    def error(self, strained: float) -> float:
        """Estimate of the error in energy norm, relative to that of the strains (collective)."""


class Hierarchy(Protocol):
    """Which open rows may close, level by level."""

    @property
    def allowed(self) -> Mask:
        """Contact rows of the level, (rows,)."""

    @property
    def finest(self) -> bool:
        """Whether all rows are allowed."""

    def refine(self) -> None:
        """Go to the next level."""


class Backend(Protocol[S]):
    """A discrete contact problem and a way to solve it on given statuses."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""

    @property
    def contact_rows(self) -> Mask:
        """Which local rows are contact rows, (rows,)."""

    def on_set(self, statuses: Statuses, multiplier: Array | None) -> SetSolve[S]:
        """The problem of a set, beginning near a multiplier if one is given (collective).

        Raises
        ------
        ArithmeticError
            The active rows do not hold every body in place.
        """

    def hierarchy(self, warm: bool) -> Hierarchy:
        """Levels of the contact rows; one level where the start is near the answer (collective)."""

    def mirror_image(self, active: Mask, leaving: Mask) -> Mask:
        """Active rows in the mirror image of leaving ones across the contact edge (collective)."""

    def closing_share(self, state: S, penetrated: Mask) -> Array:
        """Share of the load at which each penetrated row closes, ∞ elsewhere, (rows,).

        Parameters
        ----------
        state
            Of the full load without contact.
        """

    def release(self) -> None:
        """Give back what the last set held, before the next one is made (collective)."""
