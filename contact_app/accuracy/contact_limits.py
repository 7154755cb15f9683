"""Tests whether contact boundaries are too small, or their facets too coarse, for the answer.

Surface nodes next to a contact boundary may enter an obstacle, because nothing stops them: the
boundary is too small. And if the pressure varies by its own size within single facets, it depends
on the mesh. Over facets T of size h, with p at their nodes,

    Σ |T| (max p - min p) / Σ |T| mean p

is about 8/(π n) for Hertz's half ellipse on n lines and 6/n for his ellipsoid on quadrilaterals,
n across the contact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.averaged_rows import GapAndNormal, has_averaged_rows
from contact_app.model.boundaries import boundary_nodes, surface_facets
from contact_app.model.facets import moments, shapes_on_lattice
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from contact_app.results.percent import percent
from contact_app.results.rigid import placements_of
from contact_app.results.smoothed_pressure import symmetry_planes
from contact_app.scene.conditions import Contact, RigidTie
from contact_app.scene.rigid import Placement
from meshes.arrays import Array
from meshes.quadratic import FACETS
from solver.contact.solution import Solution


@dataclass(frozen=True)
class ContactLimits:
    """Limits of the warnings on contacts."""

    entered: float = 0.01
    """Depth of nodes next to a contact in an obstacle, over the displacement, that causes a
    warning."""
    between: float = 0.1
    """Depth of a round obstacle between nodes, over the largest displacement, from which on a
    warning follows. Under Hertz's ball on facets of size h it is h²/(8a²) of the approach, a the
    radius of contact."""
    flat: float = 1e-9
    """Thickness of a boundary, over its size, up to which it counts as flat."""
    unpressed_depth: float = 0.01
    """Limit for that depth in runs to an accuracy if the obstacle presses no node. Without a force,
    the depth alone decides."""
    concentrated: Mapping[int, float] = field(default_factory=lambda: {2: 1, 3: 3})
    """Number of nodes in contact, by dimension, up to which their force counts as concentrated."""
    facets_across: Mapping[int, float] = field(default_factory=lambda: {2: 8.0 / np.pi, 3: 6.0})
    """Facets across a contact times the variation of its pressure within them."""
    fewest_facets: float = 3.005
    """Facets across a contact below which its pressure is that of the mesh, and even their number
    is uncertain: one facet whose four vertices press alike counts as 3, with a peak 70 % too low;
    with 2.6 across Hertz's ellipse of a ball between grooves the largest is 80 % too high."""
    long: float = 2.5
    """Largest `PressedFacets.across` over the number of facets across the narrow side of an
    ellipse: 3π/4 if it is very long."""
    enough_facets: float = 6.0
    """Facets across the narrow side of a contact from which on its largest pressure is not warned
    of: it is within 4 % of Hertz's."""
    peak_error: float = 0.33
    order: float = 2.6
    """Largest error of the largest smoothed pressure of Hertz's contact with three facets across,
    and the power of their number with which it falls: of balls and rollers at random positions on
    meshes of all kinds of cells, and of half and quarter models of degree 1, none had a larger one
    (`python -m contact_app.studies.peak_draws --seed 11`, also `--half`). The worst is a ball above
    the middle of a hexahedron's facet, 21 % too low with 3.5 facets counted."""
    reaches: float = 1e-6
    """Distance of a contact from a plane of symmetry, over its size, up to which it reaches it."""


LIMITS = ContactLimits()


