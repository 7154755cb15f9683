"""The equilibrium of each body.

A scene whose loads drive a body away is refused before the solve.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from mpi4py import MPI
from scipy import sparse
from scipy.linalg import block_diag

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.model.geometry import Geometry
from contact_app.model.obstacle_hints import obstacle_hints
from contact_app.model.rigid import RigidUnknowns
from contact_app.scene.bodies import MOTION_NAMES, Body
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from solver.contact.equilibrium import (
    BodyBalance,
    FrictionCones,
    carried_share,
    held_motions,
    slide,
)
from solver.contact.group_balance import GroupRows
from solver.problem.constraints.conditions import ContactEntries, ContactRows, HeldRows
from solver.problem.constraints.friction import FrictionRows
from solver.problem.free_motions import LooseBodies
from solver.rigid_motions import MOTIONS, rigid_motions

CLOSES = 1e-6
"""Speed at which a gap closes, over the largest relative motion, that is no rounding error."""


def body_balances(
    geometry: Geometry,
    holding: tuple[HeldRows, ContactRows],
    contact: ContactRows,
    loads: Iterable[Array | None],
    friction: FrictionRows,
    in_step: bool = False,
) -> list[BodyBalance]:
    """The equilibrium of each body, (bodies,): elastic ones first, then moving rigid ones.

    Raises `NoEquilibriumError` if a load drives a body away.

    Parameters
    ----------
    holding
        Held nodes and tied rows that this rank owns.
    in_step
        Whether the loads are those of a place in a load history.
    """
    held, tied = holding
    d, comm, elastic = geometry.dimension, geometry.comm, len(geometry.bodies)
    work, scale = _work_of_loads(geometry, loads)
    joined = contact_motions(geometry, tied)
    points = ContactPoints.of(friction, contact, partial(contact_motions, geometry))
    balances: list[BodyBalance | None] = [None] * len(work)
    for group in groups_in_contact(geometry):
        held_rows, requested = _holding(geometry, held, group)
        columns = (group[:, None] * MOTIONS[d] + np.arange(MOTIONS[d])).ravel()
        nonzero, on_contact, cones = points.on(columns)
        tied_rows = joined[:, columns]
        tied_rows = tied_rows[np.diff(tied_rows.indptr) > 0].toarray()
        moved = None
        if group.max() < elastic:
            moved = _moved_by_contact(geometry, contact, group)
        together = np.concatenate([block_diag(*requested), tied_rows])
        rows = GroupRows(held_rows, together, on_contact, moved, cones)
        load = work[group].ravel()
        state_of = partial(GroupRows.balance, comm=comm, load=load, size=float(scale[group].sum()))
        state = state_of(rows)
        if state.escape is not None:
            message = _no_equilibrium(geometry, group, rows, load, state.escape, in_step)
            hints = obstacle_hints(geometry, contact)
            names = [touching.source for touching in geometry.touching]
            hints += averaged_gap_hints(names, contact, nonzero, rows, state_of, comm)
            raise NoEquilibriumError("\n  ".join([message, *hints]))
        for b, of_body in zip(group, rows.balances(comm, state, group < elastic), strict=True):
            balances[b] = of_body
    return [b for b in balances if b is not None]


def _work_of_loads(geometry: Geometry, loads: Iterable[Array | None]) -> tuple[Array, Array]:
    """Work of the loads in each rigid motion of each body, and their sizes (collective).

    (bodies, motions) and (bodies,), elastic bodies first, then moving rigid ones.
    """
    d, comm, partition = geometry.dimension, geometry.comm, geometry.partition
    rigid, elastic = RigidUnknowns.of(geometry), len(geometry.bodies)
    count = elastic + rigid.count
    work, scale = np.zeros((count, MOTIONS[d])), np.zeros(count)
    for s, load in zip(partition.subdomains, loads, strict=True):
        if load is not None:
            motions = rigid_motions(s.points(), d, *body_frame(geometry.bodies[s.body]))
            work[s.body] += load @ motions.reshape(len(load), -1)
            scale[s.body] += np.abs(load).sum()
    work, scale = comm.allreduce(work), comm.allreduce(scale)
    for nth in range(rigid.count):
        work[elastic + nth] = rigid.loads(nth)
        scale[elastic + nth] = np.abs(work[elastic + nth]).sum()
    return work, scale


def _no_equilibrium(
    geometry: Geometry, group: Ints, rows: GroupRows, load: Array, escape: Array, in_step: bool
) -> str:
    """The error for a group that a load drives away along an escape (collective).

    With given slip limits the message has the share of all loads at which this starts. In a load
    step only its own loads grow, and the message of the step has the factor.
    """
    share, cones, both, comm = None, rows.cones, (rows.holding, rows.contact), geometry.comm
    if cones.acts:
        escape = slide(comm, *both, escape, cones)
        share = None if in_step else carried_share(comm, *both, load, cones)
    return (
        f"{geometry.source}: the scene has no equilibrium: nothing stops "
        f"{leaving(geometry.body_names.__getitem__, group, escape)} under its loads"
        + (", not even friction at its limit" if cones.acts else "")
        + (f"; it starts at {share:.3g} times all loads" if share is not None else "")
    )


def averaged_gap_hints(
    names: Sequence[str],
    contact: ContactRows,
    chosen: Mask,
    rows: GroupRows,
    state_of: Callable[[GroupRows], BodyBalance],
    comm: MPI.Intracomm,
) -> list[str]:
    """A sentence for each contact whose gap in the mean alone lets the loads drive a group away.

    None if they drive it away where the contact is tested at nodes, too (collective).

    Parameters
    ----------
    names
        Of all contacts.
    chosen : (rows,)
        The contact rows on the group.
    state_of
        The equilibrium by the rows.
    """
    escape = state_of(rows).escape
    if rows.moved is None or escape is None:
        return []
    motions = rows.moved.reshape(*contact.normals.shape, len(escape))
    at_nodes = -np.einsum("rd,rdm->rm", contact.normals, motions)
    if state_of(replace(rows, contact=at_nodes[chosen])).escape is not None:
        return []
    size = comm.allreduce(float(np.abs(motions @ escape).max(initial=0.0)), op=MPI.MAX)
    sources = contact.sources[at_nodes @ escape > CLOSES * size]
    count = comm.allreduce(np.bincount(sources, minlength=len(names)))
    return [
        f"{names[number]}: this motion closes the gap at nodes, but not in the "
        "mean about them, where it is tested: the contact presses no nearer to an edge than a "
        "third of a facet. Smaller cells there, or degree 1, may hold the body"
        for number in np.flatnonzero(count)
    ]


def loose_bodies(bodies: Sequence[Body], balances: list[BodyBalance]) -> LooseBodies:
    """Rigid motions of elastic bodies that nothing resists, and that contact alone holds."""
    frames = [body_frame(body) for body in bodies]
    frames += [(np.zeros(3), 1.0)] * (len(balances) - len(frames))
    return LooseBodies(
        [balance.loose for balance in balances],
        [balance.allowed for balance in balances],
        np.array([centre for centre, _ in frames]),
        np.array([length for _, length in frames]),
    )


def _holding(geometry: Geometry, held: HeldRows, group: Ints) -> tuple[list[Array], list[Array]]:
    """Held rows of each body of a group on its rigid motions, and motions held on request."""
    d, comm, bodies = geometry.dimension, geometry.comm, geometry.bodies
    rigid, first_node = geometry.rigid, geometry.partition.first_node
    held_rows, requested = [], []
    for b in group:
        if b >= len(bodies):
            held_rows.append(np.eye(MOTIONS[d])[rigid.held(rigid.moving[b - len(bodies)])[0]])
            requested.append(np.zeros((0, MOTIONS[d])))
            continue
        first, last = first_node[b], first_node[b + 1]
        in_body = (held.nodes >= first) & (held.nodes < last)
        motions = rigid_motions(held.points[in_body], d, *body_frame(bodies[b]))
        held_rows.append(motions[held.held[in_body]])
        left = held_motions(comm, held_rows[-1])
        _refuse_held_twice(geometry.at(f"bodies[{b}].hold"), bodies[b], left)
        listed = list(bodies[b].hold) if comm.rank == 0 else []  # once over all ranks
        requested.append(np.eye(MOTIONS[d])[listed])
    return held_rows, requested


def _refuse_held_twice(place: str, body: Body, remaining: Array) -> None:
    """Refuse to hold a rigid motion that displacement conditions stop already.

    Parameters
    ----------
    place
        File, line and key of `hold`.
    remaining : (motions, k)
        Orthonormal rigid motions that the conditions on the body leave.
    """
    for motion in body.hold:
        if np.abs(remaining[motion]).max(initial=0.0) < 1e-6:
            name = MOTION_NAMES[body.mesh.dimension][motion]
            raise ConfigurationError(
                f"{place}: displacement conditions stop {name} of {body.name} already; hold is "
                "for motions that they leave"
            )


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Contact rows and their tangential rows on the rigid motions of bodies."""

    friction: FrictionRows
    normal: Ints  # (k,)
    """Contact row of each tangential row."""
    contact: sparse.csr_matrix  # (rows, bodies · motions)
    slips: sparse.csr_matrix  # (k, bodies · motions)
    """Contact rows and tangential rows applied to the rigid motions."""

    @classmethod
    def of(
        cls,
        friction: FrictionRows,
        contact: ContactRows,
        applied: Callable[[ContactRows], sparse.csr_matrix],
    ) -> "ContactPoints":
        """The points of contact rows, given a function that applies rows to the rigid motions."""
        return cls(friction, friction.places(contact), applied(contact), applied(friction.rows))

    def on(self, columns: Ints) -> tuple[Mask, Array, FrictionCones]:
        """The contact rows on the motions of some columns: their mask, these, and their cones."""
        some = self.contact[:, columns]
        chosen = np.diff(some.indptr) > 0
        of_normal = chosen[self.normal]
        normal = (np.cumsum(chosen) - 1)[self.normal[of_normal]]
        cones = FrictionCones(
            self.slips[of_normal][:, columns].toarray(), normal,
            self.friction.coefficients[of_normal], self.friction.limits[of_normal],
            self.friction.acts,
        )  # fmt: skip
        return chosen, some[chosen].toarray(), cones


