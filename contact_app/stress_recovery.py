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
true stress jumps, the recovered one does not, and the estimate that uses it is too large.

With mean dilatation (B-bar) the answer's own stress, which the fit takes and the estimate compares
with, has λ times the mean of div u over each cell.

Stress and strain have the components xx, yy, xy in the plane and xx, yy, zz, xy, yz, xz in space;
shear strains are engineering ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.assembly import lame
from contact_app.model import Model, boundary_facets
from contact_app.patches import Cells, Table, monomial_count, translations
from contact_app.scene import Material
from meshes import Subdomain
from solver.tfeti.exchange import NodeExchange

Array = NDArray[np.float64]

SHEARS = ((0, 1), (1, 2), (0, 2))

FLAT = 1e-4
"""Determinant of a patch's linear moments, scaled to a unit diagonal, above which they determine a
linear polynomial: 1 for a symmetric patch, 0 for one whose cell centres lie in a plane."""

THIN = 1e-3
"""Smallest eigenvalue of quadratic moments, so scaled, above which they determine a quadratic
polynomial: 0.1 to 0.2 for a symmetric patch."""

OWN = 32.0
"""How often the cells around a vertex count besides, where those of its neighbours help them out:
these tell only what the few cannot."""

WEAK = 1e-2
"""Directions of a fit below this share of the strongest are left out."""

AT_ONCE = 20_000_000
"""Numbers of polynomials kept at once; components of the stress are taken a few at a time."""


def moduli(material: Material, plane: str | None, dimension: int) -> tuple[Array, Array]:
    """D of σ = D ε in two parts, of the shape and of the volume, (components, components) each."""
    lam, mu = lame(material, plane)
    size = dimension * (dimension + 1) // 2
    volume = np.zeros((size, size))
    volume[:dimension, :dimension] = lam
    return np.diag(np.where(np.arange(size) < dimension, 2.0 * mu, mu)), volume


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
    return by_member[:, nodes].reshape(values.shape[1], len(nodes), -1)


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


class _Helped:
    """Owned vertices with too few cells, and the neighbours that help them out.

    A neighbour counts as often as it shares cells with the vertex. Linear polynomials are continued
    from neighbours that have one; quadratic ones are fitted to the moments about the vertex itself
    and all its neighbours.

    Attributes
    ----------
    targets : (owned,)
        The vertices that are helped.
    weight : (targets, 1)
        How often their neighbours count in all.
    """

    def __init__(
        self,
        cells: Sequence[Cells],
        copies: Copies,
        targets: NDArray[np.bool_],
        sources: NDArray[np.bool_],
    ) -> None:
        marked = copies.spread(np.stack([targets, sources], axis=1) * 1.0)
        rows, columns, weights, shifts = [], [], [], []
        for c, start, marks in zip(cells, copies.starts, marked, strict=False):
            target, source = np.moveaxis(marks > 0.0, 2, 0)
            members = target.shape[1]
            row, column, weight = c.neighbour_pairs
            some = np.flatnonzero(target.any(axis=1)[row] & source.any(axis=1)[column])
            row, column, weight = row[some], column[some], weight[some]
            pair, member = np.nonzero(target[row] & source[column])
            row, column = row[pair].astype(np.int64), column[pair].astype(np.int64)
            rows.append(start + row * members + member)
            columns.append(start + column * members + member)
            weights.append(weight[pair])
            shifts.append(c.points[row] - c.points[column])
        row = np.concatenate([np.zeros(0, np.int64), *rows])
        column = np.concatenate([np.zeros(0, np.int64), *columns])
        pairs = np.arange(len(row))
        sort = sparse.csr_matrix((pairs, (row, pairs)), shape=(copies.count, len(row)))
        counts = np.diff(sort.indptr)
        helped = np.flatnonzero(counts)
        counts, order = counts[helped], sort.indices
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        self._weight = np.concatenate([np.zeros(0), *weights])[order]
        self._shift = np.concatenate([np.zeros((0, cells[0].dimension)), *shifts])[order]
        helps = np.zeros(copies.count, bool)
        helps[column] = True
        helping = np.flatnonzero(helps)
        self._columns = (np.cumsum(helps) - 1)[column[order]]
        self._helped, self._helping = copies.some(helped), copies.some(helping)
        self._sources = np.searchsorted(copies.known, self._helping.known)
        self.targets = np.isin(copies.known, self._helped.known)
        totals = np.zeros((len(helped), 1))
        of = np.repeat(np.arange(len(helped)), counts)
        totals[:, 0] = np.bincount(of, self._weight, len(helped))
        self.weight = self._helped.gather(totals)

    def continued(self, polynomials: Array) -> Array:
        """Means of the neighbours' polynomials (owned, monomials, k), (targets, monomials, k)."""
        T = translations(self._shift, polynomials.shape[1])
        return self._summed(polynomials, T) / self.weight[:, :, None]

    def first(self, moments: Array) -> Array:
        """Σ m σ (targets, monomials, k), from those of all owned vertices."""
        T = translations(-self._shift, moments.shape[1])
        return self._summed(moments, np.swapaxes(T, 1, 2))

    def second(self, A: Array) -> Array:
        """Σ m mᵀ (targets, monomials, monomials), from those of all owned vertices."""
        size = A.shape[1]
        T = translations(-self._shift, size)
        known = self._helping.scatter(A[self._sources].reshape(-1, size**2))[self._columns]
        moved = np.swapaxes(T, 1, 2) @ known.reshape(-1, size, size) @ T
        moved *= self._weight[:, None, None]
        sums = np.add.reduceat(moved, self._starts[:-1]) if len(moved) else moved
        return self._helped.gather(sums.reshape(len(sums), size**2)).reshape(-1, size, size)

    def _summed(self, known: Array, T: Array) -> Array:
        """Sum over neighbours of T times what is known of them, (owned, size, k)."""
        size, k = known.shape[1:]
        values = self._helping.scatter(known[self._sources].reshape(-1, size * k))
        blocks = sparse.bsr_matrix(
            (self._weight[:, None, None] * T, self._columns, self._starts),
            shape=((len(self._starts) - 1) * size, len(values) * size),
        )
        sums = (blocks @ values.reshape(-1, k)).reshape(-1, size * k)
        return self._helped.gather(sums).reshape(-1, size, k)


