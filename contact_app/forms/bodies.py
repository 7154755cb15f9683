"""Bodies of a mesh, the rigid motions that a form does not resist, and their supports.

If the energy of a form is that of strains, rigid motions have none. Springs, or a term like ∫ c
u·v, resist some of them or all. The matrix shows which ones: with R the rigid motions of a body and
G = RᵀR, the motions R z without energy are the null vectors of

    RᵀKR z = λ G z.

Other motions without energy are not searched: a body connected at a point or a line alone can
rotate about it, and then the coarse problem is singular.
"""

from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from mpi4py import MPI
from scipy import linalg, sparse

from contact_app.errors import NoEquilibriumError
from contact_app.forms.subdomains import Subdomains
from contact_app.model.equilibrium import (
    ContactPoints,
    averaged_gap_hints,
    entries_on_motions,
    leaving,
)
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from solver.contact.equilibrium import BodyBalance, slide
from solver.contact.group_balance import GroupRows
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, HeldRows
from solver.problem.constraints.friction import FrictionRows
from solver.problem.free_motions import LooseBodies
from solver.rigid_motions import MOTIONS, rigid_motions
from solver.tfeti.subdomain.kernels import orthonormal_kernel

RESISTED = 1e-12
"""Stiffness against a motion over the largest entry of K, from which on the form resists it."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies of a mesh: parts of the mesh connected through nodes."""

    of_subdomain: Ints  # (subdomains,)
    """Body of each subdomain of this rank."""
    of_node: Ints  # (owned nodes,)
    """Body of each node this rank owns, as the exchange counts owners."""
    first: Ints  # (bodies,)
    """Number of the first subdomain of each body, among those of all ranks."""
    sizes: Ints  # (bodies,)
    """Number of subdomains of each body."""
    centres: Array
    lengths: Array
    """Centre and length in the definition of rigid motions. Shapes (bodies, 3), (bodies,)."""
    halves: Array  # (bodies, 3)
    """Half the sides of the box about each body."""

    @property
    def count(self) -> int:
        """Bodies of the mesh."""
        return len(self.first)

    def motions(self, body: int, points: Array, d: int) -> Array:
        """Rigid motions of a body at points (n, 3), (n, d, motions)."""
        return rigid_motions(points, d, self.centres[body], float(self.lengths[body]))

    def size_of(self, body: int, motion: Array) -> float:
        """Largest displacement at the corners of the box about a body."""
        d = 2 if len(motion) == MOTIONS[2] else 3
        signs = np.array(list(product(*[(-1.0, 1.0)] * d, *[(0.0,)] * (3 - d))))
        moved = self.motions(body, self.centres[body] + signs * self.halves[body], d) @ motion
        return float(np.linalg.norm(moved, axis=1).max())

    def name(self, body: int) -> str:
        """A phrase for messages: the middle of a body, and its size if others have this middle."""
        if self.count == 1:
            return "the body"
        middle, length = self.centres[body], self.lengths[body]
        about = ", ".join(f"{v:.3g}" for v in np.where(np.abs(middle) < 1e-9 * length, 0.0, middle))
        alike = (np.abs(self.centres - middle) < 1e-3 * length).all(axis=1)
        size = " × ".join(f"{v:.3g}" for v in 2.0 * self.halves[body] if v)
        return f"the body about ({about})" + f" of size {size}" * bool(alike.sum() > 1)


def bodies_of(subdomains: Subdomains, exchange: NodeExchange) -> Bodies:
    """Find the bodies of the subdomains (collective)."""
    comm = subdomains.comm
    before = comm.exscan(subdomains.count) or 0
    total = comm.allreduce(subdomains.count)
    part = np.repeat(before + np.arange(subdomains.count), np.diff(subdomains.starts))
    arrived = exchange.to_owners(part)
    order = np.argsort(exchange.nodes, kind="stable")
    same = exchange.nodes[order][1:] == exchange.nodes[order][:-1]
    links = np.stack([arrived[order][:-1][same], arrived[order][1:][same]], axis=1)
    label = _connected(comm, links, total)
    count = int(label.max()) + 1
    of_subdomain = label[before : before + subdomains.count]
    of_node = np.zeros(exchange.last - exchange.first, np.int64)
    of_node[exchange.nodes - exchange.first] = label[arrived]
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for number in range(subdomains.count):
        points = subdomains.points[subdomains.copies(number)]
        body = of_subdomain[number]
        lower[body] = np.minimum(lower[body], points.min(axis=0))
        upper[body] = np.maximum(upper[body], points.max(axis=0))
    lower, upper = np.min(comm.allgather(lower), axis=0), np.max(comm.allgather(upper), axis=0)
    return Bodies(
        of_subdomain, of_node, np.unique(label, return_index=True)[1], np.bincount(label),
        0.5 * (lower + upper), (upper - lower).max(axis=1), 0.5 * (upper - lower),
    )  # fmt: skip