def group_numbers(geometry: Geometry) -> Ints:
    """The group of each body, (bodies,): elastic ones first, then moving rigid ones.

    Bodies of a group may touch or hold together, directly or through others.
    """
    elastic, moving = len(geometry.bodies), geometry.rigid.moving
    place = {number: elastic + nth for nth, number in enumerate(moving)}
    joints = (*geometry.touching, *geometry.ties)
    pairs = [(j.body, j.other) for j in joints if isinstance(j, BodyContact | Tie)]
    with_rigid = [j for j in joints if isinstance(j, Contact | RigidTie)]
    pairs += [(j.body, place[j.rigid]) for j in with_rigid if j.rigid in place]
    ends = np.array(pairs, np.int64).reshape(-1, 2)
    return connected(ends.T, elastic + len(moving))


def groups_in_contact(geometry: Geometry) -> list[Ints]:
    """Bodies that may touch each other, directly or through others."""
    label = group_numbers(geometry)
    return [np.flatnonzero(label == k) for k in np.unique(label)]


def contact_motions(geometry: Geometry, contact: ContactRows) -> sparse.csr_matrix:
    """Contact rows applied to the rigid motions of each body, (rows, bodies · motions)."""
    rigid, bodies, partition = RigidUnknowns.of(geometry), geometry.bodies, geometry.partition
    d, more = geometry.dimension, contact.rigid
    shape = len(contact.nodes), (len(bodies) + rigid.count) * MOTIONS[d]
    if not shape[0]:
        return sparse.csr_matrix(shape)

    def motions_of(b: int, points: Array) -> Array:
        return rigid_motions(points, d, *body_frame(bodies[b]))

    body = np.searchsorted(partition.first_node, contact.entries.node, side="right") - 1
    of_elastic = entries_on_motions(contact.entries, body, motions_of, d)
    of_rigid = len(bodies) + rigid.body_of(more.node)
    place = of_rigid * MOTIONS[d] + rigid.motion_of(more.node, more.component)
    of_moving = more.value, more.row, place
    value, rows, columns = map(np.concatenate, zip(of_elastic, of_moving, strict=True))
    return sparse.csr_matrix((value, (rows, columns)), shape=shape)


