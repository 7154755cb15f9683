"""Fields of different meshes of one body, evaluated at the nodes of the finest mesh.

Solutions are compared in the space of the finest reference: a field of another mesh is evaluated at
its nodes, and squares are integrated over its cells, including curved edges. This is exact if the
finest mesh refines the other one. For a locally refined mesh the comparison uses the interpolant
and misses the field between two nodes of the finest mesh.

dolfinx's trees of bounding boxes find the cell that contains a point, or the nearest one. Newton's
method finds the local coordinates of the point in the cell.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.scene.material import Material
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints
from meshes.quadratic import VERTICES
from meshes.subdomains import vtk_order, vtk_places, vtk_shapes

BATCH = 4_000
"""Number of cells processed at once: some 100 MB for hexahedra of degree 2."""

STORED = 4
"""Number of meshes with a stored interpolation: 100 MB each for a finest mesh of 10⁶ nodes."""

SHARES = {2: (1, 1), 3: (1, 1, 2), (3, 3): (1, 1, 1), 6: (1, 1, 1, 3, 3, 3),
          4: (1, 1, 1, 1), 9: (1, 1, 1, 1, 2, 2, 2, 2, 4)}  # fmt: skip
"""Shares of a facet's area at its nodes, from the first-order facets between these nodes."""


@dataclass(frozen=True, eq=False)
class BodyNodes:
    """Nodes and cells of one body's mesh."""

    cell: str
    degree: int
    points: Array  # (nodes, 3)
    cells: Ints  # (cells, nodes per cell)
    """In VTK order."""
    tags: NDArray[np.int32]  # (cells,)
    """Numbers of materials."""
    facets: Ints  # (facets, nodes of a facet)
    """Facets of the contact boundary, in dolfinx's order, vertices first."""

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return 2 if self.cell in ("triangle", "quadrilateral") else 3


class PointsOfMesh:
    """The nodes of a finest mesh, at which fields of a body are compared."""

    def __init__(self, finest: BodyNodes) -> None:
        self._finest = finest
        self._operators: dict[bytes, sparse.csr_matrix] = {}

    def sample(self, body: BodyNodes, values: Array, first_order: bool = False) -> Array:
        """Evaluate a field (nodes, k) of a body, or its first-order interpolant, at the points."""
        kind = b"first" if first_order and body.degree > 1 else b"own"
        key = sha256(body.points.tobytes() + body.cells.tobytes() + kind).digest()
        if key not in self._operators:
            if len(self._operators) == STORED:
                del self._operators[next(iter(self._operators))]
            self._operators[key] = interpolation(body, self._finest.points, first_order)
        return np.asarray(self._operators[key] @ values.reshape(len(body.points), -1))

    @cached_property
    def areas(self) -> Array:
        """Share of the contact boundary's area at each point, (points,)."""
        finest, d = self._finest, self._finest.dimension
        result = np.zeros(len(finest.points))
        facets = finest.facets
        if len(facets):
            x = finest.points[facets[:, : _corners(d, facets.shape[1])]]
            share = np.array(_shares(d, facets.shape[1]), float)
            np.add.at(result, facets, _sizes(x, d)[:, None] * (share / share.sum()))
        return result

    def energy(self, field: Array, materials: Sequence[Material], plane: str | None) -> float:
        """a(e, e) of a field (points, dimension)."""
        lam, mu = np.array([material.lame(plane) for material in materials]).T
        total = 0.0
        cell, degree = self._finest.cell, self._finest.degree
        simplex = cell in ("triangle", "tetrahedron")
        for rows, weights, _, jacobian, slopes in self._batches(2 * (degree - simplex)):
            gradients = np.linalg.inv(jacobian) @ slopes
            strain = gradients @ field[self._finest.cells[rows]][:, None]
            strain = 0.5 * (strain + np.swapaxes(strain, 2, 3))
            tags = self._finest.tags[rows]
            density = lam[tags][:, None] * np.trace(strain, axis1=2, axis2=3) ** 2
            density += 2.0 * mu[tags][:, None] * (strain**2).sum(axis=(2, 3))
            total += float((weights * density).sum())
        return total

    def volume(self, field: Array) -> float:
        """∫ |e|² of a field (points, dimension)."""
        total = 0.0
        for rows, weights, values, *_ in self._batches(2 * self._finest.degree):
            u = values @ field[self._finest.cells[rows]]
            total += float((weights * (u**2).sum(axis=2)).sum())
        return total

    def _batches(self, rule: int) -> Iterator[tuple[slice, Array, Array, Array, Array]]:
        """Rows of cells, weights (c, q), shapes (q, k), Jacobians (c, q, d, d), slopes (q, d, k).

        At the points of a quadrature rule of a degree.
        """
        finest, d = self._finest, self._finest.dimension
        points, weights = dolfinx_compat.quadrature(finest.cell, rule)
        values, slopes = vtk_shapes(finest.cell, finest.degree, points)
        for start in range(0, len(finest.cells), BATCH):
            rows = slice(start, start + BATCH)
            jacobian = slopes @ finest.points[finest.cells[rows]][:, None, :, :d]
            yield rows, np.abs(np.linalg.det(jacobian)) * weights, values, jacobian, slopes


