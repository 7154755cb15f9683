"""Contact pressures, forces and gaps of a scene at the nodes of its surface.

`contact_side` derives pressures from the forces of contact rows.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.boundaries import boundary_nodes
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.model.planes import on_planes
from contact_app.results.contact_side import ContactSide
from contact_app.results.division import ContactLoads, contact_loads
from contact_app.results.smoothed_pressure import smoothed_pressure, symmetry_planes
from contact_app.results.surface_nodes import SurfaceNodes, facet_shares
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from meshes.arrays import Array, Ints, Mask
from solver.contact.solution import Solution


@dataclass(frozen=True, eq=False)
class NodesInContact:
    """One contact at the nodes of its boundary that this rank owns."""

    nodes: Ints  # (n,)
    """Ascending numbers."""
    pressure: Array
    smoothed: Array
    """Contact pressure, also averaged over facets (`smoothed_pressure`), force per area. Shapes
    (n,), (n,)."""
    shares: Array  # (n,)
    """∫ φ_k over the boundary."""
    carriers: Mask  # (n,)
    """Mask of nodes at which the contact law is enforced: all nodes, or the vertices for rows on
    averages about vertices."""
    closed: Mask  # (n,)
    """Mask of carriers with a contact force."""
    areas: Array  # (n,)
    """Area that the force at a closed node acts on; 0 at others."""
    forces: Array
    moments: Array
    """Force on the body of `on`, and its moment about the node. Shape (n, 3)."""
    traction: Array  # (n, 3)
    """Friction force per area on the body of `on`."""
    slips: Array  # (n, 3)
    """Slip of the body of `on` along the other side."""
    sticks: Mask  # (n,)
    """Mask of sticking nodes."""
    rubs: Mask  # (n,)
    """Mask of nodes with a friction force of a given limit: they may be open."""

    @property
    def status(self) -> Ints:
        """0 where a node is open, 1 where it sticks, 2 where it slides, (n,).

        An open node with friction of a given limit also sticks or slides.
        """
        return np.where(self.closed | self.rubs, np.where(self.sticks, 1, 2), 0)


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Forces of obstacles and other bodies on the surface, at the nodes that this rank owns."""

    nodes: Ints  # (owned,)
    """Numbers of surface nodes."""
    pressure: Array
    smoothed: Array
    """The largest over the contacts of a node. Shapes (owned,), (owned,)."""
    contacts: tuple[NodesInContact, ...]
    """Each contact separately, in the order of `Scene.touching`."""
    without_area: int
    """Number of rows with a force at a node that is on no facet of the contact boundary."""

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
    geometry, touching = model.geometry, model.geometry.touching[number]
    body = geometry.bodies[touching.body]
    at_nodes = isinstance(touching, Contact) and not has_averaged_rows(body)
    side = side_of(geometry, surface, touching)
    on = _on_boundary(geometry, surface, touching, side) if at_nodes else side.facets_of_node > 0.0
    carriers = on if at_nodes else side.areas > 0.0
    between, folded = isinstance(touching, BodyContact), _folded(geometry, touching, side.points)
    of_owned, covered, lost = nodes_of_side(
        side, loads, number, (at_nodes, between, folded), carriers
    )
    nodes = NodesInContact(**{name: values[on] for name, values in vars(of_owned).items()})
    fitted = nodes.pressure, nodes.shares, covered[on]
    planes = symmetry_planes(geometry, model.scene.displacements, number)
    smoothed = smoothed_pressure(geometry, number, planes, nodes.nodes, fitted)
    return replace(nodes, smoothed=smoothed), lost


