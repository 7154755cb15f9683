"""Test that the two cells of every inner facet lie on opposite sides of it.

Every cell is first turned so that its volume is positive. Then its facets, listed by the right-hand
rule, have outward normals, and two cells lie on opposite sides of a facet they share exactly if
they list its nodes in opposite orders. For simplices the sign of the vertex opposite to the facet
says the same; for quadrilaterals and hexahedra, whose Jacobian is positive at every corner, the
order decides also where the facet is warped. The order of the nodes of a cell in the file is
irrelevant: a file that lists some cells in the other order describes the same mesh, and the turned
cells pass. A cell that was pulled inside out does not pass: once turned, it overlaps its
neighbours.

If no two cells lie on the same side of their facet, the turned cells orient the mesh. So a band
without an orientation (a Möbius strip) always has such a pair. `meshes.overlap` tests for cells
that overlap without being neighbours.
"""

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from meshes.unstructured import FACETS, MeshError, Topology, first_of

BATCH = 200_000
"""Number of pairs of cells tested at once, which fit into the cache."""


def refuse_crowded(cells: Ints, cell: str, topology: Topology, number: Ints) -> None:
    """Refuse facets that more than two cells have.

    Parameters
    ----------
    cells : (cells, vertices)
    number : (cells,)
        Number of each cell in the file, from 0.

    Raises
    ------
    MeshError
        With the number of such facets and the cells of the first one.
    """
    if not topology.crowded:
        return
    table = np.array(FACETS[cell])
    facets = np.sort(cells[:, table].reshape(-1, table.shape[1]), axis=1)
    facet, count = np.unique(facets, axis=0, return_inverse=True, return_counts=True)[1:]
    first = np.argmax(count[facet.ravel()] > 2)
    rows = np.flatnonzero(facet.ravel() == facet.ravel()[first]) // len(table)
    which = ", ".join(str(k) for k in np.sort(number[rows] + 1))
    raise MeshError(
        f"has {topology.crowded} facets that more than two cells share: its cells overlap; the "
        f"first is of the cells {which} of the file"
    )


def refuse_same_side(
    points: Array, cells: Ints, cell: str, topology: Topology, number: Ints, turned: Mask
) -> None:
    """Refuse cells that lie on the same side of a facet they share.

    Parameters
    ----------
    points : (nodes, dimension)
    cells : (cells, vertices)
        Turned so that their volumes are positive.
    number : (cells,)
        Number of each cell in the file, from 0.
    turned : (cells,)
        Mask of the turned cells.

    Raises
    ------
    MeshError
        With the number of such cells, the first of them, and what to do.
    """
    same = _same_side(cells, cell, topology)
    if not same.any():
        return
    pairs = topology.pairs[same]
    wrong, other = _suspects(pairs, topology, turned)
    bad = np.zeros(len(cells), bool)
    bad[wrong] = True
    over = number[other[np.flatnonzero(wrong == np.flatnonzero(bad)[0])[0]]] + 1
    facet = "an edge" if points.shape[1] == 2 else "a face"
    fault = (
        f"{cell}s that overlap their neighbours: they lie on the same side of {facet} they share, "
        "as if pulled inside out"
    )
    advice = (
        "; its cells form a band with one side only (a Möbius strip), which is no body"
        if _one_sided(cells, cell, topology)
        else "; put the nodes there where no cell is pulled through another, or mesh that part anew"
    )
    raise MeshError(
        f"{first_of(points, cells, bad, fault, number)}, over cell {over} of the file{advice}"
    )


def _same_side(cells: Ints, cell: str, topology: Topology) -> Mask:
    """Mask (pairs,) of neighbours that list the nodes of their facet in the same order."""
    table = np.array(FACETS[cell])
    if table.shape[1] <= 3:  # two orders of two or three nodes: even and odd
        odd = np.stack([_is_odd(cells[:, list(facet)]) for facet in table], axis=1)
        first, second = (odd[topology.pairs[:, k], topology.pair_facets[:, k]] for k in range(2))
        return np.asarray(first == second)
    return np.concatenate(
        [
            ~_opposite(cells, cell, topology.pairs[i : i + BATCH],
                       topology.pair_facets[i : i + BATCH])
            for i in range(0, max(len(topology.pairs), 1), BATCH)
        ]
    )  # fmt: skip


def _is_odd(nodes: Ints) -> Mask:
    """Mask (facets,) of two or three nodes that an odd number of swaps sorts."""
    a, b, c = nodes[:, 0], nodes[:, 1], nodes[:, -1]
    return np.asarray(a > b if nodes.shape[1] == 2 else (a > b) ^ (b > c) ^ (a > c))


def _opposite(cells: Ints, cell: str, pairs: Ints, facets: NDArray[np.int8]) -> Mask:
    """Mask (pairs,) of cells that list the nodes of their facet in opposite cyclic orders."""
    table = np.array(FACETS[cell])
    a, b = (np.take_along_axis(cells[pairs[:, k]], table[facets[:, k]], axis=1) for k in range(2))
    size = table.shape[1]
    start = np.argmax(b == a[:, :1], axis=1)
    opposite = np.ones(len(a), bool)
    rows = np.arange(len(a))
    for k in range(1, size):
        opposite &= b[rows, (start - k) % size] == a[:, k]
    return opposite


def _suspects(pairs: Ints, topology: Topology, turned: Mask) -> tuple[Ints, Ints]:
    """The cell to report and the other one of two cells on one side of a facet, (pairs,) each.

    The reported cell has the larger share of its inner facets in such pairs. If shares are equal,
    it is the one with the rarer orientation in the file.
    """
    count = len(turned)
    share = np.bincount(pairs.ravel(), minlength=count) / np.maximum(
        np.bincount(topology.pairs.ravel(), minlength=count), 1
    )
    rare = turned if 2 * turned.sum() <= count else ~turned
    suspicion = share + 1e-3 * rare
    second = suspicion[pairs[:, 1]] > suspicion[pairs[:, 0]]
    rows = np.arange(len(pairs))
    return pairs[rows, second.astype(int)], pairs[rows, 1 - second]


def _one_sided(cells: Ints, cell: str, topology: Topology) -> bool:
    """Whether no orientation of the cells makes all neighbours list their facets oppositely.

    Each cell has two orientations; a facet links the orientations of its two cells that fit. If
    both orientations of a cell are linked, no orientation exists (the orientation cover is
    connected).
    """
    same = _same_side(cells, cell, topology)
    a, b = topology.pairs.T
    n = len(cells)
    first = np.concatenate([a, a + n])
    second = np.concatenate([np.where(same, b + n, b), np.where(same, b, b + n)])
    label = connected((first, second), 2 * n)
    return bool((label[:n] == label[n:]).any())