def entered_beside(model: Model, solution: Solution, number: int, other: int) -> tuple[int, float]:
    """Number of surface nodes of a body that enter the obstacle of a contact, and their depth.

    They were outside before, where the scene draws a rigid body, and enter it where the answer has
    it. Nodes that subdomains share are counted once for each. A plane on a boundary that an
    expression picks ends with it: a punch (collective).

    Parameters
    ----------
    other
        The body; nodes of its boundaries that the contact, or other contacts and ties with the same
        rigid body, name do not count.
    """
    scene, comm, d = model.scene, model.comm, model.scene.dimension
    contact, body, count, depth = scene.contacts[number], scene.bodies[other], 0, 0.0
    is_flat = contact.obstacle.curvature_radius is None
    if is_flat and contact.boundary in scene.bodies[contact.body].boundaries:
        return count, depth
    drawn, now = contact, contact
    named: list[Contact | RigidTie] = [contact]
    if contact.rigid is not None:
        named += [item for item in scene.contacts if item.rigid == contact.rigid]
        named += [tie for tie in scene.rigid_ties if tie.rigid == contact.rigid]
        as_drawn = [Placement()] * len(scene.rigid.bodies)
        drawn, now = (
            scene.placed(places).contacts[number]
            for places in (as_drawn, placements_of(model.geometry, model.problem, solution))
        )
    moved = solution.measures.deformations[[contact.body, other]].max()
    size = float(np.subtract(body.mesh.upper, body.mesh.lower).max())
    least = max(LIMITS.entered * moved, LIMITS.flat * size)
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        if s.body != other:
            continue
        mask = np.zeros(len(s.nodes), bool)
        mask[s.reference.facets[surface_facets(s, body)]] = True
        for item in named:
            if item.body == other:
                mask[boundary_nodes(s, body, item.boundary)] = False
        outside = np.flatnonzero(mask)
        if not len(outside):
            continue
        u = solution.displacements[cls][:, column].reshape(-1, d)[outside]
        gaps = drawn.gap_and_normal, now.gap_and_normal
        entered = entered_points(s.points()[outside], u, gaps, least)
        count, depth = count + entered[0], max(depth, entered[1])
    return int(comm.allreduce(count)), float(comm.allreduce(depth, op=MPI.MAX))


def entered_points(
    points: Array, moved: Array, gaps_and_normals: tuple[GapAndNormal, GapAndNormal], least: float
) -> tuple[int, float]:
    """Number of points that enter an obstacle by some depth at least, and the largest depth.

    Parameters
    ----------
    points, moved : (n, 3), (n, d)
        Places, where they are outside, and displacements.
    gaps_and_normals
        Of the obstacle as it was before, and as it is now.
    """
    as_before, as_now = gaps_and_normals
    try:
        gap, normal = as_now(points)
        before = gap if as_before == as_now else as_before(points)[0]
    except ConfigurationError:  # a node in the middle of a round obstacle has no normal
        return 0, 0.0
    entered = -(gap + np.einsum("ij,ij->i", normal[:, : moved.shape[1]], moved))
    entered = entered[(before >= 0.0) & (entered > least)]
    return len(entered), float(entered.max(initial=0.0))


def entered_between(model: Model, solution: Solution, number: int) -> float:
    """Depth to which an obstacle enters its contact boundary between the places of contact rows.

    Contact is tested at nodes, or in the mean about vertices. If the contact is narrower than a
    facet, a round obstacle can pass between nodes, and an edge of the body can pass any obstacle
    where the mean gap about the edge stays positive. On boundaries that are not flat the initial
    depth does not count, because straight facets approximate a round surface. The depth is a length
    (collective).
    """
    scene, comm, d = model.scene, model.comm, model.scene.dimension
    contact, depth = scene.contacts[number], 0.0
    averaged = has_averaged_rows(scene.bodies[contact.body])
    if contact.obstacle.curvature_radius is None and not averaged:
        return depth
    chosen = model.geometry.facets_of(contact.body, contact.boundary)
    for s, rows, (cls, column) in zip(model.partition.subdomains, chosen, model.place, strict=True):
        if len(rows) == 0:
            continue
        facets = s.reference.facets[rows]
        u = solution.displacements[cls][:, column].reshape(-1, d)
        depth = max(depth, depth_between(s.points()[facets], u[facets], contact.gap_and_normal))
    return float(comm.allreduce(depth, op=MPI.MAX))


