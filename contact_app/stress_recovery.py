"""A continuous stress fitted to the stresses of a finite-element answer.

At each node a linear polynomial is fitted to the stresses at the centres of the cells around it,
where those of first-order cells converge faster than elsewhere; its value at the node is the
recovered stress σ* (Zienkiewicz & Zhu, *The superconvergent patch recovery and a posteriori error
estimates*, IJNME 33, 1992). Where a node has too few cells for that, on the surface, the
polynomials of its neighbours are continued to it. On the surface σ* n is known as well: it is the
traction where one is given, zero where nothing is, and has no part along the surface where the
body touches without friction. The smallest change of σ* at the node that meets these (in the
least squares where they contradict each other, as at the edge of a load) is made.

Sums over cells are made subdomain by subdomain and meet at the owner of each node, so that σ*
depends neither on the decomposition nor on the number of ranks. Bodies share no nodes: stresses
are not averaged across them. Inside a body they are, also where its material changes: there the
true stress jumps, the recovered one does not, and the estimate that uses it is too large.

Stress and strain have the components xx, yy, xy in the plane and xx, yy, zz, xy, yz, xz in space;
shear strains are engineering ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.assembly import Element, lame
from contact_app.model import Model, boundary_facets
from contact_app.scene import Material
from meshes import Subdomain, versions
from solver.tfeti.exchange import NodeExchange

Array = NDArray[np.float64]

SHEARS = ((0, 1), (1, 2), (0, 2))

FLAT = 1e-4
"""Determinant of a patch's moments, scaled to a unit diagonal, above which they determine a linear
polynomial: 1 for a symmetric patch, 0 for one whose cell centres lie in a plane."""

SYMMETRIC = 1e-9
"""Scaled moments below it vanish: the cells around the node balance each other."""

WEAK = 1e-2
"""Directions of a fit below this share of the strongest are left out."""


def elasticity(material: Material, plane: str | None, dimension: int) -> Array:
    """D of σ = D ε, (components, components)."""
    lam, mu = lame(material, plane)
    size = dimension * (dimension + 1) // 2
    D = np.diag(np.where(np.arange(size) < dimension, 2.0 * mu, mu))
    D[:dimension, :dimension] += lam
    return D


def strain_of_gradient(dimension: int) -> Array:
    """V of ε = V vec(∂u_i/∂x_j), j fastest: (components, dimension²)."""
    shears = SHEARS[: 2 * dimension - 3]
    V = np.zeros((dimension + len(shears), dimension**2))
    for i in range(dimension):
        V[i, i * dimension + i] = 1.0
    for row, (i, j) in enumerate(shears, dimension):
        V[row, i * dimension + j] = V[row, j * dimension + i] = 1.0
    return V


class Cells:
    """Cells of a reference: who surrounds whom, and first-order shape functions.

    Attributes
    ----------
    nodes : (cells, vertices)
        In dolfinx's vertex order.
    points : (nodes, dimension)
    around : (nodes, cells)
        1 where a node is a vertex of a cell.
    tags : (cells,)
        Number of each cell's material.
    shapes : list of (cells,)
        Rows of cells that are translates of one another; empty where nearly none is.
    """

    MOST_SHAPES = 32

    def __init__(self, element: Element) -> None:
        self.element = element
        self.dimension = d = element.dimension
        self.nodes = versions.cell_nodes(element.mesh)
        self.points = element.reference.points[:, :d]
        self.tags = element.reference.tags
        count, vertices = self.nodes.shape
        entries = (self.nodes.ravel(), np.repeat(np.arange(count), vertices))
        self.around = sparse.csr_matrix(
            (np.ones(count * vertices), entries), shape=(len(self.points), count)
        )
        offsets = self.points[self.nodes[:, 1:]] - self.points[self.nodes[:, :1]]
        offsets = np.rint(offsets.reshape(count, -1) / (1e-9 * np.abs(offsets).max()))
        offsets = np.column_stack([offsets, self.tags])
        first = np.flatnonzero(np.any(offsets != offsets[0], axis=1))
        if len(first) == 0:
            self.shapes = [np.arange(count)]
        else:
            _, shape = np.unique(offsets, axis=0, return_inverse=True)
            shape = shape.reshape(-1)
            many = shape.max() >= self.MOST_SHAPES
            self.shapes = (
                [] if many else [np.flatnonzero(shape == s) for s in range(shape.max() + 1)]
            )

    @cached_property
    def first_moments(self) -> list[sparse.csr_matrix]:
        """Operators that sum over the cells of a node: 1 and the offset of the centre by axis."""
        centres = self.points[self.nodes].mean(axis=1)
        pattern = self.around
        node = np.repeat(np.arange(len(self.points)), np.diff(pattern.indptr))
        offsets = (centres[pattern.indices] - self.points[node]).T  # zeros stay entries
        return [
            pattern,
            *(
                sparse.csr_matrix((x, pattern.indices, pattern.indptr), shape=pattern.shape)
                for x in offsets
            ),
        ]

    @cached_property
    def second_moments(self) -> Array:
        """Σ p pᵀ with p = (1, centre - node) over the cells of a node, (nodes, upper triangle)."""
        size = self.dimension + 1
        offsets = [m.data for m in self.first_moments]
        pattern = self.around
        sums = []
        for i, j in zip(*np.triu_indices(size), strict=True):
            product = sparse.csr_matrix(
                (offsets[i] * offsets[j], pattern.indices, pattern.indptr), shape=pattern.shape
            )
            sums.append(np.asarray(product.sum(axis=1)).ravel())
        return np.stack(sums, axis=1)

    @cached_property
    def neighbours(self) -> sparse.csr_matrix:
        """How many cells two nodes share, (nodes, nodes)."""
        return (self.around @ self.around.T).tocsr()

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the reference's facets, (facets, dimension)."""
        mesh, d, reference = self.element.mesh, self.dimension, self.element.reference
        mesh.topology.create_connectivity(d - 1, d)
        links, offsets = versions.adjacency(mesh.topology.connectivity(d - 1, d))
        cell = links[offsets[reference.facet_entities]]
        corner = self.points[reference.facets]
        edge = corner[:, 1] - corner[:, 0]
        if d == 2:
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        else:
            normal = np.cross(edge, corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        inward = self.points[self.nodes[cell]].mean(axis=1) - corner.mean(axis=1)
        return normal * -np.sign(np.einsum("fi,fi->f", normal, inward))[:, None]

    def gradients(self, rows: NDArray[np.int64], slopes: Array) -> tuple[Array, Array]:
        """Shape function gradients and Jacobian determinants at points of cells.

        Parameters
        ----------
        slopes : (points, dimension, vertices)
            On the reference cell.

        Returns
        -------
        (cells, points, dimension, vertices) and (cells, points).
        """
        corners = self.points[self.nodes[rows]]
        jacobian = np.einsum("qrv,cvi->cqir", slopes, corners)
        inverse = np.linalg.inv(jacobian)
        return np.einsum("cqri,qrv->cqiv", inverse, slopes), np.abs(np.linalg.det(jacobian))

    def batches(self, members: int) -> list[tuple[NDArray[np.int64], NDArray[np.int64], slice]]:
        """Cells of one material to work on at once: (rows, rows that give shapes, members)."""
        result = []
        groups = [(rows, rows[:1]) for rows in self.shapes]
        if not groups:
            for tag in np.unique(self.tags):
                rows = np.flatnonzero(self.tags == tag)
                parts = [rows[i : i + BATCH] for i in range(0, len(rows), BATCH)]
                groups += [(part, part) for part in parts]
        for rows, shape in groups:
            step = max(1, BATCH // len(rows))
            result += [(rows, shape, slice(m, m + step)) for m in range(0, members, step)]
        return result


BATCH = 100_000
"""Cells worked on at once."""


def at_cells(values: Array, nodes: NDArray[np.int32]) -> Array:
    """Values (nodes, members, k) at the vertices of cells, (members, cells, vertices · k)."""
    by_member = np.ascontiguousarray(np.swapaxes(values, 0, 1))
    return by_member[:, nodes].reshape(values.shape[1], len(nodes), -1)


def apply(operator: Array, values: Array) -> Array:
    """Apply one operator a cell (cells or 1, n, m) to (members, cells, n): (members, cells, m)."""
    if len(operator) == 1:
        return values @ operator[0]
    return np.matmul(values[:, :, None], operator)[:, :, 0]


def stress_operator(gradients: Array, DV: Array) -> Array:
    """From displacements at vertices to stresses at points.

    Parameters
    ----------
    gradients : (cells, points, dimension, vertices)
    DV : (components, dimension²)

    Returns
    -------
    (cells, vertices · dimension, points · components)
    """
    count, points, d, vertices = gradients.shape
    tensor = DV.reshape(-1, d, d)
    result = np.einsum("sij,cqjv->cviqs", tensor, gradients, optimize=True)
    return result.reshape(count, vertices * d, points * len(DV))


@dataclass(frozen=True, eq=False)
class _Continuation:
    """Owned nodes that take their polynomial from neighbours that have one already."""

    sources: NDArray[np.bool_]
    targets: NDArray[np.bool_]
    weight: Array


class Copies:
    """Copies of all nodes of this rank's subdomains, by class, and their owners."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.exchange = model.node_exchange
        self.starts = np.cumsum([0, *(len(s.nodes) for s in model.partition.subdomains)])
        self.owned = self.exchange.last - self.exchange.first
        self.place = self.exchange.nodes - self.exchange.first
        arrived = len(self.place)
        self._gather = sparse.csr_matrix(
            (np.ones(arrived), (self.place, np.arange(arrived))), shape=(self.owned, arrived)
        )

    def sum(self, by_class: Sequence[Array], width: int) -> Array:
        """Sum (nodes, members, width) of each class over the copies of a node: (owned, width)."""
        copies = np.empty((self.starts[-1], width))
        for local, (cls, column) in enumerate(self.model.place):
            copies[self.starts[local] : self.starts[local + 1]] = by_class[cls][:, column]
        return self._gather @ self.exchange.to_owners(copies)

    def spread(self, values: Array) -> list[Array]:
        """Bring (owned, width) to (nodes, members, width) of each class."""
        copies = self.exchange.from_owners(values[self.place])
        result = []
        for cls in range(len(self.model.elements)):
            mine = np.flatnonzero(self.model.place[:, 0] == cls)
            mine = mine[np.argsort(self.model.place[mine, 1])]
            parts = [copies[self.starts[i] : self.starts[i + 1]] for i in mine]
            result.append(np.stack(parts, axis=1))
        return result


class StressRecovery:
    """Recovers σ* from answers to one model; making and using it are collective."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.dimension = model.scene.dimension
        made: dict[int, Cells] = {}
        for element in model.elements:
            if id(element) not in made:
                made[id(element)] = Cells(element)
        self.cells = [made[id(element)] for element in model.elements]
        self.D = [
            [elasticity(material, model.scene.plane, self.dimension) for material in materials]
            for materials in model.materials
        ]
        self.V = strain_of_gradient(self.dimension)
        self._copies = Copies(model)
        self._fit, self._continuations = self._plan()

    def _plan(self) -> tuple[Array, list[_Continuation]]:
        """Operators from moments to polynomials at owned nodes, and who continues whose."""
        size, copies = self.dimension + 1, self._copies
        members = np.bincount(self.model.place[:, 0], minlength=len(self.cells))
        shared = [
            np.broadcast_to(c.second_moments[:, None], (len(c.points), m, size * (size + 1) // 2))
            for c, m in zip(self.cells, members, strict=True)
        ]
        upper = np.triu_indices(size)
        A = np.empty((copies.owned, size, size))
        A[:, upper[0], upper[1]] = copies.sum(shared, size * (size + 1) // 2)
        A[:, upper[1], upper[0]] = A[:, upper[0], upper[1]]
        root = np.sqrt(np.einsum("nii->ni", A))
        scale = root[:, :, None] * root[:, None, :]
        A /= scale
        fit = np.broadcast_to(np.eye(size), A.shape).copy()
        done = np.ones(len(A), bool)
        skew = np.flatnonzero(np.abs(A - fit).max(axis=(1, 2)) > SYMMETRIC)
        done[skew] = np.linalg.det(A[skew]) > FLAT
        skew = skew[done[skew]]
        fit[skew] = np.linalg.inv(A[skew])
        continuations = []
        while True:
            counts = [
                (c.neighbours @ known[..., 0])[..., None]
                for c, known in zip(self.cells, copies.spread(done[:, None] * 1.0), strict=True)
            ]
            weight = copies.sum(counts, 1)
            targets = ~done & (weight[:, 0] > 0.0)
            if not self.model.comm.allreduce(int(targets.sum())):
                break
            continuations.append(_Continuation(done, targets, weight[targets]))
            done = done | targets
        values, vectors = np.linalg.eigh(A[~done])  # nothing to continue: a body one cell thick
        kept = values > WEAK
        inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        fit[~done] = np.einsum("nij,nj,nkj->nik", vectors, inverse, vectors)
        return fit / scale, continuations

    def centre_stresses(self, displacements: Sequence[Array]) -> list[Array]:
        """Stress at cell centres, (cells, members, components) of each class."""
        result = []
        for cells, D, u in zip(self.cells, self.D, displacements, strict=True):
            slopes = versions.centre_slopes(cells.element.mesh)
            field = u.reshape(len(cells.points), self.dimension, -1).swapaxes(1, 2)
            stress = np.empty((len(cells.nodes), u.shape[1], len(self.V)))
            for rows, shape, part in cells.batches(u.shape[1]):
                gradients, _ = cells.gradients(shape, slopes)
                operator = stress_operator(gradients, D[cells.tags[rows[0]]] @ self.V)
                found = apply(operator, at_cells(field[:, part], cells.nodes[rows]))
                stress[rows, part] = np.swapaxes(found, 0, 1)
            result.append(stress)
        return result

    def __call__(
        self, displacements: Sequence[Array], touching: Sequence[NDArray[np.bool_]]
    ) -> list[Array]:
        """σ* at nodes, (nodes, members, components) of each class.

        Parameters
        ----------
        displacements : one (n, members) array a class
        touching : one (nodes, members) array a class
            Nodes that an obstacle or another body pushes.
        """
        copies, size = self._copies, self.dimension + 1
        stresses = self.centre_stresses(displacements)
        recovered = np.empty((copies.owned, len(self.V)))
        for component in range(len(self.V)):
            moments = copies.sum(
                [
                    np.stack([moment @ s[..., component] for moment in c.first_moments], axis=-1)
                    for c, s in zip(self.cells, stresses, strict=True)
                ],
                size,
            )
            linear = np.einsum("nij,nj->ni", self._fit, moments)
            for step in self._continuations:
                known = copies.spread(np.where(step.sources[:, None], linear, 0.0))
                parts = [_continued(c, k) for c, k in zip(self.cells, known, strict=True)]
                linear[step.targets] = copies.sum(parts, size)[step.targets] / step.weight
            recovered[:, component] = linear[:, 0]
        self._meet_tractions(recovered, touching)
        return copies.spread(recovered)

    def _meet_tractions(self, recovered: Array, touching: Sequence[NDArray[np.bool_]]) -> None:
        """Change σ* at surface nodes as little as their tractions ask for."""
        s, exchange = len(self.V), self._copies.exchange
        nodes, known = [np.zeros(0, np.int64)], [np.zeros((0, s * s + s))]
        for local, subdomain in enumerate(self.model.partition.subdomains):
            if len(subdomain.exterior):
                cls, column = self.model.place[local]
                touch = touching[cls][:, column]
                facets, equations = self._equations(subdomain, self.cells[cls], touch)
                at_node, place = np.unique(facets, return_inverse=True)
                place = place.reshape(facets.shape)
                incidence = sparse.csr_matrix(
                    (
                        np.ones(place.size),
                        (place.ravel(), np.repeat(np.arange(len(facets)), facets.shape[1])),
                    )
                )
                nodes.append(subdomain.nodes[at_node])
                known.append(incidence @ equations)
        surface = NodeExchange(self.model.comm, np.concatenate(nodes), exchange.total)
        arrived = surface.to_owners(np.concatenate(known))
        number, place = np.unique(surface.nodes - surface.first, return_inverse=True)
        sums = (
            sparse.csr_matrix(
                (np.ones(len(place)), (place, np.arange(len(place)))),
                shape=(len(number), len(place)),
            )
            @ arrived
        )
        P, q = sums[:, : s * s], sums[:, s * s :]
        # many nodes have the same P: a face or an edge of a box
        key = np.round(P @ np.sqrt(np.arange(2.0, s * s + 2.0)), 9)
        _, first, kind = np.unique(key, return_index=True, return_inverse=True)
        inverse = np.linalg.pinv(P[first].reshape(-1, s, s), rcond=WEAK, hermitian=True)
        missing = q - np.einsum("nij,nj->ni", P.reshape(-1, s, s), recovered[number])
        recovered[number] += np.einsum("nij,nj->ni", inverse[kind.reshape(-1)], missing)

    def _equations(
        self, subdomain: Subdomain, cells: Cells, touch: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int32], Array]:
        """Nodes of surface facets and the normal equations of their known tractions.

        Row by row CᵀC and Cᵀt of C σ = t, which is σ n = t in the components that are not held,
        and along the surface alone where a node of the facet is pushed by an obstacle.
        """
        scene, d, s = self.model.scene, self.dimension, len(self.V)
        body, normal = scene.bodies[subdomain.body], cells.normals
        load = np.zeros((len(normal), d))
        known = np.broadcast_to(np.eye(d), (len(normal), d, d)).copy()
        for traction in scene.tractions:
            if traction.body == subdomain.body:
                load[boundary_facets(subdomain, body, traction.boundary)] += traction.vector
        for pressure in scene.pressures:
            if pressure.body == subdomain.body:
                rows = boundary_facets(subdomain, body, pressure.boundary)
                load[rows] -= pressure.value * normal[rows]
        pushed = touch[subdomain.reference.facets].any(axis=1)
        sides = [(t.body, t.boundary) for t in scene.touching]
        sides += [(pair.other, pair.other_boundary) for pair in scene.pairs]
        for number, boundary in sides:
            if number == subdomain.body:
                rows = boundary_facets(subdomain, body, boundary)
                n = normal[rows[pushed[rows]]]
                known[rows[pushed[rows]]] = np.eye(d) - n[:, :, None] * n[:, None, :]
        for condition in scene.displacements:
            if condition.body == subdomain.body:
                rows = boundary_facets(subdomain, body, condition.boundary)
                free = np.array([value is None for value in condition.values], float)
                known[rows] = free[:, None] * known[rows]
        C = np.zeros((len(normal), d, s))
        for i in range(d):
            C[:, i, i] = normal[:, i]
        for row, (i, j) in enumerate(SHEARS[: s - d], d):
            C[:, i, row], C[:, j, row] = normal[:, j], normal[:, i]
        C = (known @ C)[subdomain.exterior]
        t = np.einsum("fij,fj->fi", known, load)[subdomain.exterior]
        squares = np.einsum("fki,fkj->fij", C, C).reshape(len(C), -1)
        return (
            subdomain.reference.facets[subdomain.exterior],
            np.concatenate([squares, np.einsum("fki,fk->fi", C, t)], axis=1),
        )


def _continued(cells: Cells, linear: Array) -> Array:
    """Sum over neighbours of their polynomials (value, gradient), about the node itself."""
    x = cells.points
    at_origin = linear[..., 0] - np.einsum("nmi,ni->nm", linear[..., 1:], x)
    slopes = np.stack([cells.neighbours @ linear[..., 1 + i] for i in range(x.shape[1])], axis=-1)
    value = cells.neighbours @ at_origin + np.einsum("nmi,ni->nm", slopes, x)
    return np.concatenate([value[..., None], slopes], axis=-1)