def groups_of(bodies: Bodies, exchange: NodeExchange, rows: ContactRows) -> Ints:
    """The group of each body, (bodies,): bodies that rows connect (collective)."""
    body = _of_entries(bodies, exchange, rows)
    lowest = np.full(len(rows.nodes), bodies.count)
    np.minimum.at(lowest, rows.entries.row, body)
    links = np.stack([lowest[rows.entries.row], body], axis=1)
    return _connected(exchange.comm, np.unique(links, axis=0), bodies.count)


def _connected(comm: MPI.Intracomm, links: Ints, count: int) -> Ints:
    """Connected component of each vertex of the graph of all ranks' links (n, 2) (collective)."""
    links = np.concatenate(comm.allgather(np.unique(links, axis=0).reshape(-1, 2)))
    return connected(links.T, count)


def _of_entries(bodies: Bodies, exchange: NodeExchange, rows: ContactRows) -> Ints:
    """The body of each entry of contact rows, (entries,) (collective)."""
    query = NodeExchange(exchange.comm, rows.entries.node, exchange.total)
    return query.from_owners(bodies.of_node[query.nodes - exchange.first])


def kernel_of(K: sparse.csr_matrix, points: Array, d: int) -> Array:
    """Orthonormal rigid motions of a subdomain that its stiffness does not resist, (n, k).

    Raises
    ------
    ValueError
        The energy of a rigid motion is negative.
    """
    rigid = orthonormal_kernel(points, d)
    values, vectors = np.linalg.eigh(rigid.T @ (K @ rigid))
    round_off = RESISTED * K.diagonal().max()
    if values[0] < -round_off:
        raise ValueError("a is not elliptic: the energy of some rigid motion is negative")
    free = values <= round_off
    return rigid @ vectors[:, free]


def resisted(
    subdomains: Subdomains, bodies: Bodies, stiffness: list[sparse.csr_matrix]
) -> list[Array]:
    """Motions that the form resists in each body, (resisted, motions) (collective).

    The motions are rows: orthonormal, and perpendicular to motions that the form does not resist.
    Subdomains with the same matrix share the result.
    """
    d, m = subdomains.dimension, MOTIONS[subdomains.dimension]
    grams, scale = np.zeros((2, bodies.count, m, m)), np.zeros(bodies.count)
    of_matrix: dict[int, tuple[bool, float]] = {}  # whether all motions are free, largest entry
    for number, (K, body) in enumerate(zip(stiffness, bodies.of_subdomain, strict=True)):
        points = subdomains.points[subdomains.copies(number)]
        R = bodies.motions(int(body), points, d).reshape(K.shape[0], m)
        if id(K) not in of_matrix:
            of_matrix[id(K)] = kernel_of(K, points, d).shape[1] == m, K.diagonal().max()
        floats, largest = of_matrix[id(K)]
        if not floats:
            grams[0, body] += R.T @ (K @ R)
        grams[1, body] += R.T @ R
        scale[body] = max(scale[body], largest)
    grams, scale = (
        subdomains.comm.allreduce(grams),
        np.max(subdomains.comm.allgather(scale), axis=0),
    )
    rows = []
    for energy, gram, size in zip(*grams, scale, strict=True):
        values, vectors = linalg.eigh(energy, gram)
        free = vectors[:, values <= RESISTED * size]
        q = np.linalg.qr(np.hstack([free, np.eye(m)]))[0]
        rows.append(q[:, free.shape[1] :].T)
    return rows


@dataclass(frozen=True, eq=False)
class Holding:
    """Supports of the bodies."""

    free_motions: list[Array]  # one (motions, k) array per body
    """Motions that nothing stops and on which no load does work."""
    held: Mask  # (bodies,)
    """Whether conditions and springs stop every rigid motion of a body by itself."""
    without_contact: bool
    """Whether they do so for all bodies."""
    loose: LooseBodies
    """Motions that nothing resists, or that contact hardly resists."""


@dataclass(frozen=True, eq=False)
class Resisting:
    """Rows of this rank that may hold the bodies."""

    held: HeldRows
    contact: ContactRows
    """Held nodes and contact rows."""
    groups: Ints  # (bodies,)
    """The group of each body."""
    friction: FrictionRows
    """Tangential rows."""
    contacts: int