def depth_between(points: Array, moved: Array, gap_and_normal: GapAndNormal) -> float:
    """Depth to which an obstacle enters facets between their nodes.

    Parameters
    ----------
    points, moved : (facets, nodes, 3), (facets, nodes, d)
        Places of the nodes, and their displacements.
    """
    d = moved.shape[2]
    shapes = shapes_on_lattice(d, points.shape[1])
    x, u = (
        np.tensordot(shapes, values, (1, 1)).reshape(-1, values.shape[2])
        for values in (points, moved)
    )
    try:
        gap, normal = gap_and_normal(x)
    except ConfigurationError:  # a point in the middle of a round obstacle has no normal
        return 0.0
    left = gap + np.einsum("ij,ij->i", normal[:, :d], u)
    counted = (gap >= 0.0) | _flat(points[..., :d])
    return float(-left[counted].min(initial=0.0))


def _flat(points: Array) -> bool:
    """Whether facets (n, nodes, d) lie in one plane across an axis."""
    size = np.ptp(points, axis=(0, 1))
    return bool(size.min() <= LIMITS.flat * size.max())


def coarse_contact(model: Model, solution: Solution, nodes: NodeFields) -> float:
    """Squared error in energy norm that coarse contact with obstacles adds (collective).

    An obstacle that enters by δ between the nodes of a contact with force F acts like an obstacle
    moved by δ. This changes the force by about F/n² for n facets across the contact, since the
    obstacle's surface falls by n² δ over it: the error is F δ/n². Where F is smaller than the force
    k δ that pushes the obstacle out of a facet of size h, it determines little, and k δ² is the
    error; k = π E/8 in the plane and E h in space. A contact of one or two nodes is a concentrated
    force, whose displacement depends on the mesh, F²/(2 k) (of the order of Flamant's and
    Boussinesq's solutions).
    """
    scene, problem, count = model.scene, model.problem, len(model.scene.contacts)
    force = np.maximum(solution.multiplier * problem.spread, 0.0)[problem.inequality]
    sources = problem.contact.sources
    forces = problem.comm.allreduce(np.bincount(sources, force, count)[:count])
    pressed = problem.comm.allreduce(np.bincount(sources[force > 0.0], minlength=count)[:count])
    loaded = pressed_facets(model, nodes)[:count]
    across = [facets.across(model.comm, model.scene.dimension) for facets in loaded]
    square = 0.0
    for number, contact in enumerate(scene.contacts):
        if forces[number] == 0.0:
            continue
        round_obstacle = contact.obstacle.curvature_radius is not None
        depth = entered_between(model, solution, number) if round_obstacle else 0.0
        young = scene.bodies[contact.body].softest
        width = np.pi / 8.0 if scene.dimension == 2 else _facet_size(model.geometry, contact)
        square += forces[number] * depth / max(across[number], 1.0) ** 2
        square += young * width * depth**2
        if pressed[number] <= LIMITS.concentrated[scene.dimension]:
            square += forces[number] ** 2 / (2.0 * young * width)
    return float(square)


def _facet_size(geometry: Geometry, contact: Contact) -> float:
    """Root of the mean area of the facets of a contact boundary (collective)."""
    chosen = geometry.facets_of(contact.body, contact.boundary)
    sums = np.zeros(2)
    for s, rows in zip(geometry.partition.subdomains, chosen, strict=True):
        if len(rows):
            points = s.points()[s.reference.facets[rows]]
            sums += [moments(points, geometry.dimension).sum(), len(rows)]
    area, facets = geometry.comm.allreduce(sums)
    return float(np.sqrt(area / facets))


def slipped_through(
    model: Model, solution: Solution, unpressed_depth: float = LIMITS.between
) -> list[str]:
    """Sentences on contacts whose obstacle passes between the nodes (collective).

    Parameters
    ----------
    unpressed_depth
        Depth over the largest displacement from which on an obstacle that presses no node causes a
        warning.
    """
    scene, problem, warnings = model.scene, model.problem, []
    pressed = problem.inequality.copy()
    pressed[problem.inequality] = solution.multiplier[problem.inequality] > 0.0
    sources = problem.contact.sources[pressed[problem.inequality]]
    pressed_nodes = problem.comm.allreduce(np.bincount(sources, minlength=len(scene.touching)))
    for number, contact in enumerate(scene.contacts):
        depth = entered_between(model, solution, number)
        moved = float(solution.measures.deformations[contact.body])
        if depth > (LIMITS.between if pressed_nodes[number] else unpressed_depth) * moved:
            body = scene.bodies[contact.body]
            text = between_nodes(depth, moved, body.name, has_averaged_rows(body))
            warnings.append(f"{contact.source}: {text}")
    return warnings


