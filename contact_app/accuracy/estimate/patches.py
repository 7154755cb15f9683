"""The cells of a reference, and sums over the cells around a vertex, for stress recovery.

Displacements are of degree 1 or 2. Stresses of the first are taken at the centre of each cell, of
the second at the points of a rule of degree 2, where they converge faster than elsewhere; around
a vertex they are fitted by polynomials of the degree of the displacement, whose monomials are
1, x_i, x_i x_j (i ≤ j) with x measured from the vertex.
"""

import math
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.model.assembly import Element
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints
from meshes.quadratic import VERTICES, node_vertices
from meshes.subdomains import vtk_order

BATCH = 25_000
"""Cells times points worked on at once. Four times as many take as long, and on 92,000 tetrahedra
160 MB more."""

SUPERCONVERGENT = ("quadrilateral", "hexahedron")
"""Cells whose samples are more accurate than the values between them."""

FACETS = {
    "triangle": "interval", "quadrilateral": "interval",
    "tetrahedron": "triangle", "hexahedron": "quadrilateral",
}  # fmt: skip
"""Cell type of the facets of a cell."""


def monomial_count(dimension: int, degree: int) -> int:
    """Monomials up to a degree."""
    return math.comb(dimension + degree, degree)


def monomials(x: Array, degree: int) -> list[Array]:
    """1, x_i and for degree 2 x_i x_j at points (n, dimension), one (n,) array each."""
    result = [np.ones(len(x)), *x.T]
    if degree == 2:
        result += [x[:, i] * x[:, j] for i, j in _pairs(x.shape[1])]
    return result


def translations(shift: Array, size: int, rows: int | None = None) -> Array:
    """Matrices from coefficients about a point to those about the point plus a shift.

    Parameters
    ----------
    shift : (n, dimension)
    size
        Monomials.
    rows
        Number of first coefficients about the other point; all unless given.

    Returns
    -------
    (n, rows, size)
    """
    d, rows = shift.shape[1], rows or size
    T = np.broadcast_to(np.eye(rows, size), (len(shift), rows, size)).copy()
    T[:, 0, 1 : 1 + d] = shift
    for column, (i, j) in enumerate(_pairs(d)[: size - 1 - d], 1 + d):
        T[:, 0, column] = shift[:, i] * shift[:, j]
        for one, other in ((i, j), (j, i)):
            if 1 + one < rows:
                T[:, 1 + one, column] += shift[:, other]
    return T


def _inverse(J: Array) -> tuple[Array, Array]:
    """Inverses and determinants of matrices (…, 2, 2) or (…, 3, 3), by cofactors."""
    if J.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(J, (-2, -1), (0, 1))
        determinant = a * d - b * c
        adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2)
    else:
        x, y, z = np.moveaxis(J, -2, 0)
        adjugate = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], -1)
        determinant = np.einsum("...i,...i->...", x, adjugate[..., 0])
    return adjugate / determinant[..., None, None], determinant


def _pairs(dimension: int) -> list[tuple[int, int]]:
    return list(combinations_with_replacement(range(dimension), 2))


class Table(NamedTuple):
    """Quadrature points of a cell: weights (q,), and shapes of the displacement and geometry.

    `values` (q, nodes) and `slopes` (q, dimension, nodes) are the displacement's, `places`
    (q, geometry nodes) and `tangents` (q, dimension, geometry nodes) the geometry's.
    """

    weights: Array
    values: Array
    slopes: Array
    places: Array
    tangents: Array


