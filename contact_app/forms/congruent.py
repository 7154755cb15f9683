"""Subdomains of forms that share a stiffness matrix, on one rank and among ranks.

Sub-boxes of a regular mesh have matrices that are equal but for rounding. A class uses the matrix
and the points of its first member on the first rank that has it. So they are equal to the last bit
on all ranks, which then compute one factor together.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from contact_app.forms.subdomains import Subdomains
from meshes.arrays import Array, Ints

EQUAL = 1e-12
"""Difference of entries of two matrices, over the largest, that counts as round-off."""


@dataclass(frozen=True, eq=False)
class Congruent:
    """Subdomains of this rank that share a stiffness."""

    members: Ints  # (members,)
    """Numbers of the subdomains."""
    stiffness: sparse.csr_matrix  # (n, n)
    points: Array  # (nodes, 3)
    """Points of one member, of this rank or another."""
    number: int
    """Number of the class among the classes of all ranks."""


def congruent(
    subdomains: Subdomains, stiffness: list[sparse.csr_matrix], grid: bool
) -> list[Congruent]:
    """The classes of this rank (collective); one per subdomain if there is no grid."""
    classes: list[list[int]] = []
    for number, K in enumerate(stiffness):
        for members in classes if grid else ():
            if _equal(stiffness[members[0]], K):
                members.append(number)
                break
        else:
            classes.append([number])
    groups = [
        Congruent(np.array(c), stiffness[c[0]], subdomains.points[subdomains.copies(c[0])], k)
        for k, c in enumerate(classes)
    ]  # fmt: skip
    return _of_all_ranks(subdomains, groups) if grid and subdomains.comm.size > 1 else groups


def _of_all_ranks(subdomains: Subdomains, groups: list[Congruent]) -> list[Congruent]:
    """Classes in an order that is the same on all ranks, with equal matrices (collective)."""
    comm, merged, left, number = subdomains.comm, [], groups, 0
    for rank in range(comm.size):
        received = comm.bcast(
            [(c.stiffness, c.points) for c in left] if rank == comm.rank else None, root=rank
        )
        for K, points in received:
            same = next((c for c in left if _equal(K, c.stiffness)), None)
            if same is not None:
                merged.append(replace(same, stiffness=K, points=points, number=number))
                left = [c for c in left if c is not same]
            number += 1
    return merged


def _equal(one: sparse.csr_matrix, other: sparse.csr_matrix) -> bool:
    """Whether two matrices are equal but for rounding."""
    return one is other or bool(
        one.shape == other.shape
        and one.nnz == other.nnz
        and np.array_equal(one.indices, other.indices)
        and np.abs(one.data - other.data).max() <= EQUAL * np.abs(one.data).max()
    )
