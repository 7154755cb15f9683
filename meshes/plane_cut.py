"""The cut of a plane through cells: its area and centroid.

Each cell is divided into simplices with vertices at its nodes, and the plane cuts each in a
polygon. A vertex on the plane counts as in front of it, so that the plane along the facets between
two cells cuts the cell behind it alone. In cells with curved edges the simplices have the nodes of
second order as vertices.
"""

from functools import cache
from itertools import combinations

import numpy as np

from meshes.arrays import Array
from meshes.quadratic import VERTICES, node_vertices

ON_PLANE = 1e-9
"""Distance of a node from the plane, over the size of the body, that counts as zero."""

BRICK = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
"""The tetrahedra about a diagonal of a hexahedron."""

SIMPLICES = {
    "triangle": ((0, 1, 2),),
    "quadrilateral": ((0, 1, 2), (0, 2, 3)),
    "tetrahedron": ((0, 1, 2, 3),),
    "hexahedron": BRICK,
}
"""Vertices of the simplices that fill a cell."""

OF_SECOND_ORDER = {
    "triangle": ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    "tetrahedron": (
        (0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3),
        (4, 9, 5, 8), (4, 9, 8, 7), (4, 9, 7, 6), (4, 9, 6, 5),
    ),
}  # fmt: skip
"""Simplices with all nodes of triangles and tetrahedra of second order, in VTK's order."""


@cache
def simplices(cell: str, curved: bool) -> tuple[tuple[int, ...], ...]:
    """Nodes of the simplices that fill a cell; if curved, with the nodes of second order."""
    if not curved:
        return SIMPLICES[cell]
    if cell in OF_SECOND_ORDER:
        return OF_SECOND_ORDER[cell]
    d = 2 if cell == "quadrilateral" else 3
    corners: tuple[tuple[int, int, int], ...] = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
    corners += tuple((x, y, 1) for x, y, _ in corners)
    at = np.array(corners)[: VERTICES[cell], :d]
    place = {  # twice the place of each node in the unit cell
        tuple(int(v) for v in 2 * at[list(on)].mean(axis=0)): i
        for i, on in enumerate(node_vertices(cell))
    }
    result = []
    for low in at:  # the quarter or eighth of the cell about each vertex
        nodes = [place[tuple(int(v) for v in low + corner)] for corner in at]
        result += [tuple(nodes[i] for i in simplex) for simplex in SIMPLICES[cell]]
    return tuple(result)


def cut(corners: Array, pieces: tuple[tuple[int, ...], ...], heights: Array) -> tuple[float, Array]:
    """Area (in 2D length) of the cut of some cells, and the integral of the position over it.

    Parameters
    ----------
    corners : (cells, nodes, 3)
    pieces
        Nodes of the simplices of a cell, `simplices`.
    heights : (cells, nodes)
        Height of the nodes above the plane; exactly zero for nodes on it.

    Returns
    -------
    area, (3,)
    """
    through = (heights < 0.0).any(axis=1) & (heights >= 0.0).any(axis=1)
    corners, heights = corners[through], heights[through]
    split = np.array(pieces)
    x, h = corners[:, split].reshape(-1, split.shape[1], 3), heights[:, split]
    h = h.reshape(-1, split.shape[1])
    area, first = 0.0, np.zeros(3)
    count = split.shape[1]
    for size in range(1, count):
        for behind in combinations(range(count), size):
            before = tuple(i for i in range(count) if i not in behind)
            some = (h[:, behind] < 0.0).all(axis=1) & (h[:, before] >= 0.0).all(axis=1)
            if some.any():
                polygon = _polygon(x[some], h[some], behind, before)
                part, moment = _integrals(polygon)
                area, first = area + part, first + moment
    return area, first


def _polygon(x: Array, h: Array, behind: tuple[int, ...], before: tuple[int, ...]) -> Array:
    """Points in which the edges of simplices cross the plane, in order, (simplices, points, 3)."""
    edges = [(i, j) for i in behind for j in before]
    if len(behind) == len(before) == 2:
        (a, c), (_, d), (b, _), _ = edges
        edges = [(a, c), (a, d), (b, d), (b, c)]
    points = []
    for i, j in edges:
        share = (h[:, i] / (h[:, i] - h[:, j]))[:, None]
        points.append(x[:, i] + share * (x[:, j] - x[:, i]))
    return np.stack(points, axis=1)


def _integrals(polygon: Array) -> tuple[float, Array]:
    """Area and integral of the position over segments, triangles or quadrilaterals, summed."""
    if polygon.shape[1] == 2:
        length = np.linalg.norm(polygon[:, 1] - polygon[:, 0], axis=1)
        return float(length.sum()), length @ polygon.mean(axis=1)
    area, first = 0.0, np.zeros(3)
    for k in range(1, polygon.shape[1] - 1):
        triangle = polygon[:, [0, k, k + 1]]
        sides = triangle[:, 1:] - triangle[:, :1]
        each = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        area, first = area + float(each.sum()), first + each @ triangle.mean(axis=1)
    return area, first
