"""The shape of cells: lengths of edges, Jacobians, and a test for folded cells."""

import numpy as np

from meshes.arrays import Array, Ints, Mask
from meshes.quadratic import EDGES
from meshes.subdomains import vtk_shapes

FOLDED = 1e-6
"""Smallest admissible ratio of the least to the largest Jacobian of a curved cell."""

SAMPLES = {"triangle": 4, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 3}
"""Number of points along an edge, minus one, at which the Jacobian of curved cells is evaluated."""

BATCH = 20_000
"""Number of curved cells evaluated at once."""

CORNERS = {
    "triangle": ((0, 1, 2),),
    "quadrilateral": ((0, 1, 3), (1, 2, 0), (2, 3, 1), (3, 0, 2)),
    "tetrahedron": ((0, 1, 2, 3),),
    "hexahedron": (
        (0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7),
        (4, 7, 5, 0), (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3),
    ),
}  # fmt: skip
"""Vertices and their neighbours along the axes, at which the Jacobian of a cell is evaluated."""


def cell_sizes(points: Array, cells: Ints, cell: str) -> Array:
    """Area or volume of each cell with straight edges, (cells,); of hexahedra nearly."""
    corners = np.array(CORNERS[cell])
    axes = points[cells[:, corners[:, 1:]]] - points[cells[:, corners[:, :1]]]
    mean = np.abs(np.linalg.det(axes)).mean(axis=1)
    return np.asarray(mean / {"triangle": 2.0, "tetrahedron": 6.0}.get(cell, 1.0))


def folded_inside(points: Array, cells: Ints, cell: str, degree: int) -> Mask:
    """Mask (cells,) of the cells whose Jacobian is not positive at some point of a grid."""
    slopes = vtk_shapes(cell, degree, _samples(cell))[1]
    folded = np.zeros(len(cells), bool)
    for i in range(0, len(cells), BATCH):
        part = slice(i, i + BATCH)
        jacobian = _determinants(np.tensordot(slopes, points[cells[part]], axes=(2, 1))).T
        folded[part] = jacobian.min(axis=1) <= FOLDED * jacobian.max(axis=1)
    return folded


def _determinants(columns: Array) -> Array:
    """Determinants of small matrices (points, d, cells, d); faster than by factorisation."""
    if columns.shape[1] == 2:
        a, b = columns[:, 0], columns[:, 1]
        return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(columns, (1, 3), (0, 1))
    return np.asarray(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def warped(points: Array, cells: Ints) -> Mask:
    """Mask of hexahedra whose corners do not decide the sign of the Jacobian inside.

    With m the mean of the four edges along each axis and d the largest deviation from it, the
    Jacobian is at least det m - (∏ (|m| + d) - ∏ |m|), by the multilinearity of determinants.
    """
    ends = points[cells[:, np.array(EDGES["hexahedron"])]]
    along = np.array([(0, 2, 4, 6), (1, 3, 5, 7), (8, 9, 10, 11)])
    sign = np.array([(1, -1, 1, -1), (1, -1, 1, -1), (1, 1, 1, 1)])
    edges = (ends[:, :, 1] - ends[:, :, 0])[:, along] * sign[:, :, None]
    mean = edges.mean(axis=2)
    length = np.linalg.norm(mean, axis=2)
    spread = np.linalg.norm(edges - mean[:, :, None], axis=3).max(axis=2)
    room = np.linalg.det(mean) - (length + spread).prod(axis=1) + length.prod(axis=1)
    return np.asarray(room <= FOLDED * length.prod(axis=1))


def _samples(cell: str) -> Array:
    """Points of a reference cell, its corners among them, (points, dimension)."""
    n, d = SAMPLES[cell], 2 if cell in ("triangle", "quadrilateral") else 3
    axes = np.meshgrid(*[np.arange(n + 1)] * d, indexing="ij")
    points = np.stack([axis.ravel() for axis in axes], axis=1)
    if cell in ("triangle", "tetrahedron"):
        points = points[points.sum(axis=1) <= n]
    return points / n


def at_vertices(points: Array, cells: Ints) -> Array:
    """Coordinates of the vertices of cells, (d, vertices, cells).

    Cells are contiguous in memory.
    """
    return np.take(np.ascontiguousarray(points.T), cells.T, axis=1)


def edge_lengths(vertices: Array, cell: str) -> Array:
    """Lengths (edges, cells) of the edges of cells with vertices (d, vertices, cells)."""
    result = np.empty((len(EDGES[cell]), vertices.shape[2]))
    for lengths, (first, second) in zip(result, EDGES[cell], strict=True):
        along = vertices[:, second] - vertices[:, first]
        np.sqrt(np.einsum("dc,dc->c", along, along), out=lengths)
    return result


def corner_jacobians(vertices: Array, cell: str) -> Array:
    """Jacobians (corners, cells) of cells with vertices (d, vertices, cells)."""
    result = np.empty((len(CORNERS[cell]), vertices.shape[2]))
    for jacobian, (origin, *others) in zip(result, CORNERS[cell], strict=True):
        along = vertices[:, others] - vertices[:, [origin]]
        jacobian[:] = _determinants(np.moveaxis(along, (1, 2), (0, 1))[None])[0]
    return result