def interpolation(mesh: BodyNodes, at: Array, first_order: bool = False) -> sparse.csr_matrix:
    """Evaluation of functions on a mesh at points (n, 3), (n, nodes).

    First-order functions are linear, or linear along each axis, between vertices.
    """
    columns, place, corners = *_places(mesh, at), VERTICES[mesh.cell]
    values = vtk_shapes(mesh.cell, mesh.degree, place)[0]
    if first_order:
        columns = columns[:, :corners]
        values = vtk_shapes(mesh.cell, 1, place)[0]
    rows = np.broadcast_to(np.arange(len(at))[:, None], columns.shape)
    shape = (len(at), len(mesh.points))
    return sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def gradients(mesh: BodyNodes, field: Array, at: Array) -> Array:
    """du_i / dx_j of a field (nodes, d) on a mesh at points (n, 3), (n, d, d)."""
    cells, place = _places(mesh, at)
    slopes = vtk_shapes(mesh.cell, mesh.degree, place)[1]
    jacobian = slopes @ mesh.points[cells][..., : mesh.dimension]
    return np.swapaxes(np.linalg.solve(jacobian, slopes @ field[cells]), 1, 2)


def _places(mesh: BodyNodes, at: Array) -> tuple[Ints, Array]:
    """Nodes (n, nodes of a cell) of the cells with points (n, 3), and places in them, (n, d)."""
    d, corners = mesh.dimension, VERTICES[mesh.cell]
    vertices, local = np.unique(mesh.cells[:, :corners], return_inverse=True)
    local = local.reshape(-1, corners)
    order = np.argsort(vtk_order(mesh.cell, 1))
    grid = dolfinx_compat.create_mesh(
        local[:, order].astype(np.int64), mesh.points[vertices][:, :d].copy(), mesh.cell
    )
    cells = mesh.cells[dolfinx_compat.original_cells(grid)[dolfinx_compat.cells_at(grid, at)]]
    return cells, vtk_places(mesh.cell, mesh.degree, mesh.points[cells][..., :d], at[:, :d])


def _corners(dimension: int, nodes: int) -> int:
    """Number of vertices of a facet with a number of nodes."""
    return 2 if dimension == 2 else 3 if nodes in (3, 6) else 4


def _shares(dimension: int, nodes: int) -> tuple[int, ...]:
    return SHARES[3, 3] if (dimension, nodes) == (3, 3) else SHARES[nodes]


def _sizes(x: Array, dimension: int) -> Array:
    """Lengths or areas of facets between vertices (facets, vertices, 3), dolfinx's order."""
    if dimension == 2:
        return np.asarray(np.linalg.norm(x[:, 1] - x[:, 0], axis=1))
    first, second = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    size = 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
    if x.shape[1] == 4:
        first, second = x[:, 1] - x[:, 3], x[:, 2] - x[:, 3]
        size += 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
    return np.asarray(size)