def between_nodes(depth: float, moved: float, name: str, averaged: bool) -> str:
    """Warning on an obstacle that enters a body by a depth, without the name of the contact.

    Parameters
    ----------
    averaged
        Whether contact rows are means about vertices.
    """
    share = "of a body that does not move"
    if moved > 0.0:
        share = f"{percent(depth / moved)} of the largest displacement"
    place, remedy = "between the nodes of", "smaller cells there"
    if averaged:
        place, remedy = "between the vertices of", "smaller cells there, or degree: 1"
    return (
        f"{place} {name} the obstacle enters by up to {depth:.2g}, "
        f"{share}: contact is narrower than a facet; use {remedy}"
    )


@dataclass(frozen=True, eq=False)
class PressedFacets:
    """This rank's facets of a contact with its pressure."""

    corners: Array  # (facets, vertices, 3)
    areas: Array  # (facets,)
    pressure: Array  # (facets, nodes of a facet)
    planes: Sequence[tuple[int, float]] = ()
    """Axis and place of planes of symmetry that the contact may reach."""

    def across(self, comm: MPI.Intracomm, dimension: int) -> float:
        """Approximate number of facets that carry the contact.

        ∞ without a pressure (collective).
        """
        p = self.pressure
        sums = self.areas @ np.stack([np.ptp(p, axis=1), p.mean(axis=1)], axis=1)
        varying, total = comm.allreduce(sums)
        return LIMITS.facets_across[dimension] * total / varying if varying > 0.0 else np.inf

    def across_narrow_side(self, comm: MPI.Intracomm, dimension: int) -> float:
        """Approximate number of facets across the narrow side of the contact.

        The length along an axis counts if the pressure varies as it does in so narrow an ellipse;
        a pressed end face may be two facets wide and its pressure constant (collective).
        """
        across = self.across(comm, dimension)
        if dimension == 2:
            return across
        narrow = min(self.along_axes(comm))
        return min(across, narrow) if across < LIMITS.long * narrow else across

    def along_axes(self, comm: MPI.Intracomm) -> tuple[float, ...]:
        """Approximate number of facets along each axis of a contact in space; ∞ without a pressure.

        Axes are the principal ones of the pressure's second moments; half the length of the
        contact along one is √5 times the root of its moment, as of Hertz's ellipsoid. It is
        in units of the mean extent of the loaded facets along the axis. A contact that a plane of
        symmetry cuts has the moments of the whole (collective).
        """
        forces = self.areas * self.pressure.mean(axis=1)
        return _along_axes(comm, self.corners, forces, self.planes_at_end(comm))

    def planes_at_end(self, comm: MPI.Intracomm) -> list[tuple[int, float]]:
        """The planes of symmetry at which the contact ends (collective)."""
        return [plane for plane in self.planes if self._ends_at(comm, *plane)]

    def _ends_at(self, comm: MPI.Intracomm, axis: int, place: float) -> bool:
        """Whether loaded facets lie on one side of a plane across an axis and reach it."""
        loaded = (self.pressure > 0.0).any(axis=1)
        off = self.corners[loaded, :, axis] - place
        ends = off.min(initial=np.inf), -off.max(initial=-np.inf)
        least, most = (comm.allreduce(float(end), op=MPI.MIN) for end in ends)
        near = LIMITS.reaches * max(abs(least), abs(most))
        return min(abs(least), abs(most)) <= near and np.isfinite(least)


def carries_force(comm: MPI.Intracomm, pressure: Array, shares: Array, least: float) -> bool:
    """Whether the force of a contact is larger than the solver's error (collective).

    Parameters
    ----------
    pressure, shares : (n,), (n,)
        At nodes of this rank, with the integrals of their shape functions.
    least
        Error of the force, the tolerance times the load of the body.
    """
    return bool(comm.allreduce(float(pressure @ shares)) > least)