class Meeting:
    """Copies of nodes and their owners.

    Parameters
    ----------
    numbers : (copies,)
        The node each copy stands for.
    total
        Nodes in all.

    Attributes
    ----------
    known : (owned,)
        Nodes this rank owns that have copies, in order.
    """

    def __init__(self, comm: MPI.Intracomm, numbers: NDArray[np.int64], total: int) -> None:
        self._exchange = exchange = NodeExchange(comm, numbers, total)
        self.known, at = np.unique(exchange.nodes, return_inverse=True)
        self._at = at.reshape(-1)
        kept, foreign = self._at[exchange.kept], np.delete(self._at, exchange.kept)
        self._sums = sparse.csr_matrix(
            (np.ones(len(kept)), (kept, exchange.own)), shape=(len(self.known), len(numbers))
        )
        # what comes from other ranks belongs to few of the nodes
        self._shared, place = np.unique(foreign, return_inverse=True)
        arrived = len(foreign)
        self._foreign = sparse.csr_matrix(
            (np.ones(arrived), (place.reshape(-1), np.arange(arrived))),
            shape=(len(self._shared), arrived),
        )

    def gather(self, copies: Array) -> Array:
        """Sum (copies, width) over the copies of a node, (owned, width)."""
        sums = self._sums @ copies
        if self._exchange.comm.size > 1:
            sums[self._shared] += self._foreign @ self._exchange.of_others(copies)
        return sums

    def scatter(self, values: Array) -> Array:
        """Bring (owned, width) to the copies, (copies, width)."""
        copies = values[self._at]
        return copies if self._exchange.comm.size == 1 else self._exchange.from_owners(copies)


