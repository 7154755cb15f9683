"""Integrals over straight or curved facets of the mesh.

A facet is a line, a triangle or a quadrilateral of first or second order, its nodes in dolfinx's
order: vertices first, then the middles of edges and of the facet itself. Points of a facet are
interpolated between all of its nodes. The integrands are products of the linear shape functions ψ
of its vertices and the shape functions φ of its nodes.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from meshes import dolfinx_compat
from meshes.arrays import Array
from meshes.quadratic import FACETS

LATTICE, INSIDE = 12, 8
"""Intervals along an edge between sample points of a facet, and samples along it inside."""

RULE = 8
"""Degree of the quadrature; the square root in the area of curved facets is not a polynomial."""


@cache
def _tables(dimension: int, nodes: int) -> tuple[Array, Array]:
    """Derivatives of φ (q, d - 1, nodes), and weights times products ψ φ (q, vertices, nodes)."""
    name, _, order = FACETS[dimension, nodes]
    points, weights = dolfinx_compat.quadrature(name, RULE)
    hats, shapes = (dolfinx_compat.lagrange_values(name, p, points) for p in (1, order))
    products = weights[:, None, None] * hats[:, :, None] * shapes[:, None]
    return dolfinx_compat.lagrange_slopes(name, order, points), products


@cache
def shapes_on_lattice(dimension: int, nodes: int, inside: bool = False) -> Array:
    """Values of the shape functions at points all over a facet, (points, nodes).

    Parameters
    ----------
    inside
        Whether no point lies on an edge.
    """
    name, _, order = FACETS[dimension, nodes]
    axis = np.linspace(0.0, 1.0, LATTICE + 1)
    if inside:
        axis = (np.arange(INSIDE) + 0.5) / INSIDE
    points = np.stack(np.meshgrid(*[axis] * (dimension - 1), indexing="ij"), axis=-1)
    points = points.reshape(-1, dimension - 1)
    if name == "triangle":
        points = points[points.sum(axis=1) <= 1.0 + (-1e-9 if inside else 1e-9)]
    return dolfinx_compat.lagrange_values(name, order, points)


@cache
def hats_at_nodes(dimension: int, nodes: int) -> Array:
    """Values of the linear shape functions at the nodes of a facet, (vertices, nodes)."""
    name, _, order = FACETS[dimension, nodes]
    return dolfinx_compat.lagrange_values(name, 1, dolfinx_compat.lagrange_nodes(name, order)[0]).T


def moments(x: Array, dimension: int) -> Array:
    """∫ ψ_j φ_k ds over each facet, (facets, vertices, nodes).

    Parameters
    ----------
    x : (facets, nodes, 3)
        Coordinates of the nodes.
    """
    size = np.linalg.norm(_normals(x, dimension), axis=-1)
    return np.tensordot(size, _tables(dimension, x.shape[1])[1], axes=(0, 0))


def normal_moments(x: Array, behind: Array, dimension: int) -> Array:
    """∫ φ_k n ds with the outward normal n, (nodes, facets, dimension).

    Parameters
    ----------
    x : (facets, nodes, 3)
        Coordinates of the nodes.
    behind : (facets, 3)
        A point of the body behind each facet.
    """
    normals, weights = _normals(x, dimension), _tables(dimension, x.shape[1])[1].sum(axis=1)
    inward = np.einsum("fi,fi->f", normals.sum(axis=0), x.mean(axis=1) - behind) < 0.0
    normals[:, inward] *= -1.0
    return np.tensordot(weights, normals[..., :dimension], axes=(0, 0))


def _normals(x: Array, dimension: int) -> Array:
    """Normals at the points of the rule, as long as the area, (q, facets, 3)."""
    along = np.tensordot(_tables(dimension, x.shape[1])[0], x, axes=(2, 1))  # einsum is slow
    return np.cross(along[:, 0], along[:, 1] if dimension == 3 else [0.0, 0.0, 1.0])


MIDDLES: dict[int, tuple[tuple[int, ...], ...]] = {
    3: ((0, 1),),
    6: ((1, 2), (0, 2), (0, 1)),
    9: ((0, 1), (0, 2), (1, 3), (2, 3), (0, 1, 2, 3)),
}
"""Vertices around each further node of a facet, in dolfinx's order, by number of nodes."""


def between_vertices(facets: NDArray[np.integer], values: Array) -> None:
    """Interpolate values at the vertices of facets (facets, 3, 6 or 9) to the middles, in place."""
    middles = MIDDLES[facets.shape[1]]
    for place, amid in enumerate(middles, facets.shape[1] - len(middles)):
        values[facets[:, place]] = values[facets[:, list(amid)]].mean(axis=1)
