"""Displacements on grids of lines, and the distance in energy norm of two on different grids.

The meshes of a box are products of grid lines, of equal or graded cells of degree 1 or 2;
triangles and tetrahedra cut each cell of the grid along the diagonals that ascend along all axes.
Two such fields are both polynomials on the cells that the lines of both make together (up to the
diagonals), so that a Gauss rule on these cells integrates the energy of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.scene.material import Material

Array = NDArray[np.float64]

BATCH = 200_000
"""Points at which gradients are evaluated at once."""

COORDINATE = 1e-9
"""Distance over the size of the body below which two coordinates are the same."""


@dataclass(frozen=True, eq=False)
class GridField:
    """A displacement on the product of grid lines.

    Attributes
    ----------
    lines
        Coordinates along each axis.
    degree
    simplices
        Whether cells of the grid are cut into triangles or tetrahedra.
    values : (nodes along x, ..., dimension)
        At vertices, for degree 2 also at the middles of edges and cells.
    """

    lines: tuple[Array, ...]
    degree: int
    simplices: bool
    values: Array

    @classmethod
    def of(cls, solved: SolvedScene) -> GridField:
        """The answer of a scene of one box (one rank)."""
        found = solved.displacement_at_nodes()
        assert found is not None
        points, displacement = found
        (body,) = solved.model.scene.bodies
        d = displacement.shape[1]
        size = np.ptp(points, axis=0).max()
        lines, places = [], []
        for x in points.T[:d]:
            line = _distinct(x, COORDINATE * size)
            lines.append(line)
            places.append(np.searchsorted(line, x + 0.5 * COORDINATE * size) - 1)
        values = np.zeros((*(len(line) for line in lines), d))
        values[tuple(places)] = displacement
        simplices = body.mesh.cell in ("triangle", "tetrahedron")
        return cls(tuple(x[:: body.degree] for x in lines), body.degree, simplices, values)

    def gradients(self, points: Array) -> Array:
        """du_i / dx_j at points (n, d): (n, d, d)."""
        d = len(self.lines)
        cell = np.empty((len(points), d), np.int64)
        place, width = np.empty_like(points), np.empty_like(points)
        for a, line in enumerate(self.lines):
            cell[:, a] = np.clip(np.searchsorted(line, points[:, a]) - 1, 0, len(line) - 2)
            width[:, a] = np.diff(line)[cell[:, a]]
            place[:, a] = (points[:, a] - line[cell[:, a]]) / width[:, a]
        shapes = _simplex_shapes if self.simplices else _product_shapes
        result = np.zeros((len(points), d, d))
        for offset, slope in shapes(place, self.degree):
            nodal = self.values[tuple((self.degree * cell + offset).T)]
            result += nodal[:, :, None] * (slope / width)[:, None, :]
        return result


def _distinct(x: Array, apart: float) -> Array:
    """Coordinates in ascending order, one of those that lie closer together than `apart`."""
    line = np.unique(x)
    return line[np.concatenate([[True], np.diff(line) > apart])]


def _product_shapes(place: Array, degree: int) -> list[tuple[Array, Array]]:
    """Nodes of quadrilaterals and hexahedra and the slopes of their shape functions."""
    x = place
    if degree == 1:
        values, slopes = [1.0 - x, x], [np.full_like(x, -1.0), np.ones_like(x)]
    else:
        values = [(1.0 - x) * (1.0 - 2.0 * x), 4.0 * x * (1.0 - x), x * (2.0 * x - 1.0)]
        slopes = [4.0 * x - 3.0, 4.0 - 8.0 * x, 4.0 * x - 1.0]
    result, d = [], x.shape[1]
    for node in product(range(degree + 1), repeat=d):
        slope = np.ones_like(x)
        for axis in range(d):
            for a in range(d):
                slope[:, axis] *= (slopes if a == axis else values)[node[a]][:, a]
        result.append((np.array(node), slope))
    return result


def _simplex_shapes(place: Array, degree: int) -> list[tuple[Array, Array]]:
    """Values from the triangles or tetrahedra that contain the points.

    A point lies in the simplex from the lower corner along the axes in descending order of its
    coordinates: with those sorted, 1 - x_1, x_1 - x_2, ..., x_d are its barycentric coordinates.
    """
    n, d = place.shape
    order = np.argsort(-place, axis=1)
    ordered = np.take_along_axis(place, order, axis=1)
    bounds = np.concatenate([np.ones((n, 1)), ordered, np.zeros((n, 1))], axis=1)
    weight = bounds[:, :-1] - bounds[:, 1:]
    vertex = np.zeros((d + 1, n, d), np.int64)
    slope = np.zeros((d + 1, n, d))
    rows = np.arange(n)
    for k in range(d):
        vertex[k + 1] = vertex[k]
        vertex[k + 1, rows, order[:, k]] = 1
        slope[k, rows, order[:, k]] -= 1.0
        slope[k + 1, rows, order[:, k]] += 1.0
    if degree == 1:
        return [(vertex[k], slope[k]) for k in range(d + 1)]
    result = [(2 * vertex[k], (4.0 * weight[:, k, None] - 1.0) * slope[k]) for k in range(d + 1)]
    for k in range(d + 1):
        for m in range(k):
            along = weight[:, k, None] * slope[m] + weight[:, m, None] * slope[k]
            result.append((vertex[k] + vertex[m], 4.0 * along))
    return result


def energy_density(gradient: Array, material: Material, plane_stress: bool) -> Array:
    """ε : C : ε of displacement gradients (n, d, d)."""
    young, poisson = material.young, material.poisson
    shear = young / (2.0 * (1.0 + poisson))
    volume = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    if plane_stress:
        volume = 2.0 * shear * volume / (volume + 2.0 * shear)
    strain = 0.5 * (gradient + gradient.swapaxes(1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)
    return np.asarray(2.0 * shear * np.einsum("nij,nij->n", strain, strain) + volume * trace**2)


def square_distance(
    one: GridField, other: GridField, material: Material, plane_stress: bool, points: int = 3
) -> float:
    """a(v, v) of the difference of two fields on one box.

    Parameters
    ----------
    points
        Gauss points along each axis of a cell.
    """
    place, weight = np.polynomial.legendre.leggauss(points)
    axes = []
    for a, b in zip(one.lines, other.lines, strict=True):
        line = _distinct(np.concatenate([a, b]), COORDINATE * float(np.ptp(a)))
        half = 0.5 * np.diff(line)
        middle = line[:-1] + half
        axes.append(
            ((middle[:, None] + half[:, None] * place).ravel(), (half[:, None] * weight).ravel())
        )
    x = np.stack(np.meshgrid(*(a for a, _ in axes), indexing="ij"), -1).reshape(-1, len(axes))
    w = np.ones(())
    for _, along in axes:
        w = np.multiply.outer(w, along)
    w, total = w.ravel(), 0.0
    for start in range(0, len(x), BATCH):
        part = slice(start, start + BATCH)
        difference = one.gradients(x[part]) - other.gradients(x[part])
        total += float(energy_density(difference, material, plane_stress) @ w[part])
    return total
