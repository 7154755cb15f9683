"""Nodes of a mesh file: those at one place become one, and those without cells are dropped.

Merging is reported. Where it joins what the file may have apart on purpose, the sides of a crack or
parts that only touch, the note says so, and becomes a warning of the certificate.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from meshes.arrays import Array, Ints, Mask
from meshes.cell_shape import at_vertices, edge_lengths
from meshes.connected import connected

SAME_PLACE = 1e-9
"""Distance over the size of the body below which two nodes are merged."""

CLOSED_SEAM = "merged where the mesh is connected without them"
"""Part of the note on merged nodes that join parts which other cells connect."""

JOINED_GROUPS = "have no common node in the file"
"""Part of the note on merged nodes that join groups of cells."""

SAME_PLACE_EDGE = 1e-3
"""Distance over the shortest edge below which two nodes are merged, so that no cell collapses."""


def nodes_of(
    points: Array,
    cells: Ints,
    cell: str,
    notes: list[str],
    idle_is_usual: bool,
    groups: Mapping[str, Mask],
) -> tuple[Array, Ints]:
    """The points of the nodes of cells, merged at one place, and the number of each given node.

    Nodes of no cell have -1.

    Parameters
    ----------
    groups
        Masks of the cells of each group; none if the scene chose groups.
    """
    used = np.flatnonzero(np.bincount(cells.ravel()))  # sorting takes ten times as long
    idle = len(points) - len(used)
    if idle and not idle_is_usual:
        notes.append(f"{idle} nodes belong to no cell: dropped")
    same, merged = _same_place(points[used], cells, used, cell)
    if merged:
        notes.append(f"{merged} nodes lie where another one does: merged")
        ends = [np.repeat(cells[:, 0], cells.shape[1]), cells.ravel()]
        piece = connected(ends, len(points))
        notes += _closed_seams(points, piece, used, same)
        of_groups = {name: np.unique(piece[cells[mask, 0]]) for name, mask in groups.items()}
        notes += _joined_groups(piece[used], same, of_groups)
    rename = np.full(len(points), -1, np.int64)
    rename[used] = same
    return points[used][np.unique(same, return_index=True)[1]], rename


def _closed_seams(points: Array, piece: Ints, used: Ints, same: Ints) -> list[str]:
    """A note on merged nodes between which the cells are connected without them.

    They close the seam of a ring, or a crack, which the file has with nodes on both of its sides.

    Parameters
    ----------
    piece : (nodes,)
        Number of the piece that the cells connect, of each node.
    same : (used,)
        Number of each used node after merging.
    """
    order = np.lexsort([piece[used], same])
    again = (np.diff(same[order]) == 0) & (np.diff(piece[used][order]) == 0)
    if not again.any():
        return []
    place = ", ".join(f"{x:g}" for x in points[used[order[1:][again].min()]])
    return [
        f"{again.sum()} nodes were {CLOSED_SEAM}, the first at ({place}): this closes a seam, and "
        f"it closes a crack, too; the sides of a crack that may open have to lie more than "
        f"{SAME_PLACE:g} of the body's size apart in the file"
    ]


def _joined_groups(piece: Ints, same: Ints, of_groups: Mapping[str, Ints]) -> list[str]:
    """A note on groups of cells that only merged nodes join, as parts of an assembly.

    Merged nodes within a group, too, are those of a file that repeats nodes everywhere.

    Parameters
    ----------
    piece, same : (used,)
        Piece of each used node, and its number after merging.
    of_groups
        The pieces with cells of each group.
    """
    order = np.lexsort([piece, same])
    merged = np.diff(same[order]) == 0
    pairs = np.stack([piece[order[:-1]][merged], piece[order[1:]][merged]], axis=1)
    within = np.array([np.isin(pairs, pieces) for pieces in of_groups.values()])  # group, pair, end
    if not len(within) or within.all(axis=2).any() or not within.any(axis=0).all():
        return []
    first, second = (list(of_groups)[k] for k in sorted(within[:, 0].argmax(axis=0)))
    return [
        f"the groups {first} and {second} {JOINED_GROUPS}: merging its nodes at one place makes "
        "them one body; parts that only touch are bodies of their own, by `group`"
    ]


def _same_place(points: Array, cells: Ints, used: Ints, cell: str) -> tuple[Ints, int]:
    """Number of each used node after merging nodes at one place, and the number of merged nodes."""
    count, size = len(points), float(np.ptp(points, axis=0).max())
    pairs = _pairs_within(points, SAME_PLACE * size)
    if len(pairs):  # seldom: lengths of all edges cost more than the search
        local = np.empty(used[-1] + 1, np.int64)
        local[used] = np.arange(len(used))
        lengths = edge_lengths(at_vertices(points, local[cells]), cell)
        shortest = float(lengths[lengths > SAME_PLACE * size].min(initial=size))
        pairs = _pairs_within(points, min(SAME_PLACE * size, SAME_PLACE_EDGE * shortest))
    if len(pairs) == 0:
        return np.arange(count), 0
    label = connected(pairs.T, count)
    first = np.unique(label, return_index=True)[1]  # numbered as the first of these nodes
    number = len(first)
    renumber = np.empty(number, np.int64)
    renumber[np.argsort(first)] = np.arange(number)
    return renumber[label], count - number


def _pairs_within(points: Array, reach: float) -> Ints:
    """Pairs of points (points, d) no farther from each other than `reach`, (pairs, 2).

    Close points have close projections on any line. So only points with a close neighbour in the
    projection on an arbitrary line are searched.
    """
    line = np.array([0.56, 0.61, 0.56])[: points.shape[1]]
    shadow = points @ (line / np.linalg.norm(line))
    order = np.argsort(shadow)
    near = np.diff(shadow[order]) <= reach + 1e-14 * float(np.abs(shadow).max(initial=0.0))
    some = order[np.append(near, False) | np.append(False, near)]
    pairs = cKDTree(points[some]).query_pairs(reach, output_type="ndarray")
    return np.asarray(some[pairs], np.int64)
