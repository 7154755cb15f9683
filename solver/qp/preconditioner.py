"""The protocol of an approximate inverse of the Hessian for MPRGP."""

from typing import Protocol

from solver.vectors import Mask, Vector


class Preconditioner(Protocol):
    """An approximate inverse of the Hessian, symmetric positive definite."""

    def apply(self, r: Vector, free_mask: Mask, out: Vector, /) -> None:
        """Put the preconditioned free gradient r into out.

        The values on components that are not free are set to zero afterwards.
        """
