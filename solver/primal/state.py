"""The answer of multigrid on an active set."""

from dataclasses import dataclass

import numpy as np

from solver.backend import SetState
from solver.vectors import Array, Mask


@dataclass(frozen=True, eq=False)
class PrimalState(SetState):
    """The answer of a set as far as it is solved; local parts.

    Rows other than contact, tangential and tied rows have no multiplier, no jump and the size one.
    """

    lengths: Array  # (bodies,)
    """Lengths relative to which displacements are measured."""
    u: Array  # (unknowns,)
    error_square: float
    """Estimate of the squared error in energy norm."""
    errors: Array  # (bodies,)
    """Its share in each body."""
    imbalance: float
    """2-norm of the residual."""
    met: Mask | None = None  # (rows,)
    """Open rows that close; None for all that are penetrated."""

    @property
    def closing(self) -> Array:
        """`distance`, without rows that do not close yet."""
        return self.distance if self.met is None else np.where(self.met, self.distance, -np.inf)
