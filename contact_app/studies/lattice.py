"""Fields of different meshes of one box, brought to one lattice of points and compared there.

The nodes of a box of n cells along an axis, of degree p, are a lattice of p n + 1 points. A finite
element function is evaluated exactly on the points of a finer lattice: cell by cell in tensor
products for quadrilaterals and hexahedra, and on the six (two) simplices of each cube (square)
around the diagonal from its lowest to its highest corner, into which dolfinx splits it, for
tetrahedra and triangles: with the local coordinates sorted, a₁ ≥ a₂ ≥ a₃, a point has the
barycentric coordinates 1 - a₁, a₁ - a₂, a₂ - a₃, a₃ along the path of corners in that order.

The energy norm of a difference is that of its interpolant by first-order cells on the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.assembly import Element
from contact_app.scene import Material
from meshes.subdomains import Reference

Array = NDArray[np.float64]
TENSOR = ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class Mesh:
    """What says how a field on a box is evaluated: cell, degree and cells along each axis."""

    cell: str
    degree: int
    cells: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Nodes along each axis."""
        return tuple(self.degree * n + 1 for n in self.cells)


@dataclass(frozen=True)
class Lattice:
    """The points at which fields of a body are compared, with `cells` intervals along each axis."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]

    def evaluate(self, mesh: Mesh, points: Array, values: Array) -> Array:
        """Evaluate a field (nodes,) or (nodes, k), given at nodes (nodes, 3), on the lattice.

        Returns
        -------
        (lattice points, k), the last axis fastest.

        Raises
        ------
        ValueError
            The nodes are not those of the mesh.
        """
        d = len(self.cells)
        extent = np.subtract(self.upper, self.lower)
        nodes = np.array(mesh.shape) - 1
        place = (points[:, :d] - self.lower) / extent * nodes
        index = np.rint(place).astype(np.int64)
        flat = np.ravel_multi_index(tuple(index.T), mesh.shape, mode="clip")
        if (
            len(flat) != np.prod(mesh.shape)
            or np.abs(place - index).max() > 1e-6
            or len(np.unique(flat)) != len(flat)
        ):
            raise ValueError(f"{len(flat)} nodes are not those of a box of {mesh}")
        values = values.reshape(len(flat), -1)
        ordered = np.empty_like(values)
        ordered[flat] = values
        if mesh.cell not in TENSOR:
            return _simplices(mesh, self.cells) @ ordered
        field = ordered.reshape(*mesh.shape, -1)
        for axis, (n, fine) in enumerate(zip(mesh.cells, self.cells, strict=True)):
            along = _line(n, mesh.degree, fine) @ np.moveaxis(field, axis, 0).reshape(
                field.shape[axis], -1
            )
            rest = np.delete(field.shape, axis)
            field = np.moveaxis(along.reshape(fine + 1, *rest), 0, axis)
        return np.ascontiguousarray(field).reshape(-1, values.shape[1])

    @cached_property
    def weights(self) -> Array:
        """Volume that falls to each point, (lattice points,)."""
        lines = []
        for a, b, n in zip(self.lower, self.upper, self.cells, strict=True):
            line = np.full(n + 1, (b - a) / n)
            line[[0, -1]] *= 0.5
            lines.append(line)
        result = lines[0]
        for line in lines[1:]:
            result = np.multiply.outer(result, line)
        return result.ravel()

    def energy(self, field: Array, material: Material, plane: str | None) -> float:
        """a(e, e) of a field (lattice points, dimension)."""
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


@lru_cache(maxsize=64)
def _line(cells: int, degree: int, fine: int) -> sparse.csr_matrix:
    """Evaluation of a function on a line of cells at `fine` + 1 points."""
    point = np.arange(fine + 1)
    cell = np.minimum(point * cells // fine, cells - 1)
    s = (point * cells - cell * fine) / fine
    if degree == 1:
        weights = np.stack([1.0 - s, s])
    else:
        weights = np.stack([(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)])
    columns = degree * cell + np.arange(degree + 1)[:, None]
    rows = np.broadcast_to(point, columns.shape)
    size = (fine + 1, degree * cells + 1)
    return sparse.csr_matrix((weights.ravel(), (rows.ravel(), columns.ravel())), shape=size)


@lru_cache(maxsize=16)
def _simplices(mesh: Mesh, fine: tuple[int, ...]) -> sparse.csr_matrix:
    """Evaluation of a function on the simplices of a box, (lattice points, nodes)."""
    d = len(fine)
    point = np.stack(np.meshgrid(*(np.arange(n + 1) for n in fine), indexing="ij"), axis=-1)
    point = point.reshape(-1, d)
    cells = np.array(mesh.cells)
    cell = np.minimum(point * cells // fine, cells - 1)
    local = (point * cells - cell * fine) / fine
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
