"""Boxes whose cells differ in size along each axis: the product of one grid per axis.

Graded cells make unequal subdomains. So graded boxes are stored cell by cell, as meshes from files,
and cut by graph partitioning.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from meshes.box import SIDES
from meshes.unstructured import CellMesh, Topology

CORNERS = {
    "quadrilateral": ((0, 0), (1, 0), (1, 1), (0, 1)),
    "hexahedron": (
        (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1),
    ),
}  # fmt: skip
"""Vertices of the cell in each cell of the grid, in VTK order."""


def graded_box(cell: str, coordinates: Sequence[NDArray[np.float64]]) -> CellMesh:
    """A box between grid lines; nodes are numbered with x fastest.

    Parameters
    ----------
    cell
        Cell type; triangles and tetrahedra share the diagonals that ascend along all axes.
    coordinates
        Ascending grid coordinates along each axis.
    """
    sizes = [len(c) for c in coordinates]
    points = _ordered(coordinates)
    first = _ordered([np.arange(n - 1) for n in sizes])
    strides = np.cumprod([1, *sizes[:-1]])
    cells = np.concatenate(
        [(first @ strides)[:, None] + np.array(shape) @ strides for shape in _shapes(cell)]
    )
    topology = Topology.of(cells, cell)
    sides = {}
    for name, axis, end in SIDES[: 2 * len(sizes)]:
        place = np.arange(len(points)) // strides[axis] % sizes[axis]
        on_side = place[topology.facets] == end * (sizes[axis] - 1)
        sides[name] = np.flatnonzero(on_side.all(axis=1)).astype(np.int32)
    return CellMesh(
        cell=cell,
        points=points,
        cells=cells,
        topology=topology,
        sides=sides,
        groups={},
        tags=np.zeros(len(cells), np.int32),
        name="a graded box",
    )


def _ordered(axes: Sequence[NDArray]) -> NDArray:
    """All combinations of values along each axis, the first axis fastest, (points, axes)."""
    return np.stack([g.ravel(order="F") for g in np.meshgrid(*axes, indexing="ij")], axis=1)


def _shapes(cell: str) -> list[tuple[tuple[int, ...], ...]]:
    """Corners of the cells that fill a cell of the grid, positively oriented."""
    if cell in CORNERS:
        return [CORNERS[cell]]
    dimension = 2 if cell == "triangle" else 3
    shapes = []
    for order in permutations(range(dimension)):
        corners = [(0,) * dimension]
        for axis in order:
            corners.append(tuple(v or int(i == axis) for i, v in enumerate(corners[-1])))
        if np.linalg.det(np.array(corners[1:], float)) < 0:
            corners[-2], corners[-1] = corners[-1], corners[-2]
        shapes.append(tuple(corners))
    return shapes
