"""From a scene to its dual problem: subdomains, loads, conditions at nodes, rows of B.

A body that is one subdomain and whose held nodes stop every rigid motion needs no gluing and no
coarse problem: its held unknowns are eliminated. Every other subdomain floats, as in Total FETI,
and its conditions are rows of B.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from hashlib import sha1

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import block_diag

from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError
from contact_app.machine.memory import give_back
from contact_app.machine.timings import Timings
from contact_app.model.assembly import Element
from contact_app.model.averaged_rows import averaged_rows, has_averaged_rows
from contact_app.model.candidates import Needed, estimated, reaches
from contact_app.model.decomposition import choose_split
from contact_app.model.far_obstacles import distant
from contact_app.model.pairs import gather_surface, of_what_is_solved, owned_rows
from contact_app.scene.scene import (
    Body,
    Contact,
    DisplacementCondition,
    Material,
    Pressure,
    Scene,
    Traction,
)
from meshes import Partition, Reference, Subdomain, decompose
from meshes.mortar import SurfacesApartError, mean_gaps
from solver.contact.equilibrium import BodyBalance, balance, by_body, holds
from solver.tfeti.bodies import bodies_of
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.coarse.gram import KernelRows
from solver.tfeti.coarse.row_patterns import Kind, kinds_of
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.matrix import ConstraintMatrix
from solver.tfeti.constraints.nodal import nodal_rows
from solver.tfeti.constraints.rows import (
    ContactRows,
    ContradictionError,
    HeldRows,
    NodeConditions,
    RowKind,
    Rows,
    cut_held,
    drop_parallel,
    merge_contact,
    merge_held,
    write_rows,
)
from solver.tfeti.dual import DualProblem
from solver.tfeti.subdomain.classes import subdomain_class
from solver.tfeti.subdomain.kernels import (
    MOTIONS,
    fixing_nodes,
    rigid_motions,
)


@dataclass(frozen=True, eq=False)
class Model:
    """A scene made ready to solve.

    Attributes
    ----------
    place : (subdomains, 2)
        Class and column of each subdomain of this rank: where its vectors are.
    elements
        Finite-element forms of each class, for stresses and areas.
    materials
        Materials of each class, by the tags of its cells.
    exchange
        Where the copies of surface nodes meet; `copies` gives their subdomain and local node.
    needed, left_out
        Which of this rank's candidate rows are contact rows, and the others, which the answer is
        held against.
    merged
        Rows that a tighter one of the same node in the same direction makes redundant.
    reach
        How far the nodes of each contact may come nearer, (contacts,).
    notes
        Sentences on what was left out or added, for `check`, the log and the certificate.
    """

    scene: Scene
    partition: Partition
    problem: DualProblem
    place: NDArray[np.int64]
    elements: tuple[Element, ...]
    materials: tuple[tuple[Material, ...], ...]
    needed: NDArray[np.bool_]
    left_out: ContactRows
    merged: ContactRows
    reach: NDArray[np.float64]
    notes: tuple[str, ...] = field(default=())

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.partition.comm

    @cached_property
    def dofs(self) -> int:
        """Undecomposed degrees of freedom, held ones included."""
        return self.partition.nodes * self.scene.dimension

    @cached_property
    def node_exchange(self) -> NodeExchange:
        """Exchange of all nodes (not only surface nodes) with their owners."""
        nodes = [s.nodes for s in self.partition.subdomains]
        return NodeExchange(self.comm, np.concatenate(nodes), self.partition.nodes)


def partition_scene(scene: Scene, comm: MPI.Intracomm) -> Partition:
    """Cut the scene's bodies into subdomains.

    Raises
    ------
    ConfigurationError
        The decomposition asked for is impossible.
    """
    try:
        shapes = [body.mesh.shape(body.degree) for body in scene.bodies]
        choose = partial(choose_split, alone=len(shapes) == 1)
        return decompose(shapes, scene.decomposition.subdomains, comm, choose)
    except ValueError as error:
        raise ConfigurationError(f"{scene.at('decomposition')}: {error}") from error


@dataclass(frozen=True, eq=False)
class Outline:
    """What is known of a model before anything is assembled into matrices or factored.

    Attributes
    ----------
    held, contact
        Held nodes and contact rows this rank owns.
    needed, left_out
        Which of this rank's candidate rows `contact` holds, and the others.
    merged
        Rows that are redundant beside a candidate row of the same node.
    reach
        How far the nodes of each contact may come nearer, (contacts,).
    elements
        Finite-element forms by the identity of their reference.
    loads
        Load vector of each subdomain of this rank, None where nothing acts.
    balances
        What holds each body.
    """

    partition: Partition
    surface: _Surface
    exchange: NodeExchange
    held: HeldRows
    contact: ContactRows
    needed: NDArray[np.bool_]
    left_out: ContactRows
    merged: ContactRows
    reach: NDArray[np.float64]
    elements: dict[int, Element]
    loads: list[NDArray[np.float64] | None]
    balances: list[BodyBalance]

    @property
    def candidates(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Gaps and contacts of all candidate rows of this rank, within reach and not."""
        parts = (self.contact, self.left_out)
        gaps, sources = (
            np.concatenate([getattr(p, n) for p in parts]) for n in ("gaps", "sources")
        )
        return gaps, sources

    @property
    def eliminated(self) -> NDArray[np.bool_]:
        """Bodies that are one held subdomain: no gluing, no coarse problem, (bodies,)."""
        whole = np.array([n == 1 for n in self.partition.subdomains_of_body])
        return whole & np.array([b.held for b in self.balances])


