"""Rigid bodies in the discrete problem: their unknowns, contact rows and subdomains.

A rigid body that is free in some component is a subdomain of Total FETI that is all kernel
(`solver.tfeti.subdomain.rigid`). Its unknowns are those of two nodes more: one moves by its
displacement t, the other by L θ, its rotation times a length of the scene, so that all have one
unit. With x a point that may touch it, n the normal out of it and r = x - c the arm from its
reference point, a contact row reads

    -n · u(x) + n · t + (r × n)/L · L θ ≤ g,

where g is the gap if t and θ are zero: the gap at the present place of the body, plus the row's
change of gap by the motion to that place. Held components go to the right-hand side.

A body that is held in all components is an obstacle at its prescribed place, and no part of the
problem.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from contact_app.errors import NoEquilibriumError
from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.conditions import rows_in_the_mean
from contact_app.model.geometry import Geometry
from contact_app.model.rigid_room import HeldNodes, no_room
from contact_app.model.surface_copies import SurfaceCopies
from contact_app.scene.conditions import Contact
from contact_app.scene.rigid import RigidBodies
from meshes import Partition
from meshes.arrays import Array, Ints, Mask
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import (
    ContactEntries,
    ContactRows,
    HeldRows,
    NodeConditions,
)
from solver.problem.constraints.merge import contact_rows, cut_held, tightest_of_each_node
from solver.problem.parts import NodePlaces
from solver.rigid_motions import MOTIONS
from solver.tfeti.build import CongruentSubdomains
from solver.tfeti.subdomain.rigid import zero_stiffness

NODES = 2
"""Number of nodes that represent a rigid body: one for its displacement, one for its rotation."""

FAINT = 1e-12
"""Coefficients that are rounding errors, over the largest that a row could have."""


@dataclass(frozen=True, eq=False)
class RigidUnknowns:
    """The unknowns of the moving rigid bodies of a scene."""

    bodies: RigidBodies
    """All rigid bodies of the scene."""
    elastic: int
    """Number of elastic bodies."""
    first: int
    """Number of their first node: they come after those of the meshes."""
    length: float
    """L."""

    @classmethod
    def of(cls, geometry: Geometry) -> "RigidUnknowns":
        """The unknowns of a scene with cut meshes."""
        return cls(geometry.rigid, len(geometry.bodies), geometry.partition.nodes, geometry.length)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.bodies.dimension

    @property
    def moving(self) -> tuple[int, ...]:
        """Numbers of the moving bodies among all rigid ones."""
        return self.bodies.moving

    @property
    def count(self) -> int:
        """Moving rigid bodies."""
        return len(self.moving)

    @property
    def size(self) -> int:
        """Unknowns of a body, with one that is always held in the plane."""
        return NODES * self.dimension

    @property
    def units(self) -> Array:
        """Factors that make components displacements: one, and L for rotations."""
        d = self.dimension
        return np.where(np.arange(MOTIONS[d]) < d, 1.0, self.length)

    def center(self, nth: int) -> Array:
        """Reference point of the nth moving body where it is placed, (3,)."""
        return self.placed_center(self.moving[nth])

    def placed_center(self, number: int) -> Array:
        """Reference point where a body is placed, (3,), by its number among all rigid ones."""
        placed = self.bodies.placements[number].displacement
        return self.drawn_center(number) + np.array(placed)

    def drawn_center(self, number: int) -> Array:
        """Reference point of a body in the scene file, (3,), by its number among all rigid ones."""
        return np.array(self.bodies.bodies[number].center)

    def placed(self, nth: int) -> Array:
        """Components by which the nth moving body is placed, as displacements."""
        placement = self.bodies.placements[self.moving[nth]]
        return placement.components(self.dimension) * self.units

    def held(self, number: int) -> tuple[Mask, Array]:
        """Held components of a body (mask) and their values, as displacements.

        By its number among all rigid ones.
        """
        held, values = self.bodies.held(number)
        return held, values * self.units

    def loads(self, nth: int) -> Array:
        """Force on the nth moving body, and its moment over L."""
        d, number = self.dimension, self.moving[nth]
        result = np.zeros(MOTIONS[d])
        for load in self.bodies.loads:
            if load.body == number:
                moment = load.moment if d == 3 else load.moment[2:]
                result += np.array([*load.force[:d], *moment]) / self.units
        return result

    def body_of(self, nodes: Ints) -> Ints:
        """Number of the moving body of each node."""
        return (nodes - self.first) // NODES

    def motion_of(self, nodes: Ints, component: Ints) -> Ints:
        """Component of the rigid motion (displacement, then rotation) of components of nodes."""
        return (nodes - self.first) % NODES * self.dimension + component


def exchange_with(surface: SurfaceCopies, partition: Partition, unknowns: int) -> NodeExchange:
    """Exchange between copies of surface nodes and, after them, the nodes of rigid bodies.

    The last rank has these. (Collective.)
    """
    comm, total, extra = partition.comm, partition.nodes, NODES * unknowns
    starts = total * np.arange(comm.size + 1, dtype=np.int64) // comm.size
    starts[-1] += extra
    nodes = surface.nodes
    if comm.rank == comm.size - 1:
        nodes = np.concatenate([nodes, total + np.arange(extra)])
    return NodeExchange(comm, nodes, total + extra, starts)


def subdomains_of_copies(surface: SurfaceCopies, partition: Partition, unknowns: int) -> Ints:
    """Number of the subdomain of each copy of `exchange_with`."""
    numbers = surface.subdomains
    if partition.comm.rank == partition.comm.size - 1:
        numbers = np.concatenate([numbers, partition.count + np.arange(NODES * unknowns) // NODES])
    return numbers


def moving_contacts(geometry: Geometry) -> Ints:
    """Numbers of the contacts with rigid bodies that are free in some component."""
    moving = geometry.rigid.moving
    numbers = [i for i, c in enumerate(geometry.contacts) if c.rigid in moving]
    return np.array(numbers, np.int64)


def moving_rows(
    geometry: Geometry, exchange: NodeExchange, conditions: NodeConditions, held: HeldRows
) -> tuple[ContactRows, ContactRows]:
    """Contact rows with moving rigid bodies, and those that a tighter one repeats (collective).

    Parameters
    ----------
    conditions
        Conditions at the nodes of these contacts.
    """
    unknowns, d, contacts = RigidUnknowns.of(geometry), geometry.dimension, geometry.contacts
    parts = [contact_rows(exchange, conditions)]
    for number in moving_contacts(geometry):
        contact = contacts[number]
        if has_averaged_rows(geometry.bodies[contact.body]):
            parts.append(rows_in_the_mean(geometry, exchange, contact, int(number)))
    rows = with_motions(ContactRows.join(parts), unknowns, contacts)
    rows = cut_held(exchange, rows, held, unknowns.length)
    of_body = np.array([-1 if c.rigid is None else c.rigid for c in contacts])
    keep = np.ones(len(rows.nodes), bool)
    for number in unknowns.moving:
        in_contact = of_body[rows.sources] == number
        direction = rows.normals[in_contact, :d]
        keep[in_contact] = tightest_of_each_node(
            rows.nodes[in_contact], direction, rows.gaps[in_contact]
        )
    keep &= tightest_on_motions(geometry, rows)
    return rows.of(keep), rows.of(~keep)


def tightest_on_motions(
    geometry: Geometry, rows: ContactRows, tied: ContactRows | None = None
) -> Mask:
    """Mask (rows,) of rows to keep: of parallel rows of rigid bodies alone, the tightest.

    No node moves there: a second closed row would have a gap that no force can change.
    Collective. Raises `NoEquilibriumError` if these rows leave a rigid body no room.

    Parameters
    ----------
    tied
        Tied rows, which may hold motions, too.
    """
    unknowns, comm = RigidUnknowns.of(geometry), geometry.comm
    count, alone = len(rows.nodes), rows_without_nodes(rows)
    local = motions_of_rows(rows, unknowns, alone)
    parts = comm.allgather(local)
    every, equal = HeldNodes.joined(parts), None
    if not len(every.gaps):
        return np.ones(count, bool)
    if tied is not None:
        holding = motions_of_rows(tied, unknowns, rows_without_nodes(tied))
        equal = HeldNodes.joined(comm.allgather(holding))
    crowded = no_room(every, unknowns.length, equal)
    if crowded is not None:
        names = [unknowns.bodies.bodies[unknowns.moving[k]].name for k in crowded.bodies]
        sources = [geometry.touching[k].source for k in crowded.sources]
        raise NoEquilibriumError(f"{geometry.source}: {crowded.message(names, sources)}")
    length = np.linalg.norm(every.vectors, axis=1)
    moves = length > 0.0
    length[~moves] = 1.0
    keys = np.round(every.vectors / length[:, None], 9)
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.reshape(-1)
    order = np.lexsort((every.gaps / length, group))
    first = order[np.concatenate([[True], np.diff(group[order]) > 0])]
    best = np.zeros(len(group), bool)
    best[first] = moves[first]
    start = sum(len(part.gaps) for part in parts[: comm.rank])
    result = np.ones(count, bool)
    result[alone] = best[start : start + len(local.gaps)]
    return result


def rows_without_nodes(rows: ContactRows) -> Mask:
    """Mask (rows,) of the rows without entries at nodes of elastic bodies."""
    return np.asarray(np.bincount(rows.entries.row, minlength=len(rows.nodes)) == 0)


def motions_of_rows(rows: ContactRows, unknowns: RigidUnknowns, alone: Mask) -> HeldNodes:
    """Chosen rows (mask) as rows on the motions of the rigid bodies."""
    count, entries = len(rows.nodes), rows.rigid
    body = np.zeros(count, np.int64)
    body[entries.row] = unknowns.body_of(entries.node)
    vectors = np.zeros((count, unknowns.count, unknowns.size))
    vectors[
        entries.row,
        unknowns.body_of(entries.node),
        unknowns.motion_of(entries.node, entries.component),
    ] = entries.value
    vectors = vectors.reshape(count, unknowns.count * unknowns.size)
    return HeldNodes(body[alone], rows.sources[alone], vectors[alone], rows.gaps[alone])


def with_motions(
    rows: ContactRows, unknowns: RigidUnknowns, contacts: Sequence[Contact]
) -> ContactRows:
    """Rows with the entries of the free components of the rigid bodies they are about."""
    d = unknowns.dimension
    values = np.zeros((len(rows.nodes), MOTIONS[d]))
    body, gaps = np.zeros(len(rows.nodes), np.int64), rows.gaps.copy()
    for nth, number in enumerate(unknowns.moving):
        about = [i for i, c in enumerate(contacts) if c.rigid == number]
        chosen = np.isin(rows.sources, about)
        of_body = _along(rows.of(chosen), unknowns, unknowns.placed_center(number))
        arm = rows.points[chosen] - unknowns.center(nth)
        longest = np.maximum(1.0, np.linalg.norm(arm, axis=1) / unknowns.length)
        of_body[np.abs(of_body) < FAINT * longest[:, None]] = 0.0
        of_body[:, unknowns.held(number)[0]] = 0.0
        body[chosen], values[chosen] = nth, of_body
        gaps[chosen] += of_body @ unknowns.placed(nth)
    return replace(rows, gaps=gaps, rigid=_entries(unknowns, rows, body, values))


def _entries(
    unknowns: RigidUnknowns, rows: ContactRows, body: Ints, values: Array
) -> ContactEntries:
    """Entries of rows for components (rows, components) of one moving body each, (rows,)."""
    row, component = np.nonzero(values)
    node, inside = np.divmod(component, unknowns.dimension)
    node += unknowns.first + NODES * body[row]
    return ContactEntries(row, node, rows.points[row], inside, values[row, component])


def with_body(
    rows: ContactRows, unknowns: RigidUnknowns, number: int, center: Array
) -> ContactRows:
    """Rows on nodes of elastic bodies, with entries for the motion of a rigid body about a point.

    The rows are those of displacements relative to the body, and count from where it is drawn: free
    components are entries, held ones gaps.
    """
    coefficients = _along(rows, unknowns, center)
    held, values = unknowns.held(number)
    gaps = rows.gaps - coefficients[:, held] @ values[held]
    if number not in unknowns.moving:
        return replace(rows, gaps=gaps)
    coefficients[:, held] = 0.0
    coefficients[np.abs(coefficients) < FAINT] = 0.0
    body = np.full(len(rows.nodes), unknowns.moving.index(number))
    return replace(rows, gaps=gaps, rigid=_entries(unknowns, rows, body, coefficients))


def slips_of_held(
    rows: ContactRows,
    unknowns: RigidUnknowns,
    contacts: Sequence[Contact],
    before: RigidBodies | None,
) -> Array:
    """Contribution of held components of rigid bodies to the gaps of tangential rows, (rows,).

    Of contact rows it is how much larger the gaps are now, with the sign changed.

    Parameters
    ----------
    before
        The rigid bodies under the loads before, None without; the rows are at the present places of
        bodies.
    """
    added = np.zeros(len(rows.nodes))
    for source, contact in enumerate(contacts):
        if contact.rigid is None:
            continue
        of_source = rows.sources == source
        held, values = unknowns.bodies.held(contact.rigid)
        earlier = 0.0 if before is None else np.asarray(before.held(contact.rigid)[1])
        moved = (np.asarray(values) - earlier) * unknowns.units
        along = _along(rows.of(of_source), unknowns, unknowns.placed_center(contact.rigid))
        added[of_source] = -along[:, held] @ moved[held]
    return added


def on_tied_bodies(
    rows: ContactRows, unknowns: RigidUnknowns, number: int, nodes: Ints
) -> ContactRows:
    """Contact rows with entries at nodes that are tied to a rigid body, with those of its motion.

    Parameters
    ----------
    number
        Of the rigid body.
    nodes
        The tied nodes of all ranks.
    """
    d, entries = unknowns.dimension, rows.entries
    tied = np.isin(entries.node, nodes)
    others = np.bincount(entries.row[~tied], minlength=len(rows.nodes)) > 0
    tied &= ~others[entries.row]
    moved = entries.some(tied)
    center = unknowns.drawn_center(number)
    values = np.zeros((len(rows.nodes), MOTIONS[d]))
    force = np.zeros((len(moved.row), 3))
    force[np.arange(len(moved.row)), moved.component] = moved.value
    turn = np.cross(moved.points - center, force)
    each = np.concatenate([force[:, :d], turn if d == 3 else turn[:, 2:]], axis=1)
    np.add.at(values, moved.row, each / unknowns.units)
    held, prescribed = unknowns.held(number)
    gaps = rows.gaps - values[:, held] @ prescribed[held]
    values[:, held] = 0.0
    values[np.abs(values) < FAINT] = 0.0
    body = np.full(len(rows.nodes), unknowns.moving.index(number))
    both = [rows.rigid, _entries(unknowns, rows, body, values)]
    return replace(
        rows,
        gaps=gaps,
        entries=entries.some(~tied),
        rigid=ContactEntries.join(both, [0, 0]),
        replaced=ContactEntries.join([rows.replaced, moved], [0, 0]),
    )


def _along(rows: ContactRows, unknowns: RigidUnknowns, center: Array) -> Array:
    """Coefficients of rows for each component of a motion about a point, (rows, components)."""
    d = unknowns.dimension
    force = np.zeros((len(rows.nodes), 3))
    force[:, :d] = rows.normals
    turn = np.cross(rows.points - center, force) + rows.moments
    in_space = np.concatenate([rows.normals, turn if d == 3 else turn[:, 2:]], axis=1)
    return np.asarray(in_space / unknowns.units)


def rigid_subdomains(
    unknowns: RigidUnknowns, surface: SurfaceCopies, partition: Partition
) -> list[CongruentSubdomains]:
    """The moving rigid bodies as subdomains of this rank: all of them on the last one."""
    if partition.comm.rank < partition.comm.size - 1:
        return []
    size, subdomains = unknowns.size, []
    for nth in range(unknowns.count):
        held, values = unknowns.held(unknowns.moving[nth])
        free = np.zeros(size, bool)
        free[: len(held)] = ~held
        force, lifting = np.zeros((2, size, 1))
        force[: len(held), 0], lifting[: len(held), 0] = unknowns.loads(nth), values
        start = len(surface.nodes) + NODES * nth
        numbers = unknowns.first + NODES * nth + np.arange(NODES)
        points = np.tile(unknowns.center(nth), (NODES, 1))
        subdomains.append(
            CongruentSubdomains(
                stiffness=zero_stiffness(size),
                points=points,
                nodes=np.arange(NODES),
                copies=start + np.arange(NODES)[None],
                forces=np.asfortranarray(force),
                lifting=np.asfortranarray(lifting),
                eliminated=np.flatnonzero(~free),
                bodies=np.array([unknowns.elastic + nth]),
                places=NodePlaces(numbers[None], np.zeros((1, 3)), points),
            )
        )
    return subdomains
