"""Contact pressure at the nodes of the surface, from the forces of contact rows.

What a multiplier is depends on the rows. Those of bodies on bodies, and of second-order
tetrahedra on obstacles, are mean pressures about a vertex times an area: p_j = λ_j / W_j. Those at
nodes are nodal forces f_k = ∫ p φ_k, and the pressure is the force over the node's share of the
boundary, q_k = f_k / ∫ φ_k.

With degree 2 that is not enough. Corners and middles see the pressure through different functions,
and where the boundary is a polygon, or the material nearly incompressible, q alternates between
them about the right mean, however fine the mesh. What alternates is taken out (`alternation`); the
values at all nodes are then as good as those of degree 1 on as many.

Near ν = 0.5 it is a large part of the pressure, opens nodes that should touch, and cannot be
told from the edge of the contact. There the pressure is taken linear on each facet, with the values
at the vertices

    P q = Σ_k ψ_j(x_k) f_k / ∫ ψ_j,     ψ_j the hat function of vertex j:

the mean of the pressure about the vertex, in which alternations cancel. It flattens a smooth peak
by h²p''/12; the mean of what it took away is given back, p = P q + P(q - P q) (twicing, J. W.
Tukey, *Exploratory Data Analysis*, 1977, chapter 16), which leaves errors of fourth order.

What would take p below zero is cut off and as much left out of the rest, so that ∫ p is the force.
Constant pressures are exact, linear ones are inside the boundary. Beside a jump means about
vertices overshoot by at most 3 % of it; at the end of the boundary the last of them is off by a
ninth of the change over the last facet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_app.alternation import Lines, alternation
from contact_app.facets import between_vertices, hats_at_nodes, moments
from contact_app.mirror import on_planes
from contact_app.model import Model, facets_of
from contact_app.solution import Solution
from meshes import Reference
from solver.tfeti.exchange import NodeExchange

Array = NDArray[np.float64]

STRONG = 0.05
"""Alternation over pressure, both in the mean, from which on means about vertices are taken."""


@dataclass(frozen=True, eq=False)
class SurfaceNodes:
    """Copies of the nodes on the bodies' surfaces in this rank's subdomains, and their owners.

    Attributes
    ----------
    local : list of (copies of a subdomain,)
        Ascending local nodes of each subdomain on the surface of its body.
    exchange
        Where the copies meet, one subdomain after another.
    owned : (owned,)
        Ascending numbers of the surface nodes this rank owns.
    place : (arrived,)
        Row in `owned` of each copy that arrives.
    """

    local: list[NDArray[np.int64]]
    exchange: NodeExchange
    owned: NDArray[np.int64]
    place: NDArray[np.int64]

    @classmethod
    def of(cls, model: Model) -> SurfaceNodes:
        """Find them (collective)."""
        subdomains = model.partition.subdomains
        local = [np.unique(s.reference.facets[s.exterior]).astype(np.int64) for s in subdomains]
        numbers = [s.nodes[nodes] for s, nodes in zip(subdomains, local, strict=True)]
        exchange = NodeExchange(model.comm, np.concatenate(numbers), model.partition.nodes)
        owned, place = np.unique(exchange.nodes, return_inverse=True)
        return cls(local, exchange, owned, place.reshape(-1))

    def sums(self, copies: Array) -> Array:
        """Sum values (copies,) at the owners, (owned,) (collective)."""
        arrived = self.exchange.to_owners(copies)
        return np.bincount(self.place, arrived, len(self.owned)).astype(np.float64)

    def copies(self, values: Array) -> Array:
        """Bring values (owned,) to the copies (collective)."""
        return self.exchange.from_owners(values[self.place])


@dataclass(frozen=True, eq=False)
class ContactForces:
    """What obstacles and other bodies do to the surface, at the nodes this rank owns.

    Attributes
    ----------
    nodes : (owned,)
        Numbers of surface nodes.
    pressure : (owned,)
    resultants : (obstacles and pairs, 3)
        Force on the body of each contact, of this rank's rows.
    without_area
        Rows that carry force at a node no facet of the contact boundary has.
    """

    nodes: NDArray[np.int64]
    pressure: Array
    resultants: Array
    without_area: int


def contact_forces(model: Model, solution: Solution, surface: SurfaceNodes) -> ContactForces:
    """Pressures and resultants of an answer (collective)."""
    scene, problem, contact = model.scene, model.problem, model.problem.contact
    force = solution.multiplier[problem.inequality] * contact.spread
    at = np.searchsorted(surface.owned, contact.nodes)
    pressure = np.zeros(len(surface.owned))
    lost = 0
    for i, touching in enumerate(scene.touching):
        mine = (contact.sources == i) & (force > 0.0)
        at_nodes = model.comm.allreduce(int(np.isnan(contact.areas[contact.sources == i]).sum()))
        second = scene.bodies[touching.body].degree == 2
        boundary = None
        if at_nodes or second:
            boundary = _Boundary(model, surface, touching.body, touching.boundary)
        area = contact.areas[mine]
        if boundary is not None and at_nodes:
            area = boundary.shares[at[mine]]
        lost += int((area <= 0.0).sum())
        loaded = area > 0.0
        part = np.zeros(len(pressure))
        np.add.at(part, at[mine][loaded], force[mine][loaded] / area[loaded])
        if boundary is not None and second:
            part = boundary.recovered(part) if at_nodes else boundary.at_all_nodes(part)
        pressure += part
    resultants = np.zeros((len(scene.touching), 3))
    np.add.at(resultants[:, : scene.dimension], contact.sources, force[:, None] * contact.normals)
    return ContactForces(surface.owned, pressure, resultants, lost)


def node_gaps(model: Model, solution: Solution, surface: SurfaceNodes, far: Array) -> Array:
    """Distance left at the owned surface nodes, (owned,); NaN where no row is (collective).

    Known about vertices only, it is continued to the middles between them.

    Parameters
    ----------
    far : (rows,)
        Distance along the rows that were left out.
    """
    left_out = model.left_out
    scene, problem, contact = model.scene, model.problem, model.problem.contact
    rows = problem.inequality
    distance = -problem.residual(problem.on_interface(solution.displacements))[rows]
    distance /= contact.spread
    distance = np.concatenate([distance, far])
    sources = np.concatenate([contact.sources, left_out.sources])
    areas = np.concatenate([contact.areas, left_out.areas])
    at = np.searchsorted(surface.owned, np.concatenate([contact.nodes, left_out.nodes]))
    gap = np.full(len(surface.owned), np.nan)
    for i, touching in enumerate(scene.touching):
        mine = sources == i
        part = np.full(len(gap), np.nan)
        np.fmin.at(part, at[mine], distance[mine])
        at_nodes = model.comm.allreduce(int(np.isnan(areas[mine]).sum()))
        if scene.bodies[touching.body].degree == 2 and not at_nodes:
            boundary = _Boundary(model, surface, touching.body, touching.boundary)
            part = boundary.at_all_nodes(part)
        gap = np.fmin(gap, part)
    return gap


def boundary_shares(model: Model, surface: SurfaceNodes, body: int, boundary: str) -> Array:
    """∫ φ_k over a boundary at the surface nodes this rank owns, (owned,) (collective)."""
    return _Boundary(model, surface, body, boundary).shares


class _Boundary:
    """The facets of one contact and what is averaged over them; all methods are collective.

    Attributes
    ----------
    shares : (owned,)
        ∫ φ_k over the boundary.
    """

    def __init__(self, model: Model, surface: SurfaceNodes, body: int, boundary: str) -> None:
        self._surface, self._scene = surface, model.scene
        d = model.scene.dimension
        starts = np.cumsum([0, *map(len, surface.local)])
        shares, areas = np.zeros(starts[-1]), np.zeros(starts[-1])
        self._points = np.zeros((starts[-1], 3))
        cache: dict[tuple, Array] = {}
        self._parts: list[tuple[NDArray[np.int64], Array]] = []  # copies, weights (v, nodes)
        chosen = facets_of(model.scene, model.partition, body, boundary)
        for local, (s, rows) in enumerate(zip(model.partition.subdomains, chosen, strict=True)):
            if len(rows) == 0:
                continue
            facets = s.reference.facets[rows]
            nodes = starts[local] + np.searchsorted(surface.local[local], facets)
            key = (id(s.reference), rows.tobytes())
            if key not in cache:
                cache[key] = _shares(s.reference, rows, d)
            share = cache[key]
            np.add.at(shares, nodes, share)
            self._points[nodes] = s.points()[facets]
            weights = hats_at_nodes(d, facets.shape[1])[None] * share[:, None]
            np.add.at(areas, nodes[:, : weights.shape[1]], weights.sum(axis=2))
            self._parts.append((nodes, weights))
        self.shares = surface.sums(shares)
        self._areas = surface.sums(areas)

    def recovered(self, pressure: Array) -> Array:
        """The pressure at all nodes from forces over shares (owned,), nothing alternating in it."""
        surface = self._surface
        q = surface.copies(pressure)
        lines = Lines.of([nodes for nodes, _ in self._parts], self._points)
        folded = np.zeros((3, len(q)), bool)
        planes = on_planes(self._scene, self._points)
        for mirror, on in zip(self._scene.mirrors, planes, strict=True):
            folded[mirror.axis] = on
        off = alternation(lines, q, lambda values: surface.copies(surface.sums(values)), folded)
        part = surface.sums(off) / surface.sums(np.ones(len(q)))
        found = np.maximum(pressure - part, 0.0)
        every = np.stack([pressure, np.abs(part), found]) @ self.shares
        force, alternating, left = surface.exchange.comm.allreduce(every)
        if alternating > STRONG * force:
            return self.at_all_nodes(self.smoothed(pressure))
        return found * (force / left if left > 0.0 else 1.0)

    def smoothed(self, pressure: Array) -> Array:
        """Means about vertices of the pressure from forces over shares (owned,)."""
        copies = self._surface.copies(pressure)
        mean = self.about_vertices(copies)
        change = self.about_vertices(copies - self.extended(mean))
        taken, given = np.minimum(change, 0.0), np.maximum(change, 0.0)
        cut = np.maximum(taken, -mean)
        sums = self._surface.exchange.comm.allreduce(np.stack([taken, cut]) @ self._areas)
        return mean + cut + given * (sums[1] / sums[0] if sums[0] < 0.0 else 1.0)

    def about_vertices(self, copies: Array) -> Array:
        """P: means about the vertices of values at copies, (owned,); 0 elsewhere."""
        sums = np.zeros(len(copies))
        for nodes, weights in self._parts:
            np.add.at(
                sums, nodes[:, : weights.shape[1]], np.einsum("fjk,fk->fj", weights, copies[nodes])
            )
        total = self._surface.sums(sums)
        some = self._areas > 0.0
        return np.divide(total, self._areas, out=np.zeros(len(total)), where=some)

    def extended(self, values: Array) -> Array:
        """Values (owned,) at vertices, continued to the middles: at the copies of facets here."""
        copies = self._surface.copies(values)
        for nodes, _ in self._parts:
            between_vertices(nodes, copies)
        return copies

    def at_all_nodes(self, values: Array) -> Array:
        """Values (owned,) at vertices, continued to the middles, at their owners."""
        known = np.zeros(sum(map(len, self._surface.local)))
        for nodes, _ in self._parts:
            known[nodes] = 1.0
        found = self._surface.sums(np.where(known > 0.0, self.extended(values), 0.0))
        count = self._surface.sums(known)
        return np.divide(found, count, out=values.copy(), where=count > 0.0)


def _shares(reference: Reference, rows: NDArray[np.int32], dimension: int) -> Array:
    """∫ φ_k over each of some facets of a reference, (facets, nodes)."""
    return moments(reference.points[reference.facets[rows]], dimension).sum(axis=1)
