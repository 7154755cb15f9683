"""Nodes of second-order cells: vertices, middles of edges, of quadrilateral faces and of cells.

Full Lagrange cells: 6 nodes in a triangle, 9 in a quadrilateral, 10 in a tetrahedron, 27 in a
hexahedron, in VTK's order (VTK_QUADRATIC_TRIANGLE, VTK_BIQUADRATIC_QUAD, VTK_QUADRATIC_TETRA,
VTK_TRIQUADRATIC_HEXAHEDRON): first the vertices, then the nodes listed here.

A cell is as curved as its nodes: the position of a point of the reference cell is interpolated
between all of them (isoparametric). Serendipity cells (8 and 20 nodes) become full cells: the
missing nodes are put where the serendipity interpolation maps them, which the full cells reproduce.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from meshes.arrays import Array, Ints

EDGES = {
    "interval": ((0, 1),),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hexahedron": (
        (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
        (0, 4), (1, 5), (2, 6), (3, 7),
    ),
}  # fmt: skip
"""Vertices of the edges of a cell."""

FACES = {
    "hexahedron": (
        (0, 3, 7, 4), (1, 2, 6, 5), (0, 1, 5, 4), (3, 2, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7),
    ),
}  # fmt: skip
"""Vertices of the faces that have a node in the middle."""

VERTICES = {"interval": 2, "triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}


class Facet(NamedTuple):
    """Name of a facet as a cell, its number of vertices and its degree."""

    cell: str
    vertices: int
    degree: int


CORNERS_ONLY = (
    "cells have nodes on their edges: degree 1 uses their corners only, edges are straight "
    "(degree: 2 keeps them curved)"
)
"""Note on a second-order file that is used at degree 1."""

FACETS = {
    (2, 2): Facet("interval", 2, 1),
    (2, 3): Facet("interval", 2, 2),
    (3, 3): Facet("triangle", 3, 1),
    (3, 6): Facet("triangle", 3, 2),
    (3, 4): Facet("quadrilateral", 4, 1),
    (3, 9): Facet("quadrilateral", 4, 2),
}
"""Facets by the dimension of the scene and the number of their nodes."""

STRAIGHT = 1e-9
"""Distance of a node from the middle of its vertices, over the size, that counts as zero."""

CENTRED = ("quadrilateral", "hexahedron")
"""Cells that have a node in their middle."""


@cache
def node_vertices(cell: str) -> tuple[tuple[int, ...], ...]:
    """Vertices around each node of a second-order cell, in VTK's order.

    The node is their middle.
    """
    corners = tuple((v,) for v in range(VERTICES[cell]))
    centre = (tuple(range(VERTICES[cell])),) if cell in CENTRED else ()
    return (*corners, *EDGES[cell], *FACES.get(cell, ()), *centre)


def middles_of(x: Array, cell: str) -> Array:
    """Coordinates of the nodes that cells have besides vertices, (cells, further nodes, d).

    Parameters
    ----------
    x : (cells, nodes, d)
        Nodes in VTK's order: of first order (straight edges), serendipity, or all.
    """
    v, nodes = VERTICES[cell], node_vertices(cell)
    count, edges = x.shape[1], len(EDGES[cell])
    if count == len(nodes):
        return x[:, v:]
    if count == v:
        return straight_middles(x, cell)
    middles = [x[:, v:]]
    for on in nodes[v + edges :]:  # shape functions of 8 and 20 nodes amid the face or cell
        around = [v + i for i, edge in enumerate(EDGES[cell]) if set(edge) <= set(on)]
        share = 0.5 if len(on) == 4 else 0.25
        middle = share * x[:, around].sum(axis=1) - 0.25 * x[:, list(on)].sum(axis=1)
        middles.append(middle[:, None])
    return np.concatenate(middles, axis=1)


def straight_middles(x: Array, cell: str) -> Array:
    """Coordinates of the further nodes for straight edges.

    `x` as in `middles_of`, vertices first.
    """
    on = node_vertices(cell)[VERTICES[cell] :]
    return np.stack([x[:, list(vertices)].mean(axis=1) for vertices in on], axis=1)


def bulges(x: Array, middles: Array, cell: str) -> Array:
    """Deviation of edges from straight ones, over the size of the cell, (cells,).

    Parameters
    ----------
    x : (cells, vertices or more, d)
    middles : (cells, further nodes, d)
    """
    away = np.linalg.norm(middles - straight_middles(x, cell), axis=2).max(axis=1)
    return away / np.ptp(x, axis=1).max(axis=1)


def reordering(cell: str, order: tuple[int, ...]) -> Ints:
    """New number of each node when the vertices of a second-order cell are reordered."""
    nodes = node_vertices(cell)
    place = {frozenset(on): k for k, on in enumerate(nodes)}
    return np.array([place[frozenset(order[i] for i in on)] for on in nodes])


def facet_table(facets: tuple[tuple[int, ...], ...], cell: str) -> Ints:
    """Nodes of each facet of a second-order cell, its vertices first, (facets, nodes)."""
    nodes = node_vertices(cell)
    table = []
    for facet in facets:
        inner = [
            i for i, on in enumerate(nodes) if len(on) > 1 and set(on) <= set(facet)
        ]  # middles of its edges and its own
        table.append([*facet, *inner])
    return np.array(table)


def with_middles(points: Array, cells: Ints, cell: str) -> tuple[Array, Ints]:
    """Points and cells of second order on the vertices of a mesh of straight edges.

    Parameters
    ----------
    points : (nodes, dimension)
    cells : (cells, vertices)
        In VTK order.

    Returns
    -------
    Points, the given ones first, and cells with all their nodes in VTK order.
    """
    numbers, added = [cells], [points]
    count = len(points)
    groups = [np.array(EDGES[cell])]
    if cell in FACES:
        groups.append(np.array(FACES[cell]))
    for table in groups:
        corners = cells[:, table].reshape(-1, table.shape[1])
        first, number = _distinct(np.sort(corners, axis=1))
        added.append(points[corners[first]].mean(axis=1))
        numbers.append(count + number.reshape(len(cells), -1))
        count += len(first)
    if cell in CENTRED:
        added.append(points[cells].mean(axis=1))
        numbers.append(count + np.arange(len(cells))[:, None])
    return np.concatenate(added), np.concatenate(numbers, axis=1)


def _distinct(rows: Ints) -> tuple[Ints, Ints]:
    """First occurrence of each distinct row, and the number of each row among them."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order][1:] != rows[order][:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(new) - 1
    return order[new], number
