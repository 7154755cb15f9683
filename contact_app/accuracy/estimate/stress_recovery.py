"""A continuous stress fitted to the stresses of a finite-element answer.

Around each vertex a polynomial of the degree of the displacement is fitted to the stresses where
those converge faster than elsewhere, at the centres of first-order cells and at the points of a
rule of degree 2 in second-order ones (Zienkiewicz & Zhu, *The superconvergent patch recovery and a
posteriori error estimates*, IJNME 33, 1992). Its value at the vertex is the recovered stress σ*;
at the other nodes of second-order cells σ* is the mean of the polynomials of the vertices they lie
amid. Where a vertex has too few cells for a fit, on the surface, linear polynomials of its
neighbours are continued to it, and quadratic ones, which run away when continued, are fitted to the
cells of its neighbours, too, with less weight than to its own. On the surface σ* n is known as
well: it is the traction where one is given, zero where nothing is, and has no part along the
surface where the body touches without friction. The smallest change of σ* at the node that meets
these (in the least squares where they contradict each other, as at the edge of a load) is made.

Sums over cells are made subdomain by subdomain and meet at the owner of each vertex, so that σ*
depends neither on the decomposition nor on the number of ranks. Bodies share no nodes: stresses
are not averaged across them. Inside a body they are, also where its material changes: there the
true stress jumps, the recovered one does not, and the estimate that uses it is too large. A
recovery of one material alone knows that material's side.

With mean dilatation (B-bar) the answer's own stress, which the fit takes and the estimate compares
with, has λ times the mean of div u over each cell.

Stress and strain have the components xx, yy, xy in the plane and xx, yy, zz, xy, yz, xz in space;
shear strains are engineering ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.accuracy.estimate.patch_fits import (
    FLAT,
    WEAK,
    Copies,
    LinearFits,
    Meeting,
    QuadraticFits,
)
from contact_app.accuracy.estimate.patches import Cells, Table
from contact_app.model.boundaries import boundary_facets
from contact_app.model.model import Model
from contact_app.scene.scene import Scene
from meshes import Subdomain

Array = NDArray[np.float64]

SHEARS = ((0, 1), (1, 2), (0, 2))


def strain_of_gradient(dimension: int) -> Array:
    """V of ε = V vec(∂u_i/∂x_j), j fastest: (components, dimension²)."""
    shears = SHEARS[: 2 * dimension - 3]
    V = np.zeros((dimension + len(shears), dimension**2))
    for i in range(dimension):
        V[i, i * dimension + i] = 1.0
    for row, (i, j) in enumerate(shears, dimension):
        V[row, i * dimension + j] = V[row, j * dimension + i] = 1.0
    return V


def at_cells(values: Array, nodes: NDArray[np.int32]) -> Array:
    """Values (nodes, members, k) at the vertices of cells, (members, cells, vertices · k)."""
    by_member = np.ascontiguousarray(np.swapaxes(values, 0, 1))
    at = np.take(by_member, nodes, axis=1, mode="clip")
    return at.reshape(values.shape[1], len(nodes), -1)


def apply(operator: Array, values: Array) -> Array:
    """Apply one operator a cell (cells or 1, n, m) to (members, cells, n): (members, cells, m)."""
    if len(operator) == 1:
        return values @ operator[0]
    return np.matmul(values[:, :, None], operator)[:, :, 0]


def stress_operator(gradients: Array, DV: Array) -> Array:
    """From displacements at nodes to stresses at points.

    Parameters
    ----------
    gradients : (cells, points, dimension, nodes)
    DV : (components, dimension²)

    Returns
    -------
    (cells, nodes · dimension, points · components)
    """
    count, points, d, nodes = gradients.shape
    tensor = DV.reshape(-1, d, d)
    result = np.einsum("sij,cqjv->cviqs", tensor, gradients, optimize=True)
    return result.reshape(count, nodes * d, points * len(DV))


def tied_sides(scene: Scene) -> list[tuple[int, str]]:
    """Body and boundary of each side of the tied pairs, whose tractions are not known."""
    sides = [(tie.body, tie.boundary) for tie in scene.ties]
    return sides + [(tie.other, tie.other_boundary) for tie in scene.ties]


class Patches:
    """What a recovery needs of the meshes of a model, whatever loads it (collective).

    Parameters
    ----------
    material
        Number of a material within its body: σ* is fitted in the cells of that material alone and
        holds at their nodes. All cells unless given.
    flat
        Determinant of the moments of a patch from which it determines a linear polynomial.

    Attributes
    ----------
    cells
        Of each class.
    copies
        Where the vertices of subdomains meet.
    fits
        Fits polynomials to samples around each vertex.
    """

    def __init__(self, model: Model, material: int | None = None, flat: float = FLAT) -> None:
        made: dict[int, Cells] = {}
        for element in model.elements:
            if id(element) not in made:
                made[id(element)] = Cells(element, material)
        self.model = model
        self.cells = [made[id(element)] for element in model.elements]
        self.copies = Copies(model, [c.vertices for c in self.cells])
        degree = max(body.degree for body in model.scene.bodies)
        self.fits: LinearFits | QuadraticFits = (
            LinearFits(model.comm, self.cells, self.copies, flat)
            if degree == 1
            else QuadraticFits(model.comm, self.cells, self.copies)
        )

    @cached_property
    def surface_nodes(self) -> list[NDArray[np.int64]]:
        """Nodes on the surface of each class."""
        return [np.unique(cells.element.reference.facets) for cells in self.cells]

    @cached_property
    def surface(self) -> Copies:
        """Their copies (collective)."""
        return Copies(self.model, self.surface_nodes)

    @cached_property
    def exterior(self) -> tuple[NDArray[np.int64], Meeting]:
        """Those of them that lie on the bodies' surfaces (collective)."""
        surface = self.surface
        outside = np.zeros((surface.count, 1))
        for subdomain, (cls, column) in zip(
            self.model.partition.subdomains, self.model.place, strict=True
        ):
            facets = subdomain.reference.facets[subdomain.exterior]
            at = np.searchsorted(self.surface_nodes[cls], facets.ravel())
            surface.of_class(outside, cls)[at, column] = 1.0
        copies = np.flatnonzero(surface.scatter(surface.gather(outside))[:, 0])
        return copies, surface.some(copies)