Tell = Callable[[Scene, Outline], None]


def outline(
    scene: Scene, comm: MPI.Intracomm, timings: Timings | None = None, needed: Needed = "all"
) -> Outline:
    """Cut into subdomains, find conditions, loads and what balances them (collective).

    Parameters
    ----------
    timings
        Where the time of each stage is added.
    needed
        Candidate rows that become contact rows; if not all, whoever solves has to hold the answer
        against the others.

    Raises
    ------
    NoEquilibriumError
        A body leaves, or conditions on a node exclude each other.
    ConfigurationError
        The decomposition is impossible or a boundary is empty.
    """
    timings = timings or Timings()
    with timings.measure("setup"):
        partition = partition_scene(scene, comm)
    surface = _Surface(partition)
    with _agreed(comm):
        conditions = _conditions(scene, partition)
    _refuse_empty(scene, partition, conditions)
    length = max(float(np.ptp([b.mesh.lower, b.mesh.upper], axis=0).max()) for b in scene.bodies)
    exchange = NodeExchange(comm, surface.nodes, partition.nodes)
    try:
        held = merge_held(exchange, conditions)
        contact, merged = merge_contact(exchange, conditions, held, length)
        pairs = [_pair_rows(scene, partition, exchange, i) for i in range(len(scene.pairs))]
        averaged = [
            _averaged_rows(scene, partition, exchange, i)
            for i, c in enumerate(scene.contacts)
            if has_averaged_rows(scene.bodies[c.body])
        ]
        pairs = [cut_held(exchange, rows, held, length) for rows in pairs]
        averaged = [cut_held(exchange, rows, held, length) for rows in averaged]
        contact = ContactRows.join([contact, *averaged, *pairs])
        if averaged or pairs:
            contact, redundant = drop_parallel(exchange, contact, length)
            merged = ContactRows.join([merged, redundant])
    except ContradictionError as error:
        raise _contradiction(scene, error) from error

    elements: dict[int, Element] = {}
    for subdomain in partition.subdomains:
        reference = subdomain.reference
        if id(reference) not in elements:
            elements[id(reference)] = Element(reference, scene.dimension)
    with timings.measure("assembly"):
        loads = _loads(scene, partition, elements)
    balances = _balances(scene, partition, held, contact, loads)
    reach = np.full(len(scene.touching), np.inf)
    if not isinstance(needed, str) or needed == "estimated":
        reach = _reach(scene, partition, contact, loads, balances)
    if isinstance(needed, str):
        all_rows = np.ones(len(contact.nodes), bool)
        needed = all_rows if needed == "all" else estimated(contact, reach)
    return Outline(
        partition, surface, exchange, held, contact.of(needed), needed, contact.of(~needed),
        merged, reach, elements, loads, balances,
    )  # fmt: skip


def build_model(
    scene: Scene,
    comm: MPI.Intracomm,
    timings: Timings | None = None,
    needed: Needed = "all",
    tell: Tell | None = None,
) -> Model:
    """Mesh, assemble, write the constraints, factor; parameters and errors of `outline`.

    Parameters
    ----------
    tell
        Called with the scene and its outline before anything is assembled (collective).
    """
    timings = timings or Timings()
    with timings.measure("setup"):
        known = outline(scene, comm, timings, needed)
        if tell is not None:
            tell(scene, known)
        return _built(scene, comm, timings, known)


def _built(scene: Scene, comm: MPI.Intracomm, timings: Timings, known: Outline) -> Model:
    """The model; all but assembly and factorization is set-up."""
    partition, surface, exchange = known.partition, known.surface, known.exchange
    held, contact, elements, loads = known.held, known.contact, known.elements, known.loads
    balances, eliminated = known.balances, known.eliminated
    body_of_held = np.searchsorted(partition.first_node, held.nodes, side="right") - 1
    rows, contact = write_rows(
        exchange, surface.subdomains, held, contact, eliminated[body_of_held]
    )
    supports = _supports(scene, partition, surface, balances)
    lifting = _lifting(partition, surface, exchange, held, eliminated)

    problem, place, keys = _dual_problem(
        scene, partition, surface, exchange, rows, contact, supports, loads, lifting, elements,
        all(b.held for b in balances), timings,
    )  # fmt: skip
    notes = [f"{body.name}: {note}" for body in scene.bodies for note in body.mesh.notes]
    for body, found in zip(scene.bodies, balances, strict=True):
        if found.free_motions.shape[1]:
            freely = _directions(_upward(found.free_motions))
            notes.append(
                f"{body.name} can move freely along {freely} and no load works on that motion: it "
                "is held where it is"
            )
    if not eliminated.all():
        floating = int((~eliminated).sum())
        notes.append(
            f"Total FETI: {partition.count} subdomains, {floating} of {len(eliminated)} bodies "
            "with a coarse problem of rigid motions"
        )
    else:
        notes.append("every body is one held subdomain: no gluing, no coarse problem")
    if not comm.allreduce(int((problem.kinds == RowKind.CONTACT).sum())):
        notes.append("no contact rows: plain conjugate gradients")
    give_back()
    return Model(
        scene=scene,
        partition=partition,
        problem=problem,
        place=place,
        elements=tuple(elements[key[0]] for key in keys),
        materials=tuple(key[1] for key in keys),
        needed=known.needed,
        left_out=known.left_out,
        merged=known.merged,
        reach=known.reach,
        notes=tuple(notes),
    )