def holding(
    subdomains: Subdomains,
    bodies: Bodies,
    exchange: NodeExchange,
    stiffness: list[sparse.csr_matrix],
    loads: list[Array],
    rows: Resisting,
) -> Holding:
    """Supports of each body against rigid motions (collective).

    Raises
    ------
    NoEquilibriumError
        A load drives a body away.
    """
    d, m, comm = subdomains.dimension, MOTIONS[subdomains.dimension], subdomains.comm
    held, contact, groups = rows.held, rows.contact, rows.groups
    work, scale = _work_of_loads(subdomains, bodies, loads)
    springs = resisted(subdomains, bodies, stiffness)
    body_of_held = bodies.of_node[held.nodes - exchange.first]
    applied = partial(contact_motions, bodies, exchange, d=d)
    points = ContactPoints.of(rows.friction, contact, applied)
    moved = _moved_by_contact(bodies, exchange, contact, d)
    balances: list[BodyBalance | None] = [None] * bodies.count
    for number in np.unique(groups):
        group = np.flatnonzero(groups == number)
        holds_body = []
        for b in group:
            on_body = body_of_held == b
            motions = bodies.motions(int(b), held.points[on_body], d)[held.held[on_body]]
            holds_body.append(np.concatenate([motions, springs[b]]))
        columns = (group[:, None] * m + np.arange(m)).ravel()
        in_group, on_contact, cones = points.on(columns)
        none = np.zeros((0, len(columns)))
        on_group = GroupRows(holds_body, none, on_contact, moved[:, columns], cones)
        state_of = partial(
            GroupRows.balance, comm=comm, load=work[group].ravel(), size=float(scale[group].sum())
        )
        state = state_of(on_group)
        if (escape := state.escape) is not None:
            names = [f"contacts[{number}]" for number in range(rows.contacts)]
            hints = averaged_gap_hints(names, contact, in_group, on_group, state_of, comm)
            if cones.acts:
                escape = slide(comm, on_group.holding, on_group.contact, escape, cones)
            message = _leaving(bodies, group, escape, cones.acts)
            raise NoEquilibriumError("\n  ".join([message, *hints]))
        elastic = np.ones(len(group), bool)
        for b, of_body in zip(group, on_group.balances(comm, state, elastic), strict=True):
            balances[b] = of_body
    every = [b for b in balances if b is not None]
    return Holding(
        [b.free_motions for b in every],
        np.array([b.held for b in every]),
        all(b.steady for b in every),
        LooseBodies(
            [b.loose for b in every], [b.allowed for b in every], bodies.centres, bodies.lengths
        ),
    )


def _work_of_loads(
    subdomains: Subdomains, bodies: Bodies, loads: list[Array]
) -> tuple[Array, Array]:
    """Work of the loads in each rigid motion of each body, and their sizes (collective).

    (bodies, motions) and (bodies,).
    """
    d, m, comm = subdomains.dimension, MOTIONS[subdomains.dimension], subdomains.comm
    work, scale = np.zeros((bodies.count, m)), np.zeros(bodies.count)
    for number, (f, body) in enumerate(zip(loads, bodies.of_subdomain, strict=True)):
        points = subdomains.points[subdomains.copies(number)]
        work[body] += f @ bodies.motions(int(body), points, d).reshape(len(f), m)
        scale[body] += np.abs(f).sum()
    work, scale = comm.allreduce(work), comm.allreduce(scale)
    return work, scale


def _moved_by_contact(
    bodies: Bodies, exchange: NodeExchange, contact: ContactRows, d: int
) -> Array:
    """Relative motion of the sides of the contact rows under the rigid motions (collective).

    (rows · d, bodies · motions).
    """
    m, rows = MOTIONS[d], contact.entries.row
    body_of_row = bodies.of_node[contact.nodes - exchange.first]
    body = _of_entries(bodies, exchange, contact)
    other = np.full(len(body_of_row), -1)
    np.maximum.at(other, rows, np.where(body == body_of_row[rows], -1, body))
    moved = np.zeros((len(body_of_row), d, bodies.count, m))
    for side, sign in ((body_of_row, 1.0), (other, -1.0)):
        for b in np.unique(side[side >= 0]):
            at_body = side == b
            moved[at_body, :, b] += sign * bodies.motions(int(b), contact.points[at_body], d)
    return moved.reshape(-1, bodies.count * m)


def contact_motions(
    bodies: Bodies, exchange: NodeExchange, contact: ContactRows, d: int
) -> sparse.csr_matrix:
    """Contact rows applied to the rigid motions of each body, (rows, bodies · motions)."""
    body = _of_entries(bodies, exchange, contact)
    value, row, column = entries_on_motions(
        contact.entries, body, lambda b, points: bodies.motions(b, points, d), d
    )
    shape = len(contact.nodes), bodies.count * MOTIONS[d]
    return sparse.csr_matrix((value, (row, column)), shape=shape)


def _leaving(bodies: Bodies, group: Ints, escape: Array, rough: bool) -> str:
    """Phrase with the bodies that leave, and their directions, for an error."""
    which = leaving(bodies.name, group, escape)
    friction = ", not even friction at its limit" if rough else ""
    return (
        f"the problem has no equilibrium: nothing stops {which} under its loads{friction}; add "
        "a Dirichlet condition, a spring or a contact"
    )