def entries_on_motions(
    entries: ContactEntries, body: Ints, motions_of: Callable[[int, Array], Array], d: int
) -> tuple[Array, Ints, Ints]:
    """Values, rows and columns of the matrix of rows applied to rigid motions of bodies.

    Parameters
    ----------
    body : (entries,)
    motions_of
        Rigid motions (points, d, motions) of a body, by its number, at points.
    """
    m, none = MOTIONS[d], np.zeros(0, np.int64)
    parts = [(np.zeros(0), none, none)]
    for b in np.unique(body):
        of_body = np.flatnonzero(body == b)
        motions = motions_of(int(b), entries.points[of_body])
        applied = motions[np.arange(len(of_body)), entries.component[of_body]]
        rows, place = np.unique(entries.row[of_body], return_inverse=True)
        pick = sparse.csr_matrix(
            (entries.value[of_body], (place.reshape(-1), np.arange(len(applied))))
        )
        parts.append(
            ((pick @ applied).ravel(), np.repeat(rows, m), np.tile(b * m + np.arange(m), len(rows)))
        )
    value, row, column = (np.concatenate(part) for part in zip(*parts, strict=True))
    return value, row, column


def _moved_by_contact(geometry: Geometry, contact: ContactRows, group: Ints) -> Array:
    """Relative motion of the sides of the contact rows of a group under its rigid motions.

    (rows · dimension, bodies · motions).
    """
    d, bodies = geometry.dimension, geometry.bodies
    moved = np.zeros((len(contact.nodes), d, len(group), MOTIONS[d]))
    for number, item in enumerate(geometry.touching):
        of_contact = np.flatnonzero(contact.sources == number)
        sides = [(item.body, 1.0)]
        sides += [(item.other, -1.0)] if isinstance(item, BodyContact) else []
        for body, sign in sides:
            place = np.flatnonzero(group == body)
            if len(place):
                frame = body_frame(bodies[body])
                moved[of_contact, :, place[0]] += sign * rigid_motions(
                    contact.points[of_contact], d, *frame
                )
    return moved.reshape(-1, len(group) * MOTIONS[d])