def boundary_facets(subdomain: Subdomain, body: Body, boundary: str) -> NDArray[np.int32]:
    """Rows of the reference's facets on a boundary: those with all nodes on it."""
    if boundary not in body.boundaries:
        return subdomain.boundaries.get(boundary, np.zeros(0, np.int32))
    surface = surface_facets(subdomain, body)
    if len(surface) == 0:
        return surface
    inside = body.boundaries[boundary](subdomain.points())
    return surface[inside[subdomain.reference.facets[surface]].all(axis=1)]


def surface_facets(subdomain: Subdomain, body: Body) -> NDArray[np.int32]:
    """Rows of the reference's facets on the surface of a body, cuts of symmetry not among them."""
    cuts = [subdomain.boundaries[name] for name in body.cuts if name in subdomain.boundaries]
    return np.setdiff1d(subdomain.exterior, np.concatenate(cuts)) if cuts else subdomain.exterior


def facets_of(
    scene: Scene, partition: Partition, body: int, boundary: str
) -> list[NDArray[np.int32]]:
    """Rows of the reference's facets of each subdomain of this rank on a boundary of a body."""
    none = np.zeros(0, np.int32)
    return [
        boundary_facets(s, scene.bodies[body], boundary) if s.body == body else none
        for s in partition.subdomains
    ]


def boundary_nodes(subdomain: Subdomain, body: Body, boundary: str) -> NDArray[np.int64]:
    """Local surface nodes on a boundary."""
    facets = subdomain.reference.facets
    if boundary not in body.boundaries:
        return np.unique(facets[boundary_facets(subdomain, body, boundary)])
    nodes = np.unique(facets[surface_facets(subdomain, body)])
    if len(nodes) == 0:
        return nodes
    return nodes[body.boundaries[boundary](subdomain.points()[nodes])]


class _Surface:
    """Copies of surface nodes of this rank's subdomains, one after another."""

    def __init__(self, partition: Partition) -> None:
        self.local: list[NDArray[np.int64]] = []
        cache: dict[int, NDArray[np.int64]] = {}
        for s in partition.subdomains:
            key = id(s.reference)
            if key not in cache:
                cache[key] = np.unique(s.reference.facets).astype(np.int64)
            self.local.append(cache[key])
        self.starts = np.cumsum([0, *(len(n) for n in self.local)])
        parts = [s.nodes[local] for s, local in zip(partition.subdomains, self.local, strict=True)]
        self.nodes: NDArray[np.int64] = np.concatenate(parts)
        numbers = np.array([s.number for s in partition.subdomains], np.int64)
        self.subdomains = np.repeat(numbers, np.diff(self.starts))

    def copies(self, subdomain: int) -> slice:
        """Copies of one subdomain (local number)."""
        return slice(int(self.starts[subdomain]), int(self.starts[subdomain + 1]))


def _conditions(scene: Scene, partition: Partition) -> NodeConditions:
    """Held nodes and contact rows as this rank's subdomains see them."""
    d = scene.dimension
    held: list[tuple] = []
    touching: list[tuple] = []
    for s in partition.subdomains:
        body = scene.bodies[s.body]
        points = s.points()
        for i, condition in enumerate(scene.displacements):
            if condition.body != s.body:
                continue
            nodes = boundary_nodes(s, body, condition.boundary)
            mask = np.array([v is not None for v in condition.values])
            values = np.array([v or 0.0 for v in condition.values])
            shape = (len(nodes), d)
            held.append(
                (
                    s.nodes[nodes], points[nodes], np.broadcast_to(mask, shape),
                    np.broadcast_to(values, shape), np.full(len(nodes), i),
                )
            )  # fmt: skip
        for i, contact in enumerate(scene.contacts):
            if contact.body != s.body or has_averaged_rows(body):
                continue
            nodes = boundary_nodes(s, body, contact.boundary)
            if len(nodes) == 0:
                continue
            try:
                gap, normal = contact.obstacle.gap_and_normal(points[nodes])
            except ConfigurationError as error:
                raise ConfigurationError(f"{scene.at(contact.source)}.obstacle: {error}") from None
            touching.append(
                (s.nodes[nodes], points[nodes], -normal[:, :d], gap, np.full(len(nodes), i))
            )
    none = np.zeros(0, np.int64)
    held.append((none, np.zeros((0, 3)), np.zeros((0, d), bool), np.zeros((0, d)), none))
    touching.append((none, np.zeros((0, 3)), np.zeros((0, d)), np.zeros(0), none))
    joined = [[np.concatenate(c) for c in zip(*part, strict=True)] for part in (held, touching)]
    return NodeConditions(*joined[0], *joined[1])


