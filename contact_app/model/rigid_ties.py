"""Boundaries tied to rigid bodies: all their nodes move with the body.

With q = (t, θ) the motion of the body about its reference point c, both as the file has them,

    u(x) - t - θ × (x - c) = 0    in each component at each node x of the boundary.

Components of the motion that are held go to the right-hand side. If the body is held in all
components, the rows prescribe the displacements of the nodes.

If a displacement condition holds a component of some of these nodes, their rows have entries at the
rigid body alone: they hold motions of the body, of which each needs one row only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.model.geometry import Geometry
from contact_app.model.rigid import (
    RigidUnknowns,
    motions_of_rows,
    on_tied_bodies,
    rows_without_nodes,
    with_body,
)
from contact_app.scene.conditions import RigidTie, Tie
from meshes.arrays import Array, Ints, Mask
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows

SAME = 1e-9
"""Rounding errors of rows on rigid motions, and of displacements over the length of the scene."""


@dataclass(frozen=True, eq=False)
class ContactsAndTies:
    """The contacts and ties of a scene, and their rows on this rank, which owns their nodes."""

    geometry: Geometry
    contact: ContactRows
    tied: ContactRows
    """Rows of the contacts and of the ties."""

    def of(self, some: Mask) -> "ContactsAndTies":
        """The contacts and ties with some of the contact rows, (rows,)."""
        return replace(self, contact=self.contact.of(some))

    def nodes_tied_to_moving(self) -> list[tuple[RigidTie, Ints]]:
        """Ties to rigid bodies that may move, each with its nodes on all ranks (collective)."""
        moving, comm = self.geometry.rigid.moving, self.geometry.comm
        return [
            (tie, np.concatenate(comm.allgather(self.tied.nodes[self.tied.sources == number])))
            for number, tie in of_rigid_bodies(self.geometry.ties)
            if tie.rigid in moving
        ]


def rigidly_tied_rows(geometry: Geometry, exchange: NodeExchange) -> tuple[list[ContactRows], Ints]:
    """Rows of the boundaries tied to rigid bodies, and all their nodes (collective).

    `sources` counts all ties. Nodes of two boundaries that are tied to the
    same body belong to the first.

    Raises
    ------
    ConfigurationError
        A boundary has no facet, or shares nodes with one that is tied to another rigid body.
    """
    unknowns, parts = RigidUnknowns.of(geometry), []
    body_of: dict[int, int] = {}
    for number, tie in of_rigid_bodies(geometry.ties):
        nodes, points = _nodes(geometry, tie)
        shared = {body_of[node] for node in nodes.tolist() if node in body_of} - {tie.rigid}
        if shared:
            other = geometry.rigid.bodies[shared.pop()].name
            raise ConfigurationError(
                f"{geometry.at(tie.source)}.on: has nodes that are tied to {other}, too: a node "
                "moves with one rigid body; leave these nodes out of one of the boundaries"
            )
        fresh = np.array([node not in body_of for node in nodes.tolist()], bool)
        body_of |= dict.fromkeys(nodes.tolist(), tie.rigid)
        owned = fresh & (nodes >= exchange.first) & (nodes < exchange.last)
        rows = _at_nodes(nodes[owned], points[owned], geometry.dimension, number)
        center = unknowns.drawn_center(tie.rigid)
        parts.append(with_body(rows, unknowns, tie.rigid, center))
    return parts, np.array(sorted(body_of), np.int64)


def of_rigid_bodies(ties: Sequence[Tie | RigidTie]) -> list[tuple[int, RigidTie]]:
    """Ties to rigid bodies, with their numbers among all ties."""
    return [(number, tie) for number, tie in enumerate(ties) if isinstance(tie, RigidTie)]


def _nodes(geometry: Geometry, tie: RigidTie) -> tuple[Ints, Array]:
    """Nodes of the facets of a boundary, ascending, and their coordinates (collective)."""
    side = geometry.boundary_surface(tie.body, tie.boundary)
    if side is None:
        raise ConfigurationError(
            f"{geometry.at(tie.source)}.on: no whole facet of the surface of "
            f"{geometry.bodies[tie.body].name} lies on {tie.boundary}; tied boundaries need facets "
            "all of whose nodes are on them"
        )
    nodes, first = np.unique(side.nodes, return_index=True)
    return nodes, side.points.reshape(-1, 3)[first]


def _at_nodes(nodes: Ints, points: Array, d: int, number: int) -> ContactRows:
    """A row for each component of each node; areas are the shares of the nodes."""
    count = len(nodes)
    component = np.tile(np.arange(d), count)
    nodes, points = np.repeat(nodes, d), np.repeat(points, d, axis=0)
    place = np.arange(d * count)
    return ContactRows(
        nodes=nodes, points=points, sources=np.full(d * count, number), gaps=np.zeros(d * count),
        normals=-np.eye(d)[component], moments=np.zeros((d * count, 3)),
        areas=np.full(d * count, np.nan), spread=np.ones(d * count),
        entries=ContactEntries(place, nodes, points, component, np.ones(d * count)),
    )  # fmt: skip


def without_repeated(geometry: Geometry, exchange: NodeExchange, rows: ContactRows) -> ContactRows:
    """Tied rows without those on rigid motions alone that others repeat (collective).

    Raises
    ------
    NoEquilibriumError
        Held nodes would move a rigid body in two ways at once.
    """
    unknowns, comm = RigidUnknowns.of(geometry), exchange.comm
    without_nodes = rows_without_nodes(rows)
    held = motions_of_rows(rows, unknowns, without_nodes)
    parts = comm.allgather(held)
    body, sources, vectors, gaps = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("body", "sources", "vectors", "gaps")
    )
    best = np.zeros(len(gaps), bool)
    for nth in np.unique(body):
        some = np.flatnonzero(body == nth)
        triangle, order = qr(vectors[some].T, mode="r", pivoting=True)
        size = np.abs(np.diagonal(triangle))
        chosen = some[order[: int((size > SAME * size[0]).sum())]]
        best[chosen] = True
        motion = np.linalg.lstsq(vectors[chosen], gaps[chosen], rcond=None)[0]
        wrong = np.abs(vectors[some] @ motion - gaps[some])
        if wrong.max() > SAME * unknowns.length:
            source = geometry.ties[sources[some[int(np.argmax(wrong))]]].source
            name = geometry.rigid.bodies[unknowns.moving[int(nth)]].name
            raise NoEquilibriumError(
                f"{geometry.source}: nodes of {source} that displacement conditions hold would "
                f"move {name}, which is rigid, in two ways, {wrong.max():.6g} apart: no "
                "displacement satisfies both"
            )
    start = sum(len(part.gaps) for part in parts[: comm.rank])
    keep = ~without_nodes
    keep[without_nodes] = best[start : start + len(held.gaps)]
    return rows.of(keep)


def on_motions(constraints: ContactsAndTies) -> ContactRows:
    """Contact rows without friction, written on the motions of the bodies that nodes are tied to.

    As rows on displacements of these nodes they would be combinations of the tied rows and of rows
    on rigid motions: S = C D⁻¹ Cᵀ would be singular. Collective.
    """
    unknowns, contact = RigidUnknowns.of(constraints.geometry), constraints.contact
    rough = np.array([item.law.acts for item in constraints.geometry.touching] or [False])
    slips = rough[contact.sources]
    rows = contact.of(~slips)
    for tie, nodes in constraints.nodes_tied_to_moving():
        rows = on_tied_bodies(rows, unknowns, tie.rigid, nodes)
    return ContactRows.join([rows, contact.of(slips)])


def rough_at_tied_nodes(constraints: ContactsAndTies) -> list[str]:
    """Sentences on contacts with friction at nodes that are tied to moving rigid bodies.

    Each of these nodes has a tied row and rows of friction along the same components (collective).
    """
    contact, touching, sentences = constraints.contact, constraints.geometry.touching, []
    for tie, nodes in constraints.nodes_tied_to_moving():
        sources = contact.sources[np.isin(contact.nodes, nodes)]
        shared = constraints.geometry.comm.allreduce(np.bincount(sources, minlength=len(touching)))
        sentences += [
            f"{item.source}: {count} of its nodes with friction are tied to a moving rigid body "
            f"({tie.source}); how friction and the tie share the forces there is not unique, so "
            "that pressures at these nodes depend on the method and the decomposition; let one of "
            "the two boundaries end before the other"
            for item, count in zip(touching, shared, strict=True)
            if count and item.law.acts
        ]
    return sentences


def refuse_pushed(constraints: ContactsAndTies) -> None:
    """Refuse contacts of nodes that a rigid body, held in all components, pushes too far.

    Collective. The contact rows are those that the tied rows determine.
    """
    geometry, tied, contact = constraints.geometry, constraints.tied, constraints.contact
    moving = geometry.rigid.moving
    held = [number for number, tie in of_rigid_bodies(geometry.ties) if tie.rigid not in moving]
    fixed = tied.of(np.isin(tied.sources, held))
    component = np.abs(fixed.normals).argmax(axis=1)
    prescribed = dict(zip(zip(fixed.nodes, component, strict=True), fixed.gaps, strict=True))
    entries = contact.entries
    places = zip(entries.node, entries.component, strict=True)
    moved = np.array([prescribed.get(place, np.nan) for place in places])
    inside = -contact.gaps
    np.add.at(inside, entries.row, entries.value * moved)
    pushed = [(float(v), int(k)) for v, k in zip(inside, contact.sources, strict=True) if v > 0.0]
    worst, source = max(geometry.comm.allgather(max(pushed, default=(0.0, -1))))
    if worst > SAME * geometry.length:
        raise NoEquilibriumError(
            f"{geometry.source}: a rigid body that is held in all components pushes nodes that are "
            f"tied to it by {worst:.6g} into what {geometry.touching[source].source} names: no "
            "displacement satisfies both"
        )
