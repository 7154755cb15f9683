"""Fields of different meshes of one box, brought to one grid of points and compared there.

The nodes of a box of n cells along an axis, of degree p, equal or graded, are a grid of p n + 1
lines. A finite element function is evaluated exactly on the points of a grid: cell by cell in
tensor products for quadrilaterals and hexahedra, and on the six (two) simplices of each cube
(square) around the diagonal from its lowest to its highest corner, into which dolfinx splits it,
for tetrahedra and triangles: with the local coordinates sorted, a₁ ≥ a₂ ≥ a₃, a point has the
barycentric coordinates 1 - a₁, a₁ - a₂, a₂ - a₃, a₃ along the path of corners in that order.

The energy norm of a difference is that of its interpolant by first-order cells on the grid:
what a graded mesh has between two of its points is not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.model.assembly import Element
from contact_app.scene.material import Material
from contact_app.studies.fields_on_meshes import BodyNodes
from meshes.subdomains import Reference

Array = NDArray[np.float64]
TENSOR = ("quadrilateral", "hexahedron")
NEAR = 1e-9
"""Of the length of a box: nodes that are nearer are on one line."""


@dataclass(frozen=True)
class Mesh:
    """What says how a field on a box is evaluated: cell, degree and cells along each axis.

    `graded` has their ends along each axis, from 0 to 1; None: they are equal.
    """

    cell: str
    degree: int
    cells: tuple[int, ...]
    graded: tuple[tuple[float, ...], ...] | None = None

    @classmethod
    def through(cls, cell: str, degree: int, places: Array) -> Mesh:
        """The mesh of nodes at places (nodes, axes) from 0 to 1."""
        lines = []
        for along in places.T:
            ends = np.unique(along)
            ends = ends[np.append(True, np.diff(ends) > NEAR)][::degree]
            lines.append(tuple(float(x) for x in ends))
        return cls(cell, degree, tuple(len(x) - 1 for x in lines), tuple(lines))

    @property
    def lines(self) -> list[Array]:
        """Ends of cells along each axis, from 0 to 1."""
        if self.graded is None:
            return [np.linspace(0.0, 1.0, n + 1) for n in self.cells]
        return [np.array(x) for x in self.graded]

    @property
    def grids(self) -> list[Array]:
        """Nodes along each axis, from 0 to 1."""
        result = []
        for x in self.lines:
            parts = np.arange(self.degree) / self.degree
            inner = (x[:-1, None] + parts * np.diff(x)[:, None]).ravel()
            result.append(np.append(inner, x[-1]))
        return result

    @property
    def first_order(self) -> Mesh:
        """The mesh of degree 1 through the same nodes."""
        if self.degree == 1:
            return self
        lines = tuple(tuple(float(x) for x in grid) for grid in self.grids)
        return Mesh(self.cell, 1, tuple(len(x) - 1 for x in lines), lines)

    @property
    def shape(self) -> tuple[int, ...]:
        """Nodes along each axis."""
        return tuple(self.degree * n + 1 for n in self.cells)


@dataclass(frozen=True)
class PointsOfBox:
    """The points at which fields of a body are compared, with `cells` intervals along each axis."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]

    def evaluate(self, mesh: Mesh, points: Array, values: Array) -> Array:
        """Evaluate a field (nodes,) or (nodes, k), given at nodes (nodes, 3), on the grid.

        Returns
        -------
        (grid points, k), the last axis fastest.

        Raises
        ------
        ValueError
            The nodes are not those of the mesh.
        """
        d = len(self.cells)
        index, away = np.empty((d, len(points)), np.int64), 0.0
        for axis, (x, grid) in enumerate(zip(self.places(points).T, mesh.grids, strict=True)):
            index[axis] = np.searchsorted(0.5 * (grid[1:] + grid[:-1]), x)
            away = max(away, float(np.abs(x - grid[index[axis]]).max()))
        flat = np.ravel_multi_index(tuple(index), mesh.shape)
        if (
            len(flat) != np.prod(mesh.shape)
            or away > 1e3 * NEAR
            or len(np.unique(flat)) != len(flat)
        ):
            raise ValueError(f"{len(flat)} nodes are not those of a box of {mesh}")
        values = values.reshape(len(flat), -1)
        ordered = np.empty_like(values)
        ordered[flat] = values
        if mesh.cell not in TENSOR:
            return _simplices(mesh, self.cells) @ ordered
        field = ordered.reshape(*mesh.shape, -1)
        for axis, fine in enumerate(self.cells):
            along = _line(mesh, axis, fine) @ np.moveaxis(field, axis, 0).reshape(
                field.shape[axis], -1
            )
            rest = np.delete(field.shape, axis)
            field = np.moveaxis(along.reshape(fine + 1, *rest), 0, axis)
        return np.ascontiguousarray(field).reshape(-1, values.shape[1])

    def places(self, points: Array) -> Array:
        """Where points (n, 3) are along each axis, from 0 to 1."""
        extent = np.subtract(self.upper, self.lower)
        return np.asarray((points[:, : len(self.cells)] - self.lower) / extent)

    @cached_property
    def weights(self) -> Array:
        """Volume that falls to each point, (grid points,)."""
        lines = []
        for a, b, n in zip(self.lower, self.upper, self.cells, strict=True):
            line = np.full(n + 1, (b - a) / n)
            line[[0, -1]] *= 0.5
            lines.append(line)
        result = lines[0]
        for line in lines[1:]:
            result = np.multiply.outer(result, line)
        return result.ravel()

    def sample(self, body: BodyNodes, values: Array, first_order: bool = False) -> Array:
        """Evaluate a field (nodes, k) of a body, or its first-order interpolant, on the grid."""
        mesh = Mesh.through(body.cell, body.degree, self.places(body.points))
        return self.evaluate(mesh.first_order if first_order else mesh, body.points, values)

    def volume(self, field: Array) -> float:
        """∫ |e|² of a field (grid points, dimension)."""
        return float(self.weights @ (field**2).sum(axis=1))

    def energy(self, field: Array, materials: Sequence[Material], plane: str | None) -> float:
        """a(e, e) of a field (grid points, dimension)."""
        material = materials[0]
        d = len(self.cells)
        steps = np.subtract(self.upper, self.lower) / self.cells
        stiffness, corners = _cell_stiffness(tuple(steps), material, plane)
        shape = tuple(n + 1 for n in self.cells)
        values = field.reshape(*shape, d)
        total = 0.0
        for layer in range(self.cells[0]):  # one layer of cells at a time keeps memory small
            parts = []
            for corner in corners:
                part = values[layer + corner[0]]
                for axis, c in enumerate(corner[1:]):
                    part = np.take(part, np.arange(self.cells[axis + 1]) + c, axis=axis)
                parts.append(part.reshape(-1, d))
            gathered = np.concatenate(parts, axis=1)
            total += float(np.einsum("ci,ci->", gathered @ stiffness, gathered))
        return total


