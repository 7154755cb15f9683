"""Contact pressure at the nodes of the surface, from the forces of contact rows.

The meaning of a multiplier depends on the rows. Between bodies, and for second-order tetrahedra at
obstacles, multipliers are mean pressures about a vertex times an area: p_j = λ_j / W_j. Multipliers
of rows at nodes are nodal forces f_k = ∫ p φ_k, and the pressure is the force over the node's share
of the boundary, q_k = f_k / ∫ φ_k.

For degree 2 this is not enough. Corners and middles have different shape functions, and if the
boundary is a polygon or the material nearly incompressible, q alternates between them about the
right mean on any mesh. `alternation` removes this part; the values are then as accurate as those of
degree 1 on as many nodes.

Near ν = 0.5 the alternation is a large part of the pressure, opens nodes that should be in contact,
and cannot be distinguished from the edge of the contact. Then the pressure is linear on each facet,
with the values at the vertices

    P q = Σ_k ψ_j(x_k) f_k / ∫ ψ_j,     ψ_j the linear shape function of vertex j:

the mean of the pressure about the vertex, in which alternations cancel. It flattens a smooth peak
by h²p''/12; the mean of the removed part is added again, p = P q + P(q - P q) (twicing, J. W.
Tukey, *Exploratory Data Analysis*, 1977, chapter 16), which leaves errors of fourth order.

Negative values of p are set to zero and the rest is scaled so that ∫ p is the force.
Constant pressures are exact, linear ones are inside the boundary. Beside a jump means about
vertices overshoot by at most 3 % of it; at the end of the boundary the last of them is off by a
ninth of the change over the last facet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.boundaries import boundary_nodes, facets_of
from contact_app.model.facets import between_vertices, hats_at_nodes
from contact_app.model.model import Model
from contact_app.model.planes import on_planes
from contact_app.results.alternation import Lines, alternation
from contact_app.results.covered_pressure import OnSide
from contact_app.results.division import ContactLoads, contact_loads
from contact_app.results.smoothed_pressure import smoothed_pressure
from contact_app.results.surface_nodes import SurfaceNodes, facet_shares
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from solver.contact.solution import Solution

Array = NDArray[np.float64]

STRONG = 0.05
"""Alternation over pressure, both in the mean, from which on averages about vertices are used."""


@dataclass(frozen=True, eq=False)
class NodesInContact:
    """One contact at the nodes of its boundary that this rank owns.

    Attributes
    ----------
    nodes : (n,)
        Ascending numbers.
    pressure, smoothed : (n,), (n,)
        Contact pressure, also averaged over facets (`smoothed_pressure`), force per area.
    shares : (n,)
        ∫ φ_k over the boundary.
    carriers : (n,)
        Mask of nodes at which the contact law is enforced: all nodes, or the vertices for rows on
        averages about vertices.
    closed : (n,)
        Mask of carriers with a contact force.
    areas : (n,)
        Area that the force at a closed node acts on; 0 at others.
    forces, moments : (n, 3)
        Force on the body of `on`, and its moment about the node.
    traction : (n, 3)
        Friction force per area on the body of `on`.
    slips : (n, 3)
        Slip of the body of `on` along the other side.
    sticks : (n,)
        Mask of sticking nodes.
    rubs : (n,)
        Mask of nodes with a friction force of a given limit: they may be open.
    """

    nodes: NDArray[np.int64]
    pressure: Array
    smoothed: Array
    shares: Array
    carriers: NDArray[np.bool_]
    closed: NDArray[np.bool_]
    areas: Array
    forces: Array
    moments: Array
    traction: Array
    slips: Array
    sticks: NDArray[np.bool_]
    rubs: NDArray[np.bool_]

    @property
    def status(self) -> NDArray[np.int64]:
        """0 where a node is open, 1 where it sticks, 2 where it slides, (n,).

        An open node with friction of a given limit also sticks or slides.
        """
        return np.where(self.closed | self.rubs, np.where(self.sticks, 1, 2), 0)


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Forces of obstacles and other bodies on the surface, at the nodes that this rank owns.

    Attributes
    ----------
    nodes : (owned,)
        Numbers of surface nodes.
    pressure, smoothed : (owned,), (owned,)
        The largest over the contacts of a node.
    contacts
        Each contact separately, in the order of `Scene.touching`.
    without_area
        Number of rows with a force at a node that is on no facet of the contact boundary.
    """

    nodes: NDArray[np.int64]
    pressure: Array
    smoothed: Array
    contacts: tuple[NodesInContact, ...]
    without_area: int

    @property
    def resultants(self) -> Array:
        """Force on the body of `on` of each contact, of this rank's nodes, (contacts, 3)."""
        return np.array([c.forces.sum(axis=0) for c in self.contacts]).reshape(-1, 3)