def _averaged_rows(
    scene: Scene, partition: Partition, exchange: NodeExchange, number: int
) -> ContactRows:
    """Rows of a contact that is kept in the mean about vertices."""
    contact = scene.contacts[number]
    body = scene.bodies[contact.body]
    chosen = facets_of(scene, partition, contact.body, contact.boundary)
    if not partition.comm.allreduce(sum(map(len, chosen))):
        raise ConfigurationError(
            f"{scene.at(contact.source)}.on: no whole facet of the surface of {body.name} lies on "
            f"{contact.boundary}; contact of tetrahedra of degree 2 needs facets all of whose "
            "nodes are on it"
        )
    with _agreed(partition.comm):
        try:
            return averaged_rows(partition, exchange, chosen, contact.obstacle, number)
        except ConfigurationError as error:
            raise ConfigurationError(f"{scene.at(contact.source)}.obstacle: {error}") from None


def _pair_rows(
    scene: Scene, partition: Partition, exchange: NodeExchange, number: int
) -> ContactRows:
    """Mortar rows of a pair of bodies; the message names a side that has no facet."""
    pair = scene.pairs[number]
    sides = []
    for key, b, boundary in (
        ("on", pair.body, pair.boundary), ("against", pair.other, pair.other_boundary)
    ):  # fmt: skip
        body = scene.bodies[b]
        chosen = facets_of(scene, partition, b, boundary)
        side = gather_surface(scene, partition, chosen)
        if side is None:
            raise ConfigurationError(
                f"{scene.at(pair.source)}.{key}: no whole facet of the surface of {body.name} lies "
                f"on {boundary}; contact between bodies needs facets all of whose nodes are on it"
            )
        sides.append(side)
    try:
        found = mean_gaps(*sides)
    except SurfacesApartError as error:
        raise ConfigurationError(f"{scene.at(pair.source)}: {error}") from error
    if scene.mirrors:
        found = of_what_is_solved(scene, partition.nodes, found)
    return owned_rows(exchange, found, len(scene.contacts) + number)


@contextmanager
def _agreed(comm: MPI.Intracomm) -> Iterator[None]:
    """Raise a `ConfigurationError` of any rank on all ranks."""
    message = None
    try:
        yield
    except ConfigurationError as error:
        message = str(error)
    messages = [m for m in comm.allgather(message) if m]
    if messages:
        raise ConfigurationError(messages[0])


def _refuse_empty(scene: Scene, partition: Partition, conditions: NodeConditions) -> None:
    """Refuse conditions and contacts whose boundary has no node."""
    groups: tuple[tuple[Sequence[DisplacementCondition | Contact], NDArray[np.int64]], ...] = (
        (scene.displacements, conditions.held_source),
        (scene.contacts, conditions.contact_source),
    )
    for things, sources in groups:
        count = partition.comm.allreduce(np.bincount(sources, minlength=len(things)))
        for thing, nodes in zip(things, count, strict=False):
            if nodes == 0 and not (
                isinstance(thing, Contact) and has_averaged_rows(scene.bodies[thing.body])
            ):
                raise ConfigurationError(
                    f"{scene.at(thing.source)}.on: no node of the surface of "
                    f"{scene.bodies[thing.body].name} lies on {thing.boundary}; change the "
                    "boundary's `where` or the mesh"
                )


def _loads(
    scene: Scene, partition: Partition, elements: dict[int, Element]
) -> list[NDArray[np.float64] | None]:
    """Load vector of each subdomain of this rank, None where nothing acts."""
    facet_loads: tuple[Traction | Pressure, ...] = (*scene.tractions, *scene.pressures)
    found = np.zeros(len(facet_loads), bool)
    cache: dict[Hashable, NDArray[np.float64]] = {}
    loads: list[NDArray[np.float64] | None] = []
    for s in partition.subdomains:
        element = elements[id(s.reference)]
        parts = []
        for i, load in enumerate(facet_loads):
            if load.body != s.body:
                continue
            rows = boundary_facets(s, scene.bodies[s.body], load.boundary)
            if len(rows) == 0:
                continue
            found[i] = True
            key: Hashable = (id(s.reference), i, rows.tobytes())
            if key not in cache:
                if i < len(scene.tractions):
                    cache[key] = element.traction(rows, np.array(scene.tractions[i].vector))
                else:
                    pressure = scene.pressures[i - len(scene.tractions)].value
                    cache[key] = element.pressure(rows, pressure)
            parts.append(cache[key])
        for i, force in enumerate(scene.forces):
            if force.body == s.body:
                key = (id(s.reference), "force", i)
                if key not in cache:
                    cache[key] = element.body_force(np.array(force.vector))
                parts.append(cache[key])
        loads.append(np.sum(parts, axis=0) if parts else None)
    found = partition.comm.allreduce(found.astype(int)) > 0
    for load, some in zip(facet_loads, found, strict=True):
        if not some:
            raise ConfigurationError(
                f"{scene.at(load.source)}.on: no whole facet of the surface of "
                f"{scene.bodies[load.body].name} lies on {load.boundary}; a load needs facets all "
                "of whose nodes are on it"
            )
    return loads