def _located(lines: Array, fine: int) -> tuple[NDArray[np.int64], Array]:
    """The cell of each of `fine` + 1 points of a line, and where in it they are, from 0 to 1."""
    point = np.arange(fine + 1) / fine
    cell = np.clip(np.searchsorted(lines, point, side="right") - 1, 0, len(lines) - 2)
    return cell, (point - lines[cell]) / (lines[cell + 1] - lines[cell])


@lru_cache(maxsize=64)
def _line(mesh: Mesh, axis: int, fine: int) -> sparse.csr_matrix:
    """Evaluation of a function on the cells along an axis at `fine` + 1 points."""
    cells, degree = mesh.cells[axis], mesh.degree
    cell, s = _located(mesh.lines[axis], fine)
    if degree == 1:
        weights = np.stack([1.0 - s, s])
    else:
        weights = np.stack([(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)])
    columns = degree * cell + np.arange(degree + 1)[:, None]
    rows = np.broadcast_to(np.arange(fine + 1), columns.shape)
    size = (fine + 1, degree * cells + 1)
    return sparse.csr_matrix((weights.ravel(), (rows.ravel(), columns.ravel())), shape=size)


@lru_cache(maxsize=16)
def _simplices(mesh: Mesh, fine: tuple[int, ...]) -> sparse.csr_matrix:
    """Evaluation of a function on the simplices of a box, (grid points, nodes)."""
    d = len(fine)
    point = np.stack(np.meshgrid(*(np.arange(n + 1) for n in fine), indexing="ij"), axis=-1)
    point = point.reshape(-1, d)
    found = [_located(x, n) for x, n in zip(mesh.lines, fine, strict=True)]
    cell = np.stack([found[k][0][point[:, k]] for k in range(d)], axis=1)
    local = np.stack([found[k][1][point[:, k]] for k in range(d)], axis=1)
    order = np.argsort(-local, axis=1, kind="stable")
    sorted_ = np.take_along_axis(local, order, axis=1)
    ones, zeros = np.ones((len(point), 1)), np.zeros((len(point), 1))
    barycentric = -np.diff(np.concatenate([ones, sorted_, zeros], axis=1), axis=1)
    corners = np.repeat(cell[:, None, :], d + 1, axis=1)
    for k in range(1, d + 1):
        corners[:, k] = corners[:, k - 1]
        np.put_along_axis(
            corners[:, k],
            order[:, k - 1 : k],
            np.take_along_axis(corners[:, k], order[:, k - 1 : k], axis=1) + 1,
            axis=1,
        )
    weights, nodes = [], []
    for i in range(d + 1):
        b = barycentric[:, i]
        weights.append(b if mesh.degree == 1 else b * (2.0 * b - 1.0))
        nodes.append(mesh.degree * corners[:, i])
        for j in range(i if mesh.degree == 2 else 0):
            weights.append(4.0 * b * barycentric[:, j])
            nodes.append(corners[:, i] + corners[:, j])
    columns = np.ravel_multi_index(
        tuple(np.moveaxis(np.stack(nodes), -1, 0)), mesh.shape, mode="clip"
    )
    rows = np.broadcast_to(np.arange(len(point)), columns.shape)
    size = (len(point), int(np.prod(mesh.shape)))
    return sparse.csr_matrix((np.concatenate(weights), (rows.ravel(), columns.ravel())), shape=size)


@lru_cache(maxsize=16)
def _cell_stiffness(
    steps: tuple[float, ...], material: Material, plane: str | None
) -> tuple[Array, tuple[tuple[int, ...], ...]]:
    """Stiffness of one cell and the corner, 0 or 1 along each axis, of each of its nodes."""
    d = len(steps)
    name = TENSOR[d - 2]
    make = dmesh.create_box if d == 3 else dmesh.create_rectangle
    kind = dmesh.CellType.hexahedron if d == 3 else dmesh.CellType.quadrilateral
    mesh = make(MPI.COMM_SELF, [np.zeros(d), np.array(steps)], [1] * d, kind)
    element = Element(Reference.of(mesh, name), d)
    corners = np.rint(element.reference.points[:, :d] / np.array(steps)).astype(int)
    stiffness = element.stiffness((material,), plane).toarray()
    return stiffness, tuple(tuple(int(c) for c in corner) for corner in corners)