def contact_forces(model: Model, solution: Solution, surface: SurfaceNodes) -> ContactForces:
    """Pressures and forces of an answer, contact by contact (collective)."""
    loads = contact_loads(model, solution, surface)
    pressure, smoothed = np.zeros((2, len(surface.owned)))
    contacts, lost = [], 0
    for number in range(len(model.scene.touching)):
        in_contact, missed = _in_contact(model, surface, loads, number)
        at = np.searchsorted(surface.owned, in_contact.nodes)
        pressure[at] = np.maximum(pressure[at], in_contact.pressure)
        smoothed[at] = np.maximum(smoothed[at], in_contact.smoothed)
        contacts.append(in_contact)
        lost += missed
    return ContactForces(surface.owned, pressure, smoothed, tuple(contacts), lost)


def _in_contact(
    model: Model, surface: SurfaceNodes, loads: ContactLoads, number: int
) -> tuple[NodesInContact, int]:
    """One contact at its nodes, and the number of its rows with force but no area (collective)."""
    touching = model.scene.touching[number]
    body = model.scene.bodies[touching.body]
    at_nodes = isinstance(touching, Contact) and not has_averaged_rows(body)
    boundary = _Boundary(model, surface, touching)
    on = boundary.nodes(with_single=at_nodes)
    of_contact = np.flatnonzero(loads.sources == number)
    at = np.searchsorted(surface.owned, loads.nodes[of_contact])
    force, area = loads.force[of_contact], loads.areas[of_contact]
    area = np.where(np.isnan(area), boundary.shares[at], area)
    loaded = force > 0.0
    usable = loaded & (area > 0.0)

    def at_owned(rows: NDArray[np.bool_], values: Array) -> Array:
        result = np.zeros((len(surface.owned), *values.shape[1:]))
        result[at[rows]] = values
        return result

    every, wide = np.ones(len(of_contact), bool), area > 0.0
    pressure = at_owned(usable, force[usable] / area[usable])
    traction = at_owned(wide, loads.friction[of_contact][wide] / area[wide, None])
    covered = np.ones(len(on))
    if isinstance(touching, BodyContact):
        columns = np.column_stack([area, force, loads.friction[of_contact]])
        quotients = np.column_stack([pressure, traction])
        rows = loads.rows.of(loads.sources == number)
        side = boundary.side(body.degree)
        means = side.with_means(rows, columns, quotients)
        pressure, traction = means[:, 0], means[:, 1:]
        covered = side.share_of(at_owned(every, area))
    if body.degree == 2:
        pressure = boundary.recovered(pressure) if at_nodes else boundary.at_all_nodes(pressure)
    if body.degree == 2 and not at_nodes:
        covered = boundary.at_all_nodes(covered)
        traction = np.stack([boundary.at_all_nodes(part) for part in traction.T], axis=1)
    carriers = on if at_nodes else boundary.areas > 0.0
    of_owned = NodesInContact(
        nodes=surface.owned,
        pressure=pressure,
        smoothed=np.zeros_like(pressure),
        shares=boundary.shares,
        carriers=carriers,
        closed=at_owned(loaded, force[loaded]) > 0.0,
        areas=at_owned(usable, area[usable]),
        forces=at_owned(every, loads.vectors[of_contact]),
        moments=at_owned(every, loads.moments[of_contact]),
        traction=traction,
        slips=at_owned(every, loads.slips[of_contact]),
        sticks=at_owned(every, loads.sticks[of_contact].astype(float)) > 0.0,
        rubs=at_owned(every, loads.rubs[of_contact].astype(float)) > 0.0,
    )
    nodes = NodesInContact(**{name: values[on] for name, values in of_owned.__dict__.items()})
    fitted = nodes.pressure, nodes.shares, covered[on]
    smoothed = smoothed_pressure(model, number, nodes.nodes, fitted)
    return replace(nodes, smoothed=smoothed), int((loaded & ~usable).sum())