def _balances(
    scene: Scene,
    partition: Partition,
    held: HeldRows,
    contact: ContactRows,
    loads: Iterable[NDArray[np.float64] | None],
) -> list[BodyBalance]:
    """What holds each body; raises where a load drives a body away."""
    d, comm = scene.dimension, partition.comm
    count = len(scene.bodies)
    work, scale = np.zeros((count, MOTIONS[d])), np.zeros(count)
    for s, load in zip(partition.subdomains, loads, strict=True):
        if load is not None:
            motions = rigid_motions(s.points(), d, *_frame(scene.bodies[s.body]))
            work[s.body] += load @ motions.reshape(len(load), -1)
            scale[s.body] += np.abs(load).sum()
    work, scale = comm.allreduce(work), comm.allreduce(scale)
    seen = _contact_motions(scene, partition, contact)
    balances: list[BodyBalance | None] = [None] * count
    for group in _groups_in_contact(scene):
        held_rows = []
        for b in group:
            first, last = partition.first_node[b], partition.first_node[b + 1]
            mine = (held.nodes >= first) & (held.nodes < last)
            motions = rigid_motions(held.points[mine], d, *_frame(scene.bodies[b]))
            held_rows.append(motions[held.held[mine]])
        columns = (group[:, None] * MOTIONS[d] + np.arange(MOTIONS[d])).ravel()
        contact_rows = seen[:, columns]
        contact_rows = contact_rows[np.diff(contact_rows.indptr) > 0].toarray()
        found = balance(
            comm, block_diag(*held_rows), contact_rows, work[group].ravel(),
            float(scale[group].sum()),
        )  # fmt: skip
        if found.escape is not None:
            hints = distant(scene, contact.gaps, contact.sources, comm)
            raise NoEquilibriumError(
                f"{scene.source}: the scene has no equilibrium: nothing stops "
                f"{_leaving(scene, group, found.escape)} under its loads"
                + "".join(f"\n  {hint}" for hint in hints)
            )
        shares = by_body(found.free_motions, MOTIONS[d])
        for b, rows, free in zip(group, held_rows, shares, strict=True):
            balances[b] = BodyBalance(free, None, held=holds(comm, rows))
    return [b for b in balances if b is not None]


def _reach(
    scene: Scene,
    partition: Partition,
    contact: ContactRows,
    loads: Iterable[NDArray[np.float64] | None],
    balances: list[BodyBalance],
) -> NDArray[np.float64]:
    """How far the nodes of each contact may come nearer, (contacts,) (collective)."""
    forces, overlaps = np.zeros(len(scene.bodies)), np.zeros(len(scene.touching))
    for s, load in zip(partition.subdomains, loads, strict=True):
        if load is not None:
            forces[s.body] += np.abs(load).sum()
    np.maximum.at(overlaps, contact.sources, -contact.gaps)
    forces = partition.comm.allreduce(forces)
    overlaps = np.max(partition.comm.allgather(overlaps), axis=0)
    held = np.array([b.held for b in balances])
    return reaches(scene, _groups_in_contact(scene), forces, held, overlaps)


def left_out_notes(scene: Scene, known: Outline) -> list[str]:
    """What is left out of the contacts, a sentence each (collective)."""
    comm, count = known.partition.comm, len(scene.touching)
    sources = known.left_out.sources
    far = known.left_out.gaps > known.reach[sources]
    numbers = [np.bincount(s, minlength=count) for s in (sources[far], sources[~far])]
    numbers.append(np.bincount(known.contact.sources, minlength=count))
    out, repeated, near = comm.allreduce(np.stack(numbers))
    held = "; the answer is held against them, and they get rows where it comes that far"
    notes = []
    for i, item in enumerate(scene.touching):
        of = f"of {out[i] + repeated[i] + near[i]:,} candidate nodes"
        if out[i]:
            notes.append(
                f"{item.source}: {out[i]:,} {of} are farther away than they can move "
                f"({known.reach[i]:.3g} at most, by an estimate) and have no row{held}"
            )
        if repeated[i]:
            notes.append(
                f"{item.source}: at {repeated[i]:,} {of} another contact is nearer in nearly the "
                f"same direction, and they have no row{held}"
            )
    return notes


def _group_numbers(scene: Scene) -> NDArray[np.int64]:
    """The group of each body, (bodies,): bodies that may touch, directly or through others."""
    count = len(scene.bodies)
    ends = np.array([(p.body, p.other) for p in scene.pairs]).reshape(-1, 2)
    graph = sparse.coo_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    return np.asarray(label, np.int64)


def _groups_in_contact(scene: Scene) -> list[NDArray[np.int64]]:
    """Bodies that may touch each other, directly or through others."""
    label = _group_numbers(scene)
    return [np.flatnonzero(label == k) for k in np.unique(label)]


def _contact_motions(scene: Scene, partition: Partition, contact: ContactRows) -> sparse.csr_matrix:
    """Contact rows applied to the rigid motions of each body, (rows, bodies · motions)."""
    d, entries = scene.dimension, contact.entries
    body = np.searchsorted(partition.first_node, entries.node, side="right") - 1
    values = np.zeros((len(entries.row), MOTIONS[d]))
    for b in np.unique(body):
        mine = np.flatnonzero(body == b)
        motions = rigid_motions(entries.points[mine], d, *_frame(scene.bodies[b]))
        values[mine] = motions[np.arange(len(mine)), entries.component[mine]]
    values *= entries.value[:, None]
    column = body[:, None] * MOTIONS[d] + np.arange(MOTIONS[d])
    row = np.broadcast_to(entries.row[:, None], column.shape)
    return sparse.csr_matrix(
        (values.ravel(), (row.ravel(), column.ravel())),
        shape=(len(contact.nodes), len(scene.bodies) * MOTIONS[d]),
    )