def nodes_of_side(
    side: ContactSide,
    loads: ContactLoads,
    number: int,
    law: tuple[bool, bool, Mask | None],
    carriers: Mask,
) -> tuple[NodesInContact, Array, int]:
    """One contact at all nodes that this rank owns, without a smoothed pressure (collective).

    Parameters
    ----------
    law
        `at_nodes`, `between` and `folded` of `ContactSide.pressures`.
    carriers : (owned,)
        Mask of nodes at which the contact law is enforced.

    Returns
    -------
    nodes, covered, lost
        The contact, the covered shares (owned,), and the number of its rows with force but no area.
    """
    chosen = loads.sources == number
    at = np.searchsorted(side.owned, loads.nodes[chosen])
    force, area = loads.force[chosen], loads.areas[chosen]
    area = np.where(np.isnan(area), side.shares[at], area)
    loaded, usable = force > 0.0, (force > 0.0) & (area > 0.0)

    def at_owned(values: NDArray[Any]) -> NDArray[Any]:
        result = np.zeros((len(side.owned), *values.shape[1:]), values.dtype)
        result[at] = values
        return result

    forces = np.column_stack([force, loads.friction[chosen]])
    pressure, traction, covered = side.pressures(loads.rows.of(chosen), area, forces, *law)
    nodes = NodesInContact(
        nodes=side.owned,
        pressure=pressure,
        smoothed=np.zeros_like(pressure),
        shares=side.shares,
        carriers=carriers,
        closed=at_owned(loaded),
        areas=at_owned(np.where(usable, area, 0.0)),
        forces=at_owned(loads.vectors[chosen]),
        moments=at_owned(loads.moments[chosen]),
        traction=traction,
        slips=at_owned(loads.slips[chosen]),
        sticks=at_owned(loads.sticks[chosen]),
        rubs=at_owned(loads.rubs[chosen]),
    )
    return nodes, covered, int((loaded & ~usable).sum())


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
    distance = -problem.jumps(solution.displacements)[rows]
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
            part = side_of(model.geometry, surface, touching).at_all_nodes(part)
        gap = np.fmin(gap, part)
    return gap


def boundary_shares(
    geometry: Geometry, surface: SurfaceNodes, touching: Contact | BodyContact | RigidTie
) -> Array:
    """∫ φ_k over the boundary of a contact at the owned surface nodes, (owned,) (collective)."""
    chosen = geometry.facets_of(touching.body, touching.boundary)
    return surface.shares(geometry.partition, chosen)


def side_of(
    geometry: Geometry, surface: SurfaceNodes, touching: Contact | BodyContact | Tie
) -> ContactSide:
    """The `on` side of a contact or of a tie of two bodies (collective)."""
    points, facets = np.zeros((surface.starts[-1], 3)), []
    chosen = geometry.facets_of(touching.body, touching.boundary)
    for s, rows, nodes, share in facet_shares(geometry.partition, surface, chosen):
        points[nodes] = s.points()[s.reference.facets[rows]]
        facets.append((nodes, share))
    return ContactSide(
        geometry.bodies[touching.body].degree, geometry.dimension, facets, points,
        surface.owned, surface.exchange, surface.sums, surface.copies,
    )  # fmt: skip


def _on_boundary(
    geometry: Geometry, surface: SurfaceNodes, touching: Contact | BodyContact, side: ContactSide
) -> Mask:
    """Mask (owned,) of the nodes on a boundary, with those on no whole facet of it (collective)."""
    body, marks = geometry.bodies[touching.body], np.zeros(surface.starts[-1])
    for start, s, local in zip(
        surface.starts, geometry.partition.subdomains, surface.local, strict=False
    ):
        if s.body == touching.body:
            chosen = boundary_nodes(s, body, touching.boundary)
            marks[start + np.searchsorted(local, chosen)] = 1.0
    return (side.facets_of_node > 0.0) | (surface.sums(marks) > 0.0)


def _folded(geometry: Geometry, touching: Contact | BodyContact, points: Array) -> Mask:
    """Mask (3, n) of points on planes of symmetry at which a boundary goes on in its image."""
    folded = np.zeros((3, len(points)), bool)
    planes = on_planes(geometry.bodies, geometry.mirrors, points)
    for mirror, on in zip(geometry.mirrors, planes, strict=True):
        if touching.source not in dict(mirror.partners):  # else it ends at the plane
            folded[mirror.axis] = on
    return folded