class StressRecovery:
    """Recovers σ* from answers to one model; making and using it are collective.

    Parameters
    ----------
    patches
        Of the model's meshes, where they are known from another load case.
    """

    def __init__(self, model: Model, patches: Patches | None = None) -> None:
        self.model = model
        self.dimension = model.scene.dimension
        self.patches = patches or Patches(model)
        self.cells = self.patches.cells
        self.moduli = [
            [material.elasticity(model.scene.plane, self.dimension) for material in materials]
            for materials in model.materials
        ]
        self.thermal = [
            [material.thermal_stress(model.scene.plane) for material in materials]
            for materials in model.materials
        ]
        self.averaged = [materials[0].mean_dilatation for materials in model.materials]
        self.V = strain_of_gradient(self.dimension)

    def stress_at(self, number: int, rows: NDArray[np.int64], table: Table, DV: Array) -> Array:
        """Operators of a class from displacements of cells to D V of their gradients at points.

        Parameters
        ----------
        DV : (2, components, dimension²)
            For the shape and the volume, which mean dilatation takes from the means over cells.
        """
        cells = self.cells[number]
        gradients, _ = cells.gradients(rows, table)
        if not self.averaged[number]:
            return stress_operator(gradients, DV.sum(axis=0))
        means = np.broadcast_to(cells.mean_gradients(rows), gradients.shape)
        return stress_operator(gradients, DV[0]) + stress_operator(means, DV[1])

    def thermal_at(
        self, number: int, rows: NDArray[np.int64], members: slice, table: Table
    ) -> Array | None:
        """What stress lacks by heat in cells of one material; None without heat.

        Returns
        -------
        (members, cells, points, components)
        """
        heat = self.model.temperatures[number]
        if heat is None:
            return None
        cells = self.cells[number]
        shape, volume = self.thermal[number][cells.tags[rows[0]]]
        nodal = at_cells(heat[:, members, None], cells.nodes[rows])
        at = nodal @ table.values.T
        mean = at
        if self.averaged[number]:
            mean = np.einsum("mcn,cn->mc", nodal, cells.mean_values(rows))[..., None]
        missing = np.zeros((*at.shape, len(self.V)))
        missing[..., : self.dimension] = (shape * at + volume * mean)[..., None]
        return missing

    def samples(self, displacements: Sequence[Array]) -> list[Array]:
        """Stresses for the fit, (cells · points, members, components) of each class."""
        result = []
        for number, u in enumerate(displacements):
            cells = self.cells[number]
            table = cells.samples
            q, s = len(table.weights), len(self.V)
            field = u.reshape(len(cells.places), self.dimension, -1).swapaxes(1, 2)
            stress = np.empty((len(cells.nodes), q, u.shape[1], s))
            for rows, shape, part in cells.batches(u.shape[1], q):
                D = np.array(self.moduli[number][cells.tags[rows[0]]])
                operator = self.stress_at(number, shape, table, D @ self.V)
                found = apply(operator, at_cells(field[:, part], cells.nodes[rows]))
                found = found.reshape(*found.shape[:2], q, s)
                missing = self.thermal_at(number, rows, part, table)
                if missing is not None:
                    found = found - missing
                stress[rows, :, part] = np.moveaxis(found, 0, 2)
            result.append(stress.reshape(-1, u.shape[1], s))
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
        found, s = self.patches.fits.at_vertices(self.samples(displacements)), len(self.V)
        recovered = [
            c.at_nodes(part.reshape(*part.shape[:2], self.patches.fits.kept, s))
            for c, part in zip(self.cells, self.patches.copies.spread(found), strict=True)
        ]
        self._meet_tractions(recovered, touching)
        return recovered

    def _meet_tractions(
        self, recovered: Sequence[Array], touching: Sequence[NDArray[np.bool_]]
    ) -> None:
        """Change σ* at surface nodes as little as their tractions ask for, in place."""
        surface, (exterior, met) = self.patches.surface, self.patches.exterior
        s = len(self.V)
        places, equations = [np.zeros(0, np.int64)], [np.zeros((0, s * s + s))]
        for subdomain, (cls, column) in zip(
            self.model.partition.subdomains, self.model.place, strict=True
        ):
            if len(subdomain.exterior):
                cells = self.cells[cls]
                equations.append(self._equations(subdomain, cells, touching[cls][:, column]))
                facets = subdomain.reference.facets[subdomain.exterior]
                at = np.searchsorted(self.patches.surface_nodes[cls], facets.ravel())
                places.append(surface.starts[cls] + at * surface.shapes[cls][1] + column)
        place = np.searchsorted(exterior, np.concatenate(places))
        incidence = sparse.csr_matrix(
            (np.ones(len(place)), (place, np.arange(len(place)))),
            shape=(len(exterior), len(place)),
        )
        sums = met.gather(incidence @ np.concatenate(equations))
        known = np.flatnonzero(sums[:, : s * s].any(axis=1))
        P, q = sums[known, : s * s], sums[known, s * s :]
        # many nodes have the same P: a face or an edge of a box
        key = np.round(P @ np.sqrt(np.arange(2.0, s * s + 2.0)), 9)
        _, first, kind = np.unique(key, return_index=True, return_inverse=True)
        inverse = np.linalg.pinv(P[first].reshape(-1, s, s), rcond=WEAK, hermitian=True)
        inverse = inverse[kind.reshape(-1)]
        change = np.zeros_like(sums)  # of σ to σ + q - P σ
        change[known, : s * s] = (inverse @ P.reshape(-1, s, s)).reshape(-1, s * s)
        change[known, s * s :] = (inverse @ q[..., None])[..., 0]
        changes = met.scatter(change)
        for cls, (values, own) in enumerate(
            zip(recovered, self.patches.surface_nodes, strict=True)
        ):
            begin, end = np.searchsorted(exterior, surface.starts[cls : cls + 2])
            row, member = np.divmod(exterior[begin:end] - surface.starts[cls], values.shape[1])
            mine, before = changes[begin:end], values[own[row], member]
            taken = mine[:, : s * s].reshape(-1, s, s) @ before[..., None]
            values[own[row], member] = before - taken[..., 0] + mine[:, s * s :]

    def _equations(self, subdomain: Subdomain, cells: Cells, touch: NDArray[np.bool_]) -> Array:
        """Normal equations of the known tractions at the nodes of surface facets, (n, s² + s).

        Row by row CᵀC and Cᵀt of C σ = t, which is σ n = t in the components that are not held,
        and along the surface alone where a node of the facet is pushed by an obstacle.
        """
        scene, d, s = self.model.scene, self.dimension, len(self.V)
        body, normal = scene.bodies[subdomain.body], cells.normals
        load = np.zeros(normal.shape)
        known = np.broadcast_to(np.eye(d), (*normal.shape, d)).copy()
        for traction in scene.tractions:
            if traction.body == subdomain.body:
                load[boundary_facets(subdomain, body, traction.boundary)] += traction.vector
        for pressure in scene.pressures:
            if pressure.body == subdomain.body:
                rows = boundary_facets(subdomain, body, pressure.boundary)
                load[rows] -= pressure.value * normal[rows]
        for linear in self.model.linear:
            if linear.body == subdomain.body:
                rows = boundary_facets(subdomain, body, linear.boundary)
                places = subdomain.points()[subdomain.reference.facets[rows]]
                load[rows] += linear.at(places, d)
        pushed = touch[subdomain.reference.facets].any(axis=1)
        sides = [(t.body, t.boundary) for t in scene.touching]
        sides += [(pair.other, pair.other_boundary) for pair in scene.pairs]
        for number, boundary in sides:
            if number == subdomain.body:
                rows = boundary_facets(subdomain, body, boundary)
                n = normal[rows[pushed[rows]]]
                known[rows[pushed[rows]]] = np.eye(d) - n[..., :, None] * n[..., None, :]
        for number, boundary in tied_sides(scene):
            if number == subdomain.body:
                known[boundary_facets(subdomain, body, boundary)] = 0.0
        for condition in scene.displacements:
            if condition.body == subdomain.body:
                rows = boundary_facets(subdomain, body, condition.boundary)
                free = np.array([value is None for value in condition.values], float)
                known[rows] = free[:, None] * known[rows]
        known, normal, load = (a[subdomain.exterior] for a in (known, normal, load))
        C = np.zeros((*normal.shape, s))
        for i in range(d):
            C[..., i, i] = normal[..., i]
        for row, (i, j) in enumerate(SHEARS[: s - d], d):
            C[..., i, row], C[..., j, row] = normal[..., j], normal[..., i]
        C = known @ C
        t = known @ load[..., None]
        transposed = np.swapaxes(C, -1, -2)
        squares = (transposed @ C).reshape(-1, s * s)
        right = (transposed @ t).reshape(-1, s)
        return np.concatenate([squares, right], axis=1)