class Copies(Meeting):
    """Copies of nodes in this rank's subdomains and their owners.

    Copies are numbered class by class, node by node, member by member.

    Parameters
    ----------
    nodes : one (n,) array a class
        Which of its nodes.

    Attributes
    ----------
    count
        Copies on this rank.
    starts : (classes + 1,)
        First copy of each class.
    shapes : one (n, members) pair a class
    """

    def __init__(self, model: Model, nodes: Sequence[NDArray[np.int64]]) -> None:
        members = np.bincount(model.place[:, 0], minlength=len(nodes))
        self.shapes = [(len(n), int(m)) for n, m in zip(nodes, members, strict=True)]
        self.starts = np.cumsum([0, *(n * m for n, m in self.shapes)])
        self.count = int(self.starts[-1])
        numbers = np.empty(self.count, np.int64)
        for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
            self.of_class(numbers, cls)[:, column] = s.nodes[nodes[cls]]
        self._comm, self._numbers, self._total = model.comm, numbers, model.partition.nodes
        super().__init__(self._comm, numbers, self._total)

    def some(self, copies: NDArray[np.integer[Any]]) -> Meeting:
        """Of some copies and their owners (collective)."""
        return Meeting(self._comm, self._numbers[copies], self._total)

    def of_class(self, values: NDArray, cls: int) -> NDArray:
        """View (n, members, …) of the copies of a class in (count, …)."""
        mine = values[self.starts[cls] : self.starts[cls + 1]]
        return mine.reshape(*self.shapes[cls], *values.shape[1:])

    def sum(self, by_class: Sequence[Array]) -> Array:
        """Sum (n, members, width) of each class over the copies of a node."""
        parts = [part.reshape(-1, part.shape[2]) for part in by_class]
        return self.gather(parts[0] if len(parts) == 1 else np.concatenate(parts))

    def spread(self, values: Array) -> list[Array]:
        """Bring (owned, width) to (n, members, width) of each class."""
        copies = self.scatter(values)
        return [self.of_class(copies, cls) for cls in range(len(self.shapes))]


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
        self.moduli = [
            [moduli(material, model.scene.plane, self.dimension) for material in materials]
            for materials in model.materials
        ]
        self.averaged = [materials[0].mean_dilatation for materials in model.materials]
        self.V = strain_of_gradient(self.dimension)
        self.size = monomial_count(self.dimension, max(body.degree for body in model.scene.bodies))
        self._copies = Copies(model, [c.vertices for c in self.cells])
        self._continuations: list[_Helped] = []
        self._enlarged: _Helped | None = None
        self._fit = self._plan()

    def _plan(self) -> Array:
        """Operators from moments to polynomials at owned vertices; finds who helps whom."""
        size, copies = self.size, self._copies
        upper = np.triu_indices(size)
        found: dict[int, Array] = {}
        for c in self.cells:
            if id(c) not in found:
                found[id(c)] = c.second_moments(size)[:, None]
        shared = [
            np.broadcast_to(found[id(c)], (*shape, len(upper[0])))
            for c, shape in zip(self.cells, copies.shapes, strict=True)
        ]
        sums = copies.sum(shared)
        diagonal = sums[:, upper[0] == upper[1]]
        root = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        sums = sums / (root[:, upper[0]] * root[:, upper[1]])
        sums[:, upper[0] == upper[1]] = 1.0
        # many vertices have the same moments: those of equal cells
        key = np.round(sums, 9) @ np.sqrt(np.arange(2.0, len(upper[0]) + 2.0))
        _, first, kind = np.unique(np.round(key, 8), return_index=True, return_inverse=True)
        kind = kind.reshape(-1)
        A = np.empty((len(first), size, size))
        A[:, upper[0], upper[1]] = A[:, upper[1], upper[0]] = sums[first]
        done = self._determined(A)
        fit = np.zeros(A.shape)
        fit[done] = np.linalg.inv(A[done])
        scale = root[:, :, None] * root[:, None, :]
        done_at = done[kind]
        if size > 1 + self.dimension:
            few = ~done_at
            fit = fit[kind] / scale
            if self.model.comm.allreduce(int(few.sum())):
                self._enlarged = helped = _Helped(self.cells, copies, few, np.ones_like(few))
                moments = A[kind] * scale
                mine = OWN * moments[helped.targets]
                fit[helped.targets] = self._pseudo_inverse(helped.second(moments) + mine)
            return fit
        while self.model.comm.allreduce(int((~done_at).sum())):
            helped = _Helped(self.cells, copies, ~done_at, done_at)
            if not self.model.comm.allreduce(int(helped.targets.sum())):
                break
            self._continuations.append(helped)
            done_at = done_at | helped.targets
        left = np.unique(kind[~done_at])  # nothing to continue: a body one cell thick
        fit[left] = self._pseudo_inverse(A[left])
        return fit[kind] / scale

    def _pseudo_inverse(self, A: Array) -> Array:
        """Of moments (n, monomials, monomials), without the directions they hardly determine."""
        diagonal = np.einsum("nii->ni", A)
        root = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        scale = root[:, :, None] * root[:, None, :]
        values, vectors = np.linalg.eigh(A / scale)
        kept = values > (WEAK if self.size == 1 + self.dimension else THIN)
        inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        return np.einsum("nij,nj,nkj->nik", vectors, inverse, vectors) / scale

    def _determined(self, A: Array) -> NDArray[np.bool_]:
        """Which scaled moments (n, monomials, monomials) determine a polynomial."""
        linear = 1 + self.dimension
        if self.size == linear:
            return np.asarray(np.linalg.det(A) > FLAT)
        # first-order cells leave the quadratic part alone, which is then the unit matrix
        flat = np.linalg.det(A[:, :linear, :linear]) <= FLAT
        quadratic = np.abs(A[:, :linear, linear:]).max(axis=(1, 2)) > 0.0
        return ~np.where(quadratic, np.linalg.eigvalsh(A)[:, 0] <= THIN, flat)

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
        stresses, s = self.samples(displacements), len(self.V)
        owned = self.model.comm.allreduce(len(self._copies.known), op=MPI.MAX)
        step = max(1, AT_ONCE // (owned * self.size + 1))
        parts = [
            self._polynomials([stress[..., k : k + step] for stress in stresses])
            for k in range(0, s, step)
        ]
        linear = np.concatenate(parts, axis=2)
        kept = self.size if self.size > 1 + self.dimension else 1
        spread = self._copies.spread(linear[:, :kept].reshape(len(linear), kept * s))
        recovered = [
            c.at_nodes(found.reshape(*found.shape[:2], kept, s))
            for c, found in zip(self.cells, spread, strict=True)
        ]
        self._meet_tractions(recovered, touching)
        return recovered

    def _polynomials(self, stresses: Sequence[Array]) -> Array:
        """Coefficients at owned vertices, (owned, monomials, components) of some components."""
        copies, size = self._copies, self.size
        k = stresses[0].shape[2] if stresses else 0
        moments = []
        for c, stress in zip(self.cells, stresses, strict=True):
            count, members = len(c.points), stress.shape[1]
            found = (c.first_moments @ stress.reshape(len(stress), -1)).reshape(
                count, -1, members, k
            )
            padded = np.zeros((count, members, size, k))
            padded[:, :, : found.shape[1]] = np.swapaxes(found, 1, 2)
            moments.append(padded.reshape(count, members, -1))
        summed = copies.sum(moments).reshape(-1, size, k)
        if self._enlarged is not None:
            targets = self._enlarged.targets
            summed[targets] = self._enlarged.first(summed) + OWN * summed[targets]
        polynomials = self._fit @ summed
        for helped in self._continuations:
            polynomials[helped.targets] = helped.continued(polynomials)
        return polynomials

    def _meet_tractions(
        self, recovered: Sequence[Array], touching: Sequence[NDArray[np.bool_]]
    ) -> None:
        """Change σ* at surface nodes as little as their tractions ask for, in place."""
        surface, (exterior, met) = self._surface, self._exterior
        s = len(self.V)
        places, equations = [np.zeros(0, np.int64)], [np.zeros((0, s * s + s))]
        for subdomain, (cls, column) in zip(
            self.model.partition.subdomains, self.model.place, strict=True
        ):
            if len(subdomain.exterior):
                cells = self.cells[cls]
                equations.append(self._equations(subdomain, cells, touching[cls][:, column]))
                facets = subdomain.reference.facets[subdomain.exterior]
                at = np.searchsorted(self._surface_nodes[cls], facets.ravel())
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
        for cls, (values, own) in enumerate(zip(recovered, self._surface_nodes, strict=True)):
            begin, end = np.searchsorted(exterior, surface.starts[cls : cls + 2])
            row, member = np.divmod(exterior[begin:end] - surface.starts[cls], values.shape[1])
            mine, before = changes[begin:end], values[own[row], member]
            taken = mine[:, : s * s].reshape(-1, s, s) @ before[..., None]
            values[own[row], member] = before - taken[..., 0] + mine[:, s * s :]

    @cached_property
    def _surface_nodes(self) -> list[NDArray[np.int64]]:
        """Nodes on the surface of each class."""
        return [np.unique(cells.element.reference.facets) for cells in self.cells]

    @cached_property
    def _surface(self) -> Copies:
        """Their copies (collective)."""
        return Copies(self.model, self._surface_nodes)

    @cached_property
    def _exterior(self) -> tuple[NDArray[np.int64], Meeting]:
        """Those of them that lie on the bodies' surfaces (collective)."""
        surface = self._surface
        outside = np.zeros((surface.count, 1))
        for subdomain, (cls, column) in zip(
            self.model.partition.subdomains, self.model.place, strict=True
        ):
            facets = subdomain.reference.facets[subdomain.exterior]
            at = np.searchsorted(self._surface_nodes[cls], facets.ravel())
            surface.of_class(outside, cls)[at, column] = 1.0
        copies = np.flatnonzero(surface.scatter(surface.gather(outside))[:, 0])
        return copies, surface.some(copies)

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
        pushed = touch[subdomain.reference.facets].any(axis=1)
        sides = [(t.body, t.boundary) for t in scene.touching]
        sides += [(pair.other, pair.other_boundary) for pair in scene.pairs]
        for number, boundary in sides:
            if number == subdomain.body:
                rows = boundary_facets(subdomain, body, boundary)
                n = normal[rows[pushed[rows]]]
                known[rows[pushed[rows]]] = np.eye(d) - n[..., :, None] * n[..., None, :]
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
