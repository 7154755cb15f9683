"""Contact laws: which contact forces are admissible, and when a point opens or closes.

A law is one object. The active-set loop asks it which active rows may stay active, which others
join them, and which multipliers the rest have; the certificate's numbers are those of its
conditions. A new law is a new class: Tresca's and Coulomb's laws keep active the tangential rows
whose traction is below the slip limit and prescribe the slip traction of the others, a tied contact
keeps every row active.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ContactLaw(Protocol):
    """What the active-set loop asks of a contact law; arrays are (rows,), local parts."""

    @property
    def name(self) -> str:
        """For messages."""

    def may_stay_active(
        self, multiplier: NDArray[np.float64], tolerance: float
    ) -> NDArray[np.bool_]:
        """Active rows whose multiplier the law admits, to a tolerance."""

    def closes(self, distance: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
        """Open rows whose penetration the law does not admit, to a tolerance."""

    def tractions(
        self, multiplier: NDArray[np.float64], active: NDArray[np.bool_]
    ) -> NDArray[np.float64] | None:
        """Multipliers of the rows that are not active from now on; None where all are zero."""


@dataclass(frozen=True)
class Frictionless:
    """Signorini's conditions: λ ≥ 0, B u ≤ c, λ (B u - c) = 0 in each contact row."""

    name: str = "frictionless"

    def may_stay_active(
        self, multiplier: NDArray[np.float64], tolerance: float
    ) -> NDArray[np.bool_]:
        """Rows without a tensile multiplier."""
        return multiplier > -tolerance

    def closes(self, distance: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
        """Rows that are penetrated."""
        return distance > tolerance

    def tractions(
        self, multiplier: NDArray[np.float64], active: NDArray[np.bool_]
    ) -> NDArray[np.float64] | None:
        """None: an open row carries no force."""
        return None