class Cells:
    """Cells of a reference: who surrounds whom, and shape functions.

    Parameters
    ----------
    material
        Only the cells of this material surround vertices; all unless given.

    Attributes
    ----------
    degree
        Of the displacement.
    nodes : (cells, nodes per cell)
        Nodes of the displacement in dolfinx's order.
    corners : (cells, vertices a cell)
        Vertices of each cell, numbered among themselves.
    vertices : (vertices,)
        Their node numbers.
    points : (vertices, dimension)
    tags : (cells,)
        Number of each cell's material.
    shapes : list of (cells,)
        Rows of cells that are translates of one another; empty where nearly none is.
    """

    MOST_SHAPES = 32

    def __init__(self, element: Element, material: int | None = None) -> None:
        self.element, self._material = element, material
        reference = element.reference
        self.dimension = d = element.dimension
        self.cell, self.degree = reference.cell, reference.degree
        self.geometry = dolfinx_compat.cell_nodes(element.mesh)
        self.nodes = reference.cells[:, np.argsort(vtk_order(self.cell, self.degree))]
        self.vertices, corners = np.unique(
            self.geometry[:, : VERTICES[self.cell]], return_inverse=True
        )
        self.corners = corners.reshape(len(self.nodes), -1)
        self.places = reference.points[:, :d]
        self.points = self.places[self.vertices]
        self.tags = reference.tags
        self._tables: dict[int, Table] = {}
        count = len(self.nodes)
        offsets = self.places[self.geometry[:, 1:]] - self.places[self.geometry[:, :1]]
        offsets = np.rint(offsets.reshape(count, -1) / (1e-9 * np.abs(offsets).max()))
        offsets = np.column_stack([offsets, self.tags])
        if not np.any(offsets != offsets[0]):
            self.shapes = [np.arange(count)]
        elif len(np.unique(offsets[:: count // 1000 + 1], axis=0)) > self.MOST_SHAPES:
            self.shapes = []  # shown by some of the cells
        else:
            _, shape = np.unique(offsets, axis=0, return_inverse=True)
            shape = shape.reshape(-1)
            many = shape.max() >= self.MOST_SHAPES
            self.shapes = (
                [] if many else [np.flatnonzero(shape == s) for s in range(shape.max() + 1)]
            )

    def table(self, rule: int) -> Table:
        """Shape functions at the points of a rule of a degree."""
        if rule not in self._tables:
            points, weights = dolfinx_compat.quadrature(self.cell, rule)
            order = 1 if self.geometry.shape[1] == VERTICES[self.cell] else 2
            shapes = (
                (dolfinx_compat.lagrange_values(self.cell, p, points),
                 dolfinx_compat.lagrange_slopes(self.cell, p, points))
                for p in (self.degree, order)
            )  # fmt: skip
            (values, slopes), (places, tangents) = shapes
            self._tables[rule] = Table(weights, values, slopes, places, tangents)
        return self._tables[rule]

    @property
    def samples(self) -> Table:
        """Sampling points of stresses."""
        return self.table(self.degree)

    def sampled(self, rule: int) -> Array | None:
        """Fields at the points of a rule from values at the samples; None for simplices.

        Fields of one degree less than the displacement are those that samples determine.

        Returns
        -------
        (q, functions)
            An orthonormal basis of them, in values times roots of weights: the projection onto it
            is, of fields of the displacement's degree, what interpolates them between samples.
        """
        if self.cell not in SUPERCONVERGENT:
            return None
        points, weights = dolfinx_compat.quadrature(self.cell, rule)
        values = np.ones((len(points), 1))
        if self.degree == 2:
            values = dolfinx_compat.lagrange_values(self.cell, 1, points)
        return np.linalg.qr(np.sqrt(weights)[:, None] * values)[0]

    @cached_property
    def around(self) -> sparse.csr_matrix:
        """1 where a vertex is one of a cell, (vertices, cells)."""
        count, vertices = self.corners.shape
        counted = np.arange(count)
        if self._material is not None:
            counted = np.flatnonzero(self.tags == self._material)
        entries = (self.corners[counted].ravel(), np.repeat(counted, vertices))
        return sparse.csr_matrix(
            (np.ones(len(entries[0])), entries), shape=(len(self.points), count)
        )

    @cached_property
    def neighbour_pairs(self) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
        """Vertices that share cells, themselves among them, and how many cells each pair shares."""
        graph = (self.around @ self.around.T).tocoo()
        return graph.row, graph.col, graph.data

    @cached_property
    def _sample_moments(self) -> tuple[sparse.csr_matrix, list[Array]]:
        """Incidence of samples (cell by cell) and vertices, and monomials at each entry."""
        q = len(self.samples.weights)
        pattern = sparse.csr_matrix(sparse.kron(self.around, np.ones((1, q))))
        pattern.sort_indices()
        corners = self.places[self.geometry]
        at = np.einsum("qg,cgi->cqi", self.samples.places, corners).reshape(-1, self.dimension)
        vertex = np.repeat(np.arange(len(self.points)), np.diff(pattern.indptr))
        return pattern, monomials(at[pattern.indices] - self.points[vertex], self.degree)

    @cached_property
    def first_moments(self) -> list[sparse.csr_matrix]:
        """Sums of samples times each monomial around vertices, (vertices, samples) each."""
        pattern, values = self._sample_moments
        return [
            sparse.csr_matrix((v, pattern.indices, pattern.indptr), shape=pattern.shape)
            for v in values
        ]

    def moment(self, monomial: int, values: Array) -> Array:
        """A first moment of values at samples (samples, members, k), (vertices, members, k)."""
        sums = self.first_moments[monomial] @ values.reshape(len(values), -1)
        return np.asarray(sums).reshape(-1, *values.shape[1:])

    def second_moments(self, size: int) -> Array:
        """Σ m mᵀ of the monomials m over the samples around vertices, (vertices, upper triangle).

        Zero beyond the monomials of this degree.
        """
        pattern, values = self._sample_moments
        rows, columns = np.triu_indices(size)
        sums = np.zeros((len(self.points), len(rows)))
        some = np.flatnonzero(np.diff(pattern.indptr))
        starts = pattern.indptr[some]
        for k, (i, j) in enumerate(zip(rows, columns, strict=True)):
            if j < len(values) and len(some):
                sums[some, k] = np.add.reduceat(values[i] * values[j], starts)
        return sums

    @cached_property
    def _to_nodes(self) -> list[sparse.csr_matrix]:
        """Mean of each monomial over the vertices around a node, (nodes, vertices)."""
        order = list(vtk_order(self.cell, 2))
        inverse = np.argsort(order)
        amid = [node_vertices(self.cell)[i] for i in inverse]  # by node in dolfinx's order
        vtk = self.element.reference.cells
        place = np.zeros(len(self.places), np.int64)
        place[self.vertices] = np.arange(len(self.vertices))
        done, nodes, sources, share = np.zeros(len(self.places), bool), [], [], []
        for column, on in enumerate(amid):
            first, rows = np.unique(self.nodes[:, column], return_index=True)
            rows = rows[~done[first]]
            first = first[~done[first]]
            done[first] = True
            for vertex in on:
                nodes.append(first)
                sources.append(place[vtk[rows, vertex]])
                share.append(np.full(len(first), 1.0 / len(on)))
        node, source = np.concatenate(nodes), np.concatenate(sources)
        weight = np.concatenate(share)
        offsets = self.places[node] - self.points[source]
        shape = (len(self.places), len(self.points))
        return [
            sparse.csr_matrix((weight * m, (node, source)), shape=shape)
            for m in monomials(offsets, self.degree)
        ]

    def at_nodes(self, coefficients: Array) -> Array:
        """Values at nodes of the polynomials at vertices; amid vertices the mean of two.

        Parameters
        ----------
        coefficients : (vertices, members, monomials, k)

        Returns
        -------
        (nodes, members, k)
        """
        if self.degree == 1:
            return coefficients[:, :, 0]
        _, members, _, k = coefficients.shape
        result = np.zeros((len(self.places), members * k))
        for a, operator in enumerate(self._to_nodes):
            result += operator @ coefficients[:, :, a].reshape(len(self.points), -1)
        return result.reshape(-1, members, k)

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the reference's facets at their nodes.

        Returns
        -------
        (facets, nodes of a facet, dimension)
        """
        mesh, d, reference = self.element.mesh, self.dimension, self.element.reference
        mesh.topology.create_connectivity(d - 1, d)
        links, offsets = dolfinx_compat.adjacency(mesh.topology.connectivity(d - 1, d))
        cell = links[offsets[reference.facet_entities]]
        name = FACETS[self.cell]
        points = dolfinx_compat.lagrange_nodes(name, self.degree)[0]
        slopes = dolfinx_compat.lagrange_slopes(name, 2 if reference.curved else 1, points)
        x = self.places[reference.facets]
        along = np.einsum("vrk,fki->fvri", slopes, x[:, : slopes.shape[2]])
        if d == 2:
            normal = np.stack([along[:, :, 0, 1], -along[:, :, 0, 0]], axis=-1)
        else:
            normal = np.cross(along[:, :, 0], along[:, :, 1])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        inward = self.points[self.corners[cell]].mean(axis=1) - x.mean(axis=1)
        return normal * -np.sign(np.einsum("fvi,fi->fv", normal, inward))[..., None]

    @property
    def straight_simplices(self) -> bool:
        """Whether the cells have one Jacobian each; at degree 1 also one gradient."""
        return self.geometry.shape[1] == self.dimension + 1

    def gradients(self, rows: Ints, table: Table) -> tuple[Array, Array]:
        """Shape function gradients and Jacobian determinants at points of cells.

        Returns
        -------
        (cells, points, dimension, nodes) and (cells, points).
        """
        corners = self.places[self.geometry[rows]][:, None]
        tangents = table.tangents[:1] if self.straight_simplices else table.tangents
        inverse, volume = _inverse(tangents @ corners)
        gradients = inverse @ table.slopes
        return gradients, np.broadcast_to(np.abs(volume), gradients.shape[:2])

    def mean_gradients(self, rows: Ints) -> Array:
        """Means over cells of the shape function gradients, (cells, 1, dimension, nodes)."""
        order = np.argsort(vtk_order(self.cell, self.degree))
        return np.swapaxes(self.element.mean_slopes[rows][:, order], 1, 2)[:, None]

    def mean_values(self, rows: Ints) -> Array:
        """Means over cells of the shape functions, (cells, nodes)."""
        order = np.argsort(vtk_order(self.cell, self.degree))
        return self.element.mean_values[rows][:, order]

    def batches(self, members: int, points: int) -> list[tuple[Ints, Ints, slice]]:
        """Cells of one material to work on at once: (rows, rows that give shapes, members).

        Parameters
        ----------
        points
            Quadrature points of a cell.
        """
        result = []
        most = max(1, BATCH // points)
        groups = [(rows, rows[:1]) for rows in self.shapes]
        if not groups:
            for tag in np.unique(self.tags):
                rows = np.flatnonzero(self.tags == tag)
                parts = [rows[i : i + most] for i in range(0, len(rows), most)]
                groups += [(part, part) for part in parts]
        for rows, shape in groups:
            step = max(1, most // len(rows))
            result += [(rows, shape, slice(m, m + step)) for m in range(0, members, step)]
        return result
