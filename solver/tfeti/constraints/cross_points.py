"""Cross-point gluing: rows at nodes of several subdomains join subdomains with a common face only.

The m copies of a node are glued by m - 1 orthonormal rows C, any basis of the complement of
(1, …, 1). In the graph whose edges join subdomains with a common face, with the Laplacian
L = Cᵀ Λ C, the eigenvectors are such a basis. Weighted by W = Λ/λ, with λ the largest eigenvalue,
they join neighbours alone:

    Cᵀ W C = L/λ.

So G W Gᵀ has blocks between subdomains with a common face, and none between those that only meet at
an edge or a corner. At an edge of a regular split four subdomains are a cycle, Λ = (2, 2, 4); at a
corner eight are a cube, Λ = (2, 2, 2, 4, 4, 4, 6).

This halves the coarse factor and the time of its solves; the number of operator applications stays
about the same. Where there are few subdomains, or in the plane, a coarse solve takes next to no
time beside an operator application, and all subdomains are neighbours.
"""

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from solver.vectors import Array, Ints, Mask


def coarse_solves_matter(comm: MPI.Intracomm, subdomains: Ints, dimension: int, many: int) -> bool:
    """Whether the time of a coarse solve matters beside an operator application (collective).

    Parameters
    ----------
    subdomains
        Numbers of the subdomains of this rank's copies of nodes.
    many
        Number of subdomains from which on it matters in space; in the plane it never matters.
    """
    count = comm.allreduce(int(subdomains.max(initial=-1)), op=MPI.MAX) + 1
    return dimension == 3 and count >= many


def helmert(m: int) -> Array:
    """Orthonormal rows (m - 1, m) that span the complement of (1, …, 1)."""
    rows = np.zeros((m - 1, m))
    for k in range(1, m):
        rows[k - 1, :k] = 1.0
        rows[k - 1, k] = -k
        rows[k - 1] /= np.sqrt(k * (k + 1.0))
    return rows


def joining(adjacent: Mask) -> tuple[Array, Array]:
    """Gluing rows of the copies of a node and their weights.

    Parameters
    ----------
    adjacent : (m, m)
        Mask of the pairs of copies whose subdomains are neighbours.

    Returns
    -------
    Orthonormal rows (m - 1, m) that span the complement of (1, …, 1), and weights (m - 1,): Λ/λ, or
    Helmert's rows and ones where the graph is not connected or all are neighbours.
    """
    m = len(adjacent)
    if m == 2 or adjacent.sum() == m * (m - 1) or connected_components(adjacent)[0] > 1:
        return helmert(m), np.ones(m - 1)
    laplacian = np.diag(adjacent.sum(axis=1)) - adjacent.astype(float)
    values, vectors = np.linalg.eigh(laplacian)
    return vectors[:, 1:].T.copy(), values[1:] / values[-1]


class Neighbours:
    """Pairs of subdomains with a common face: the pairs that are alone at some node.

    Every rank holds all pairs.

    Parameters
    ----------
    pairs : (n, 2)
        Pairs of subdomains that are alone at some node of this rank; pairs may repeat.
    """

    def __init__(self, comm: MPI.Intracomm, pairs: Ints) -> None:
        keys = np.unique(self._keys(pairs[:, 0], pairs[:, 1]))
        self._of_all_ranks = np.unique(np.concatenate(comm.allgather(keys)))

    @staticmethod
    def _keys(a: Ints, b: Ints) -> Ints:
        return np.minimum(a, b) << 32 | np.maximum(a, b)

    def adjacent(self, subdomains: Ints) -> Mask:
        """Masks (n, m, m) of neighbours among the subdomains (n, m) at each node."""
        keys = self._keys(subdomains[:, :, None], subdomains[:, None])
        if len(self._of_all_ranks) == 0:
            return np.zeros(keys.shape, bool)
        at = np.minimum(np.searchsorted(self._of_all_ranks, keys), len(self._of_all_ranks) - 1)
        return np.asarray(self._of_all_ranks[at] == keys)

    def patterns(self, subdomains: Ints) -> Iterator[tuple[Ints, Array, Array]]:
        """Places of the nodes with the same graph, and the rows and weights of `joining` for it."""
        n, m = subdomains.shape
        if m == 2:
            yield np.arange(n), *joining(~np.eye(2, dtype=bool))
            return
        adjacent = self.adjacent(subdomains).reshape(n, m * m)
        patterns, pattern = np.unique(np.packbits(adjacent, axis=1), axis=0, return_inverse=True)
        pattern = pattern.reshape(-1)
        for number in range(len(patterns)):
            chosen = np.flatnonzero(pattern == number)
            yield chosen, *joining(adjacent[chosen[0]].reshape(m, m))