def _leaving(scene: Scene, group: NDArray[np.int64], escape: NDArray[np.float64]) -> str:
    """Which bodies of a group leave, and where to."""
    motions = escape.reshape(len(group), -1)
    size = np.abs(motions).max(axis=1)
    said = [
        f"{scene.bodies[b].name} from leaving along {_directions(motion[:, None])}"
        for b, motion, s in zip(group, motions, size, strict=True)
        if s > 1e-6 * size.max()
    ]
    return " and ".join(said)


def _frame(body: Body) -> tuple[NDArray[np.float64], float]:
    """Centre and length of a body, to which its rigid motions refer."""
    centre = np.zeros(3)
    lower, upper = np.array(body.mesh.lower), np.array(body.mesh.upper)
    centre[: len(lower)] = 0.5 * (lower + upper)
    return centre, float((upper - lower).max())


def _upward(motions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motions (motions, k) that go either way, with a sign of which the first part is positive."""
    large = np.abs(motions) > 1e-3 * np.abs(motions).max(axis=0)
    return motions * np.sign(motions[large.argmax(axis=0), np.arange(motions.shape[1])])


def _directions(motions: NDArray[np.float64]) -> str:
    """Rigid motions (motions, k) in words."""
    planar = len(motions) == 3
    names = ["x", "y", "a turn about z"] if planar else [
        "x", "y", "z", "a turn about x", "a turn about y", "a turn about z"
    ]  # fmt: skip
    words = []
    for motion in motions.T:
        motion = motion / np.abs(motion).max()
        if motion[np.argmax(np.abs(motion))] < 0 and motions.shape[1] > 1:
            motion = -motion
        terms = []
        for value, name in zip(motion, names, strict=True):
            if abs(value) > 1e-3:
                sign = "-" if value < 0 else "+"
                terms.append(f"{'' if abs(value) > 0.999 else f'{abs(value):.2g} '}{sign}{name}")
        words.append(" and ".join(terms).replace("+a turn", "a turn").replace("-a turn", "a turn"))
    return "; ".join(sorted(words))  # one order, so that equal remarks read alike


def _contradiction(scene: Scene, error: ContradictionError) -> ContactError:
    """Tell the user which conditions exclude each other."""
    if error.kind == "held twice":
        first, second = scene.displacements[error.first], scene.displacements[error.second]
        return ConfigurationError(
            f"{scene.at(first.source)} and {second.source} hold one node of "
            f"{scene.bodies[first.body].name} at displacements {abs(error.amount):.6g} apart"
        )
    contact = scene.touching[error.first]
    if error.kind == "squeezed":
        other = scene.touching[error.second].source
        return NoEquilibriumError(
            f"{scene.source}: the obstacles of {contact.source} and {other} leave a node of "
            f"{scene.bodies[contact.body].name} no room: they overlap by {error.amount:.6g} in "
            "the direction in which it can move, and no displacement satisfies both"
        )
    what = "the obstacle" if isinstance(contact, Contact) else "the other body"
    return NoEquilibriumError(
        f"{scene.source}: the displacement conditions on {scene.bodies[contact.body].name} push "
        f"held nodes into {what} of {contact.source}, by up to {error.amount:.6g}: no "
        "displacement satisfies both"
    )


@dataclass(frozen=True, eq=False)
class _Supports:
    """Extra rows that hold motions nothing else sees, on this rank: (copies, d) values a row."""

    copies: list[NDArray[np.int64]]
    values: list[NDArray[np.float64]]


def _supports(
    scene: Scene, partition: Partition, surface: _Surface, balances: list[BodyBalance]
) -> _Supports:
    """Rows that hold free motions at a few nodes of each body's first subdomain."""
    supports = _Supports([], [])
    firsts = np.cumsum([0, *partition.subdomains_of_body])[:-1]
    for local, s in enumerate(partition.subdomains):
        motions = balances[s.body].free_motions
        if s.number != firsts[s.body] or motions.shape[1] == 0:
            continue
        points = s.points()[surface.local[local]]
        chosen = fixing_nodes(points, scene.dimension)
        frame = _frame(scene.bodies[s.body])
        seen = rigid_motions(points[chosen], scene.dimension, *frame) @ motions
        basis = np.linalg.qr(seen.reshape(-1, motions.shape[1]))[0]
        for row in basis.T:
            supports.copies.append(surface.starts[local] + chosen)
            supports.values.append(row.reshape(len(chosen), -1))
    return supports


def _lifting(
    partition: Partition,
    surface: _Surface,
    exchange: NodeExchange,
    held: HeldRows,
    eliminated: NDArray[np.bool_],
) -> list[tuple[NDArray[np.int64], NDArray[np.float64]] | None]:
    """Eliminated unknowns of each subdomain and their displacements; None where it floats."""
    at = np.searchsorted(held.nodes, exchange.nodes)
    at = np.minimum(at, max(len(held.nodes) - 1, 0))
    if len(held.nodes):
        known = held.nodes[at] == exchange.nodes
        mask = held.held[at] & known[:, None]
        values = np.where(mask, held.values[at], 0.0)
    else:
        mask = np.zeros((len(exchange.nodes), held.held.shape[1]), bool)
        values = np.zeros(mask.shape)
    mask, values = exchange.from_owners(mask), exchange.from_owners(values)
    result: list[tuple[NDArray[np.int64], NDArray[np.float64]] | None] = []
    for local, s in enumerate(partition.subdomains):
        if not eliminated[s.body]:
            result.append(None)
            continue
        part = surface.copies(local)
        node, component = np.nonzero(mask[part])
        unknowns = surface.local[local][node] * mask.shape[1] + component
        order = np.argsort(unknowns)
        result.append((unknowns[order], values[part][node, component][order]))
    return result


def _dual_problem(
    scene: Scene,
    partition: Partition,
    surface: _Surface,
    exchange: NodeExchange,
    rows: Rows,
    contact: ContactRows,
    supports: _Supports,
    loads: list[NDArray[np.float64] | None],
    lifting: list[tuple[NDArray[np.int64], NDArray[np.float64]] | None],
    elements: dict[int, Element],
    held_without_contact: bool,
    timings: Timings,
) -> tuple[DualProblem, NDArray[np.int64], list[tuple]]:
    """Group subdomains into classes, number the interface, build B, G and the factors."""
    comm, d = partition.comm, scene.dimension
    touched = exchange.from_owners(rows.touched(len(exchange.nodes), d))
    for copies, values in zip(supports.copies, supports.values, strict=True):
        touched[copies] |= values != 0.0

    groups: dict[tuple, list[int]] = {}
    for local, s in enumerate(partition.subdomains):
        lifted = lifting[local]
        held_key = None if lifted is None else lifted[0].tobytes()
        key = (id(s.reference), scene.bodies[s.body].materials, held_key)
        groups.setdefault(key, []).append(local)

    place = np.empty((len(partition.subdomains), 2), np.int64)
    columns = np.full(touched.shape, -1, np.int64)
    classes, class_loads, class_lifts = [], [], []
    size, failed = 0, ""
    alike = _meshed_by_all(comm, [elements[key[0]].reference for key in groups])
    for number, (key, members) in enumerate(groups.items()):
        place[members, 0], place[members, 1] = number, np.arange(len(members))
        lifted, local_nodes = lifting[members[0]], surface.local[members[0]]
        touched_by_any = np.zeros((len(local_nodes), d), bool)
        for local in members:
            touched_by_any |= touched[surface.copies(local)]
        with timings.measure("assembly"):
            stiffness = elements[key[0]].stiffness(key[1], scene.plane)
        sharing = comm if alike[number] and _made_by_all(comm, stiffness, lifted) else None
        if sharing is not None:
            comm.Allreduce(MPI.IN_PLACE, touched_by_any, op=MPI.LOR)
        node, component = np.nonzero(touched_by_any)
        with timings.measure("factorization"):
            points = elements[key[0]].reference.points
            try:
                cls = subdomain_class(
                    stiffness, points, d, local_nodes[node] * d + component, len(members),
                    None if lifted is None else lifted[0], sharing,
                )  # fmt: skip
            except (ArithmeticError, ValueError) as error:  # of this rank: the others go on
                failed = failed or f"{error}"
                continue
        place_of = np.full(cls.unknowns, -1, np.int64)
        place_of[cls.interface] = np.arange(len(cls.interface))
        position = place_of[local_nodes[:, None] * d + np.arange(d)]
        for nth, local in enumerate(members):
            shifted = position + size + nth * len(cls.interface)
            columns[surface.copies(local)] = np.where(position >= 0, shifted, -1)
        size += len(cls.interface) * len(members)
        classes.append(cls)
        load = np.zeros((cls.unknowns, len(members)), order="F")
        lift = np.zeros_like(load)
        for nth, local in enumerate(members):
            if loads[local] is not None:
                load[:, nth] = loads[local]
            own = lifting[local]
            if own is not None:
                lift[own[0], nth] = own[1]
        class_loads.append(load)
        class_lifts.append(lift)

    for text in filter(None, comm.allgather(failed)):
        raise ArithmeticError(text)
    first_column = comm.exscan(size) or 0
    columns = np.where(columns >= 0, columns + first_column, -1)
    kernels = [(cls.members, cls.kernel[cls.interface]) for cls in classes]
    B, c, kinds, metric, repeated = _constraint_matrix(
        comm, exchange, rows, supports, columns, size, kernels
    )
    e = np.concatenate(
        [
            np.zeros(0),
            *((cls.kernel.T @ load).T.ravel() for cls, load in zip(classes, class_loads,
                                                                    strict=True)),
        ]
    )  # fmt: skip
    coarse = None
    if comm.allreduce(len(e)):
        with timings.measure("factorization"):
            coarse = CoarseProblem(B, kernels, kinds == RowKind.CONTACT, metric, repeated)
    members_of = [
        np.array([partition.subdomains[local].body for local in members], np.int64)
        for members in groups.values()
    ]
    widths = [len(cls.interface) for cls in classes]
    bodies = bodies_of(comm, B, _group_numbers(scene), members_of, widths)
    wide = np.zeros(len(kinds), bool)
    wide[kinds == RowKind.CONTACT] = contact.wide
    problem = DualProblem(
        comm=comm,
        dimension=d,
        classes=tuple(classes),
        B=B,
        c=c,
        kinds=kinds,
        contact=contact,
        wide=wide,
        forces=tuple(class_loads),
        lifting=tuple(class_lifts),
        coarse=coarse,
        e=e,
        held_without_contact=held_without_contact,
        bodies=bodies,
    )
    return problem, place, list(groups)


def _meshed_by_all(comm: MPI.Intracomm, references: Sequence[Reference]) -> list[bool]:
    """Which of this rank's meshes all ranks hold in the same place of their lists."""
    if comm.size == 1:
        return [False] * len(references)
    mine = [sha1(r.points.tobytes(), usedforsecurity=False).digest() for r in references]
    of_ranks = comm.allgather(mine)
    shortest = min(map(len, of_ranks))
    same = [len(set(places)) == 1 for places in zip(*of_ranks, strict=False)]
    return same + [False] * (len(references) - shortest)


def _made_by_all(
    comm: MPI.Intracomm,
    stiffness: sparse.csr_matrix,
    lifted: tuple[NDArray[np.int64], NDArray[np.float64]] | None,
) -> bool:
    """Whether all ranks hold this stiffness, to the last bit, as the class they make now."""
    digest = sha1(usedforsecurity=False)
    for array in (stiffness.indptr, stiffness.indices, stiffness.data):
        digest.update(np.ascontiguousarray(array).data)
    if lifted is not None:
        digest.update(lifted[0].tobytes())
    return len(set(comm.allgather(digest.digest()))) == 1


def _constraint_matrix(
    comm: MPI.Intracomm,
    exchange: NodeExchange,
    rows: Rows,
    supports: _Supports,
    columns: NDArray[np.int64],
    size: int,
    kernels: Sequence[tuple[int, NDArray[np.float64]]],
) -> tuple[
    ConstraintMatrix, NDArray[np.float64], NDArray[np.int8], NDArray[np.float64], list[Kind]
]:
    """B on interface columns, its right-hand side, the kind and weight of each row; what repeats.

    Parameters
    ----------
    kernels : one (members, (m, k) array) pair a class
        Rigid motions on the class's interface.
    """
    d = columns.shape[1]
    row, column, value = [[part] for part in rows.entries(exchange.to_owners(columns))]
    for nth, (copies, values) in enumerate(zip(supports.copies, supports.values, strict=True)):
        node, component = np.nonzero(values)
        row.append(np.full(len(node), len(rows.kind) + nth))
        column.append(columns[copies[node], component])
        value.append(values[node, component])
    extra = len(supports.copies)
    kinds = np.concatenate([rows.kind, np.full(extra, RowKind.SUPPORT, np.int8)])
    c = np.concatenate([rows.rhs, np.zeros(extra)])
    total = comm.allreduce(size)
    local = sparse.csr_matrix(
        (np.concatenate(value), (np.concatenate(row), np.concatenate(column))),
        shape=(len(kinds), total),
    )
    local.sort_indices()
    weight = np.concatenate([rows.weight, np.ones(extra)])
    seen = KernelRows(ConstraintMatrix(comm, local, size), kernels)
    own = comm.exscan(size) or 0, size
    order, nodal, alike = _row_order(local, kinds, seen, own, d)
    B = ConstraintMatrix(comm, local[order], size, nodal, d)
    return B, c[order], kinds[order], weight[order], alike


def _row_order(
    local: sparse.csr_matrix,
    kinds: NDArray[np.int8],
    seen: KernelRows,
    own: tuple[int, int],
    d: int,
) -> tuple[NDArray[np.int64], int, list[Kind]]:
    """The order of rows in which those that repeat are together and products read nearby.

    Rows that do the same to each component of some nodes of this rank come first, then those that
    do so to nodes of other ranks as well, rows of contact and supports last, as they are.

    Parameters
    ----------
    local
        Rows that do the same to each component of a node next to each other.
    own
        First column of this rank, and how many it has.
    d
        Components of a node.

    Returns
    -------
    The order, how many rows come first, and kinds of rows.
    """
    inner = (kinds == RowKind.GLUING) | (kinds == RowKind.DIRICHLET)
    runs = np.empty(0, np.int64)
    if seen.motions and not any(n % d for n in own):
        runs = nodal_rows(local, d).reshape(-1, d)
        runs = runs[inner[runs].all(axis=1), 0]
    begin, end = local.indptr[runs], local.indptr[runs + 1] - 1
    inside = (local.indices[begin] >= own[0]) & (local.indices[end] < sum(own))
    parts: list[NDArray[np.int64]] = []
    alike: list[Kind] = []
    for mine in (runs[inside], runs[~inside]):
        order, found = kinds_of(seen, mine, d, d * sum(map(len, parts)))
        parts.append(mine[order])
        alike += found
    nodal = (np.concatenate(parts)[:, None] + np.arange(d)).ravel()
    left = inner.copy()
    left[nodal] = False
    others = np.flatnonzero(left)
    begins, start, _, place, _ = seen.entries_of(others)
    others = others[np.lexsort((place[begins[:-1]], start[begins[1:] - 1], start[begins[:-1]]))]
    order = np.concatenate([nodal, others, np.flatnonzero(~inner)])
    return order, d * len(parts[0]), alike
