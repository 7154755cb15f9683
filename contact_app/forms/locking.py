"""Quadrilaterals and hexahedra of degree 1 that lock in bending: their strains vary within cells.

Scenes test the share of the strain energy (`contact_app.run.model_warnings`). A form does not give
its moduli, so here it is the share of the squared strain,

    1 - Σ |T| |ε̄|² / ∫ |ε|²    with the means ε̄ over each cell T.

In bending of cells n of which lie across the thickness both are 1/n² for cells of equal sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contact_app.forms.parts import Parts
from meshes import dolfinx_compat

Array = NDArray[np.float64]

AT_ONCE = 20_000
"""Cells whose gradients are computed together, which limits the memory to some 30 MB."""

RULE = 2
"""Degree of the quadrature: squares of strains are quadratic along each axis."""


def varying_strains(parts: Parts, u: Array, body: NDArray[np.int64], count: int) -> Array:
    """Share of the squared strain of each body that varies within cells, (count,) (collective).

    Zero for other cells than quadrilaterals and hexahedra of degree 1, and without strains.

    Parameters
    ----------
    u : (copies, dimension)
        Displacements.
    body : (cells,)
        Body of each cell.
    """
    cell = parts.space.mesh.topology.cell_name()
    sums = np.zeros((2, count))
    of_degree_1 = dolfinx_compat.lagrange_degree(parts.space) == 1
    if cell in ("quadrilateral", "hexahedron") and of_degree_1:
        points, weights = dolfinx_compat.quadrature(cell, RULE)
        slopes = dolfinx_compat.lagrange_slopes(cell, 1, points)
        for start in range(0, len(parts.cells), AT_ONCE):
            nodes = parts.cells[start : start + AT_ONCE]
            strain, volume = _strains(parts.points[nodes][..., : u.shape[1]], u[nodes], slopes)
            mean = np.einsum("q,cqij->cij", weights / weights.sum(), strain)
            squares = np.einsum("q,cqij,cqij->c", weights / weights.sum(), strain, strain)
            for row, values in zip(
                sums, (squares, np.einsum("cij,cij->c", mean, mean)), strict=True
            ):
                row += np.bincount(body[start : start + AT_ONCE], volume * values, count)
    squares, constant = parts.comm.allreduce(sums)
    some = squares > 0.0
    return np.where(some, 1.0 - constant / np.where(some, squares, 1.0), 0.0)


def _strains(x: Array, u: Array, slopes: Array) -> tuple[Array, Array]:
    """Strains (cells, points, d, d) and sizes of cells, with the Jacobian of their middles.

    Parameters
    ----------
    x, u : (cells, nodes, d)
    slopes : (points, d, nodes)
        Derivatives of the shape functions on the reference cell.
    """
    d, count = u.shape[2], len(slopes)
    middle = slopes.mean(axis=0).T
    jacobian = np.swapaxes(x, 1, 2) @ middle  # ∂x_i/∂ξ_j
    slope = np.swapaxes(u, 1, 2) @ slopes.reshape(count * d, -1).T
    gradient = slope.reshape(len(u), d * count, d) @ np.linalg.inv(jacobian)
    gradient = np.swapaxes(gradient.reshape(len(u), d, count, d), 1, 2)
    return 0.5 * (gradient + np.swapaxes(gradient, 2, 3)), np.abs(np.linalg.det(jacobian))