def leaving(name_of: Callable[[int], str], group: Ints, escape: Array) -> str:
    """Phrase with the bodies of a group that leave, and their directions."""
    motions = escape.reshape(len(group), -1)
    size = np.abs(motions).max(axis=1)
    directions = [
        f"{name_of(int(b))} from leaving along {directions_in_words(motion[:, None])}"
        for b, motion, s in zip(group, motions, size, strict=True)
        if s > 1e-6 * size.max()
    ]
    return " and ".join(directions)


def body_frame(body: Body) -> tuple[Array, float]:
    """Centre and length of a body, to which its rigid motions refer."""
    centre = np.zeros(3)
    lower, upper = np.array(body.mesh.lower), np.array(body.mesh.upper)
    centre[: len(lower)] = 0.5 * (lower + upper)
    return centre, float((upper - lower).max())


def motion_size(bodies: Sequence[Body], body: int, motion: Array) -> float:
    """Largest displacement at the corners of the box about a body, of a rigid one its own."""
    if body >= len(bodies):
        return float(np.linalg.norm(motion))
    mesh = bodies[body].mesh
    d = mesh.dimension
    corners = np.zeros((2**d, 3))
    corners[:, :d] = list(product(*zip(mesh.lower, mesh.upper, strict=True)))
    moved = rigid_motions(corners, d, *body_frame(bodies[body])) @ motion
    return float(np.linalg.norm(moved, axis=1).max())


def upward(motions: Array) -> Array:
    """Motions (motions, k) with signs chosen so that the first non-zero part is positive."""
    large = np.abs(motions) > 1e-3 * np.abs(motions).max(axis=0)
    return motions * np.sign(motions[large.argmax(axis=0), np.arange(motions.shape[1])])


NEAR_AXIS = 0.1
"""Turn over the displacement of the middle, in lengths of the body, from which on a motion is named
as a turn about another axis."""


def directions_in_words(motions: Array) -> str:
    """Rigid motions (motions, k) in words.

    A turn about one axis with a displacement across it is a turn about a parallel axis.
    """
    planar = len(motions) == 3
    names = ["x", "y", "a turn about z"] if planar else [
        "x", "y", "z", "a turn about x", "a turn about y", "a turn about z"
    ]  # fmt: skip
    words = []
    for motion in motions.T:
        motion = motion / np.abs(motion).max()
        if motion[np.argmax(np.abs(motion))] < 0 and motions.shape[1] > 1:
            motion = -motion
        large = np.abs(motion) > 1e-3
        turns = np.flatnonzero(large[2 if planar else 3 :]) + (2 if planar else 3)
        across = large.sum() > 1 and (planar or not large[turns - 3].any())
        if len(turns) == 1 and across and np.abs(motion[turns[0]]) > NEAR_AXIS:
            words.append(f"{names[turns[0]]} off the middle of the body")
            continue
        terms = []
        for value, name in zip(motion, names, strict=True):
            if abs(value) > 1e-3:
                sign = "-" if value < 0 else "+"
                terms.append(f"{'' if abs(value) > 0.999 else f'{abs(value):.2g} '}{sign}{name}")
        words.append(" and ".join(terms).replace("+a turn", "a turn").replace("-a turn", "a turn"))
    return "; ".join(sorted(words))  # a fixed order, so that equal motions have equal texts