def node_gaps(model: Model, solution: Solution, surface: SurfaceNodes, far: Array) -> Array:
    """Remaining distance at the owned surface nodes, (owned,); NaN without a row (collective).

    Distances at vertices only are interpolated to the middles between them.

    Parameters
    ----------
    far : (rows,)
        Distance along the omitted rows.
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
        of_contact = sources == i
        part = np.full(len(gap), np.nan)
        np.fmin.at(part, at[of_contact], distance[of_contact])
        at_nodes = model.comm.allreduce(int(np.isnan(areas[of_contact]).sum()))
        if scene.bodies[touching.body].degree == 2 and not at_nodes:
            boundary = _Boundary(model, surface, touching)
            part = boundary.at_all_nodes(part)
        gap = np.fmin(gap, part)
    return gap


def boundary_shares(
    model: Model, surface: SurfaceNodes, touching: Contact | BodyContact | RigidTie
) -> Array:
    """∫ φ_k over the boundary of a contact at the owned surface nodes, (owned,) (collective)."""
    chosen = facets_of(model.scene.bodies, model.partition, touching.body, touching.boundary)
    return surface.shares(model, chosen)


def side_of(
    model: Model, surface: SurfaceNodes, touching: BodyContact | Tie, degree: int
) -> OnSide:
    """The `on` side of a contact of two bodies or a tie (collective)."""
    return _Boundary(model, surface, touching).side(degree)


class _Boundary:
    """The facets of one contact, and averages over them; all methods are collective.

    Attributes
    ----------
    shares, areas : (owned,)
        ∫ φ_k over the boundary, and ∫ ψ_j of the hat functions of vertices.
    """

    def __init__(
        self, model: Model, surface: SurfaceNodes, touching: Contact | BodyContact | Tie
    ) -> None:
        self._model, self._surface, self._scene = model, surface, model.scene
        self._touching = touching
        copies = surface.starts[-1]
        shares, areas = np.zeros(copies), np.zeros(copies)
        self._points = np.zeros((copies, 3))
        self._parts: list[tuple[NDArray[np.int64], Array]] = []  # copies, weights (v, nodes)
        chosen = facets_of(model.scene.bodies, model.partition, touching.body, touching.boundary)
        for s, rows, nodes, share in facet_shares(model, surface, chosen):
            np.add.at(shares, nodes, share)
            self._points[nodes] = s.points()[s.reference.facets[rows]]
            weights = hats_at_nodes(model.scene.dimension, nodes.shape[1])[None] * share[:, None]
            np.add.at(areas, nodes[:, : weights.shape[1]], weights.sum(axis=2))
            self._parts.append((nodes, weights))
        self.shares = surface.sums(shares)
        self.areas = surface.sums(areas)

    def nodes(self, with_single: bool) -> NDArray[np.bool_]:
        """Mask (owned,) of the nodes on the boundary.

        Parameters
        ----------
        with_single
            Whether to include nodes that are on no whole facet of the boundary.
        """
        surface, partition = self._surface, self._model.partition
        marks = np.zeros(surface.starts[-1])
        for nodes, _ in self._parts:
            marks[nodes] = 1.0
        if with_single:
            body = self._scene.bodies[self._touching.body]
            for start, s, local in zip(
                surface.starts, partition.subdomains, surface.local, strict=False
            ):
                if s.body == self._touching.body:
                    chosen = boundary_nodes(s, body, self._touching.boundary)
                    marks[start + np.searchsorted(local, chosen)] = 1.0
        return surface.sums(marks) > 0.0

    def recovered(self, pressure: Array) -> Array:
        """The pressure at all nodes from forces over shares (owned,), without alternation."""
        surface = self._surface
        q = surface.copies(pressure)
        lines = Lines.of([nodes for nodes, _ in self._parts], self._points)
        folded = np.zeros((3, len(q)), bool)
        planes = on_planes(self._scene, self._points)
        for mirror, on in zip(self._scene.mirrors, planes, strict=True):
            if self._touching.source not in dict(mirror.partners):  # else it ends at the plane
                folded[mirror.axis] = on
        off = alternation(lines, q, lambda values: surface.copies(surface.sums(values)), folded)
        part = surface.sums(off) / surface.sums(np.ones(len(q)))
        recovered = np.maximum(pressure - part, 0.0)
        every = np.stack([pressure, np.abs(part), recovered]) @ self.shares
        force, alternating, left = surface.exchange.comm.allreduce(every)
        if alternating > STRONG * force:
            return self.at_all_nodes(self.smoothed(pressure))
        return recovered * (force / left if left > 0.0 else 1.0)

    def smoothed(self, pressure: Array) -> Array:
        """Means about vertices of the pressure from forces over shares (owned,)."""
        copies = self._surface.copies(pressure)
        mean = self.about_vertices(copies)
        change = self.about_vertices(copies - self.extended(mean))
        lowered, raised = np.minimum(change, 0.0), np.maximum(change, 0.0)
        cut = np.maximum(lowered, -mean)
        sums = self._surface.exchange.comm.allreduce(np.stack([lowered, cut]) @ self.areas)
        return mean + cut + raised * (sums[1] / sums[0] if sums[0] < 0.0 else 1.0)

    def side(self, degree: int) -> OnSide:
        """The facets, for pressures of facets that the other body covers in part."""
        surface, facets = self._surface, [nodes for nodes, _ in self._parts]
        return OnSide(
            degree, self._scene.dimension, facets, surface.owned, self.shares, surface.exchange,
            surface.sums, surface.copies,
        )  # fmt: skip

    def about_vertices(self, copies: Array) -> Array:
        """P: averages about the vertices of values at copies, (owned,); 0 elsewhere."""
        sums = np.zeros(len(copies))
        for nodes, weights in self._parts:
            np.add.at(
                sums, nodes[:, : weights.shape[1]], np.einsum("fjk,fk->fj", weights, copies[nodes])
            )
        total = self._surface.sums(sums)
        some = self.areas > 0.0
        return np.divide(total, self.areas, out=np.zeros(len(total)), where=some)

    def extended(self, values: Array) -> Array:
        """Values (owned,) at vertices, interpolated to the middles.

        At this rank's copies of facets.
        """
        copies = self._surface.copies(values)
        for nodes, _ in self._parts:
            between_vertices(nodes, copies)
        return copies

    def at_all_nodes(self, values: Array) -> Array:
        """Values (owned,) at vertices, interpolated to the middles, at their owners."""
        areas = np.zeros(sum(map(len, self._surface.local)))
        for nodes, _ in self._parts:
            areas[nodes] = 1.0
        summed = self._surface.sums(np.where(areas > 0.0, self.extended(values), 0.0))
        count = self._surface.sums(areas)
        return np.divide(summed, count, out=values.copy(), where=count > 0.0)