def pressed_contacts(geometry: Geometry, solution: Solution, nodes: NodeFields) -> list[bool]:
    """Whether each contact of a scene carries a force above the solver's error (collective)."""
    loads = solution.tolerance * solution.measures.loads
    return [
        carries_force(geometry.comm, at_nodes.pressure, at_nodes.shares, loads[item.body])
        for item, at_nodes in zip(geometry.touching, nodes.contacts, strict=True)
    ]


def pressed_facets(model: Model, nodes: NodeFields) -> list[PressedFacets]:
    """The facets of each contact, obstacles first, then pairs (collective)."""
    scene, exchange = model.scene, model.node_exchange
    subdomains = model.partition.subdomains
    starts = np.cumsum([0, *(len(s.nodes) for s in subdomains)])
    facets_by_contact = []
    for number, (contact, at_nodes) in enumerate(zip(scene.touching, nodes.contacts, strict=True)):
        owned = np.zeros(len(nodes.points))
        owned[at_nodes.nodes - nodes.first] = at_nodes.pressure
        pressure = exchange.from_owners(owned[exchange.nodes - exchange.first])
        chosen = model.geometry.facets_of(contact.body, contact.boundary)
        planes = symmetry_planes(model.geometry, scene.displacements, number)
        places, at = [], []
        for start, s, rows in zip(starts, subdomains, chosen, strict=False):
            facets = s.reference.facets[rows]
            if len(facets):
                places.append(s.points()[facets])
                at.append(pressure[start + facets])
        if not places:
            empty = np.zeros((0, 4, 3)), np.zeros(0), np.zeros((0, scene.dimension))
            facets_by_contact.append(PressedFacets(*empty, planes))
            continue
        points = np.concatenate(places)
        areas = moments(points, scene.dimension).sum(axis=(1, 2))
        vertices = FACETS[scene.dimension, points.shape[1]].vertices
        corners = points[:, :vertices]
        facets_by_contact.append(PressedFacets(corners, areas, np.concatenate(at), planes))
    return facets_by_contact


def _along_axes(
    comm: MPI.Intracomm, corners: Array, forces: Array, planes: Sequence[tuple[int, float]]
) -> tuple[float, ...]:
    """Facets (facets, vertices, 3) with forces along the two longer principal axes (collective).

    Planes are those of mirror images of the facets.

    The extent of a quadrilateral is that of a parallelogram of the same second moments: one of
    equal sides has the same along all axes.
    """
    force = comm.allreduce(float(forces.sum()))
    if force <= 0.0:
        return (np.inf, np.inf)
    _, moment = middle_and_moments(comm, corners.mean(axis=1), forces, planes)
    squares, axes = np.linalg.eigh(moment)
    along = corners @ axes
    each = 2.0 * along.std(axis=1) if corners.shape[1] == 4 else np.ptp(along, axis=1)
    extents = comm.allreduce(forces @ each) / force
    lengths = 2.0 * np.sqrt(5.0 * np.maximum(squares[1:], 0.0))
    return tuple(
        float(v / e) if e > 0.0 else np.inf for v, e in zip(lengths, extents[1:], strict=True)
    )


def middle_and_moments(
    comm: MPI.Intracomm, points: Array, weights: Array, planes: Sequence[tuple[int, float]]
) -> tuple[Array, Array]:
    """Middle (3,) and mean second moments (3, 3) of points and their images (collective)."""
    *first, total = comm.allreduce(np.append(weights @ points, weights.sum()))
    middle = np.array(first) / total
    for axis, place in planes:
        middle[axis] = place
    away = points - middle
    moment = comm.allreduce(np.einsum("n,ni,nj->ij", weights, away, away)) / total
    for axis, _ in planes:  # products with the other axes cancel those of the image
        moment *= np.equal.outer(*2 * [np.arange(3) == axis])
    return middle, moment
