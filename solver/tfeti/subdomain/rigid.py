"""A rigid body as a subdomain: its stiffness is zero, and all its free unknowns are kernel.

The unknowns of a rigid body are its translation and its rotation. No displacement of them takes
energy, so K = 0, every unknown that is free is a column of R, and K⁺ = 0. A rigid body adds nothing
to the dual operator. It adds its equilibrium to the coarse problem:

    Rᵀ (f - Bᵀ λ) = 0,

which says that the contact forces balance the force and moment on the body. Unknowns that are
prescribed are eliminated.
"""

import numpy as np
from scipy import sparse

from solver.vectors import Array, Ints


class ZeroInverse:
    """K⁺ of a rigid body (protocol `Inverse`)."""

    def solve(self, loads: Array) -> Array:
        """Zeros: no load strains a rigid body."""
        return np.zeros(loads.shape, order="F")

    def restricted(self, unknowns: Ints) -> "ZeroBlock":
        """K⁺ between some unknowns."""
        return ZeroBlock(len(unknowns))


class ZeroBlock:
    """A part of K⁺, or of K, of a rigid body (protocol `Block`)."""

    order = 1

    def __init__(self, size: int) -> None:
        self._size = size

    def apply(self, loads: Array, out: Array) -> None:
        """Put zeros into out."""
        out[:] = 0.0

    @property
    def schur_complement(self) -> "ZeroBlock":
        """A rigid body has no stiffness."""
        return self


def zero_stiffness(unknowns: int) -> sparse.csr_matrix:
    """K of a rigid body."""
    return sparse.csr_matrix((unknowns, unknowns))
