"""Subdomains of one stiffness, which are processed together.

A class has the stiffness of its members once. Methods that factor it add the factor
(`solver.tfeti.subdomain.classes`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from solver.vectors import Array, Ints

MEMBERS_AT_ONCE = 128
"""Number of members whose full vectors are processed together."""


@dataclass(frozen=True, eq=False)
class SubdomainClass:
    """Subdomains of equal stiffness on this rank."""

    stiffness: sparse.csr_matrix  # (n, n)
    """K, before any condition is imposed."""
    kernel: Array  # (n, k)
    """Orthonormal rigid motions R; k = 0 where held unknowns are eliminated instead."""
    motions: Array  # (n, r)
    """Orthonormal rigid motions, also where held unknowns are eliminated."""
    free: Ints  # (m,)
    """Unknowns that are solved for; all unknowns unless held ones are eliminated."""
    interface: Ints  # (i,)
    """Unknowns with entries in B in some member, in the order of vectors for K⁺."""
    members: int
    """Number of subdomains in the class."""

    @property
    def unknowns(self) -> int:
        """Unknowns of one member."""
        return self.stiffness.shape[0]

    @property
    def rigid(self) -> bool:
        """Whether the members are rigid bodies, without any stiffness."""
        return self.stiffness.nnz == 0

    @cached_property
    def resistance(self) -> Array:
        """Diagonal of K, (n,); infinite for rigid bodies, which no force strains."""
        if self.rigid:
            return np.full(self.unknowns, np.inf)
        return np.asarray(self.stiffness.diagonal())

    @cached_property
    def interface_stiffness(self) -> sparse.csr_matrix:
        """K between interface unknowns, (i, i)."""
        return self.stiffness[self.interface][:, self.interface].tocsr()

    @cached_property
    def row_sums(self) -> Array:
        """Σ_j |K_ij| of each unknown, (n,)."""
        return np.asarray(abs(self.stiffness).sum(axis=1)).ravel()

    def batches(self) -> Iterator[slice]:
        """Slices of members, for operations whose temporary arrays should stay small."""
        for begin in range(0, self.members, MEMBERS_AT_ONCE):
            yield slice(begin, min(begin + MEMBERS_AT_ONCE, self.members))


def interface_slices(classes: Sequence[SubdomainClass]) -> list[slice]:
    """Slice of each class in an interface vector."""
    ends = np.cumsum([0, *(c.members * len(c.interface) for c in classes)])
    return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
