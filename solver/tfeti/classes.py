"""Congruence classes: subdomains of one stiffness, solved together.

All members share K, its kernel R and its factor. On the interface, K⁺ acts either as one dense
block, which makes the class's share of the dual operator a single matrix product, or through
sparse solves with a column for each member.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solver.tfeti.generalised_inverse import GeneralisedInverse


@dataclass(frozen=True, eq=False)
class SubdomainClass:
    """Subdomains of equal stiffness on this rank.

    Attributes
    ----------
    stiffness : (n, n)
        K, before any condition is imposed.
    kernel : (n, k)
        Orthonormal rigid motions R; k = 0 where held unknowns are eliminated instead.
    free : (m,)
        Unknowns that are solved for; all of them unless held ones are eliminated.
    interface : (i,)
        Unknowns that B touches in some member.
    members : (s,)
        Local numbers of the subdomains.
    inverse
        K⁺ on the free unknowns.
    block : (i, i) or None
        K⁺ restricted to the interface, where that pays.
    """

    stiffness: sparse.csr_matrix
    kernel: NDArray[np.float64]
    free: NDArray[np.int64]
    interface: NDArray[np.int64]
    members: NDArray[np.int64]
    inverse: GeneralisedInverse
    block: NDArray[np.float64] | None

    @property
    def unknowns(self) -> int:
        """Unknowns of one member."""
        return self.stiffness.shape[0]

    def solve(self, loads: NDArray[np.float64]) -> NDArray[np.float64]:
        """K⁺ on full vectors, (n, s) to (n, s); held unknowns stay zero."""
        if len(self.free) == self.unknowns:
            return self.inverse.solve(loads)
        result = np.zeros(loads.shape, order="F")
        result[self.free] = self.inverse.solve(loads[self.free])
        return result

    def apply_interface(self, loads: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """K⁺ on interface vectors, one row a member: (s, i) to (s, i)."""
        if self.block is not None:
            np.matmul(loads, self.block, out=out)
            return
        place = np.searchsorted(self.free, self.interface)
        full = np.zeros((len(self.free), len(loads)), order="F")
        full[place] = loads.T
        out[:] = self.inverse.solve(full)[place].T


APPLICATIONS = 150
"""Applications of the dual operator a solve is expected to need; weighs the dense block."""

BLOCK_LIMIT = 3e9
"""Largest dense block, in bytes."""


def dense_block_pays(unknowns: int, interface: int, members: int) -> bool:
    """Whether the dense interface block costs less than sparse solves over a whole run.

    Building it takes one sparse solve a column of the interface; each application then replaces
    one sparse solve a member by a row of a matrix product, some thirty times cheaper.
    """
    if 8.0 * interface**2 > BLOCK_LIMIT:
        return False
    product = 2.0 * interface**2 / 3e10
    sparse_solve = 60.0 * unknowns**1.33 / 1.5e9
    dense = interface * sparse_solve + APPLICATIONS * members * product
    return dense < APPLICATIONS * members * sparse_solve
