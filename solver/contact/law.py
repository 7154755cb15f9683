"""Contact laws: which contact forces are admissible, and when a point opens or closes.

A law is one object. The active-set loop asks it which active normal rows may stay active and which
others join them, and then for the statuses of all rows; the certificate's numbers are those of its
conditions. A new law is a new class: Tresca's and Coulomb's laws (`solver.contact.friction_law`)
keep active the tangential rows whose traction is below the slip limit and prescribe the slip
traction of the others, a tied contact keeps every row active.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from solver.backend import Statuses

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Found:
    """The numbers of a state that a law needs.

    Attributes
    ----------
    multiplier, jumps, distance : (rows,)
        λ, B u - c, and that over the displacement of the row's body, as `SetState` has them.
    force, away
        Multipliers and distances up to which they count as zero, by the error of the state.
    strongest
        The largest multiplier of an active row.
    """

    multiplier: Array
    jumps: Array
    distance: Array
    force: float
    away: float
    strongest: float


class ContactLaw(Protocol):
    """A contact law as the active-set loop uses it; arrays are (rows,), local parts.

    `may_stay_active` and `closes` are asked of normal rows alone.
    """

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def settles(self) -> bool:
        """Whether sets come to one that is the answer's.

        Where prescribed forces follow the answer, they only come close to it.
        """

    def may_stay_active(self, multiplier: Array, tolerance: float) -> Mask:
        """Active rows whose multiplier the law admits, to a tolerance."""

    def closes(self, distance: Array, tolerance: float) -> Mask:
        """Open rows whose penetration the law does not admit, to a tolerance."""

    def initial(self, active: Mask, multiplier: Array | None) -> Statuses:
        """Statuses for a set of active normal rows, near a multiplier if given (collective)."""

    def consistent(self, statuses: Statuses) -> Statuses:
        """The statuses after normal rows were taken out of the active set (collective)."""

    def following(
        self, normals: Mask, found: Found, before: Statuses, ahead: bool
    ) -> tuple[Statuses, Mask]:
        """Statuses with the normal rows that are active from now on (collective).

        Parameters
        ----------
        before
            Of the set that the state solves.
        ahead
            Whether points may let go of which the state alone does not tell it.

        Returns
        -------
        The statuses, and which tangential rows (rows,) belong to such points.
        """


@dataclass(frozen=True)
class Frictionless:
    """Signorini's conditions: λ ≥ 0, B u ≤ c, λ (B u - c) = 0 in each contact row."""

    name: str = "frictionless"
    settles: bool = True

    def may_stay_active(self, multiplier: Array, tolerance: float) -> Mask:
        """Rows without a tensile multiplier."""
        return multiplier > -tolerance

    def closes(self, distance: Array, tolerance: float) -> Mask:
        """Rows that are penetrated."""
        return distance > tolerance

    def initial(self, active: Mask, multiplier: Array | None) -> Statuses:
        """The active rows; the others carry no force."""
        return Statuses(active)

    def consistent(self, statuses: Statuses) -> Statuses:
        """The same."""
        return statuses

    def following(
        self, normals: Mask, found: Found, before: Statuses, ahead: bool
    ) -> tuple[Statuses, Mask]:
        """The active rows; the others carry no force."""
        return Statuses(normals), np.zeros_like(normals)
