"""Tangential rows of contacts with friction: the slip of a node, or its mean about one.

At an obstacle the slip is that of the node along a tangent of the obstacle, or, where contact rows
are means about vertices (`averaged_rows`), the same mean of it. Between bodies it is the mean jump
of the displacements with the multiplier functions of mortar contact, as of tied surfaces
(`meshes.ties`), along the tangents of the mean normal of the node: two flat surfaces that slide
against each other do so by one slip, and rigid motions of both bodies are no slip.

A tangent that displacement conditions hold has no row: there nothing slides. At nodes, tangents are
turned so that what is left of them is orthogonal. Between bodies that are held along it on both
sides, as at a plane of symmetry, a tangent has no row either: the mean about the node would be that
of one half, which slides, where the mean of the whole does not.

The slip limit that Tresca's law is given per area acts on the area of the node, ∫ φ_k over the
boundary, or on that of the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_app.model.boundaries import facets_of
from contact_app.model.facets import moments
from contact_app.model.pairs import gather_surface, owned_rows
from contact_app.model.rigid import RigidUnknowns, with_slips
from contact_app.model.ties import decided_by
from contact_app.scene.conditions import BodyContact, Contact
from contact_app.scene.scene import Scene
from meshes import Partition
from meshes.contact_surface import Surface
from meshes.ties import MeanJumps, mean_jumps
from solver.tfeti.constraints.conditions import ContactEntries, ContactRows, HeldRows
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.friction import FrictionRows
from solver.tfeti.constraints.merge import cut_held
from solver.tfeti.constraints.ties import undecided

Array = NDArray[np.float64]

PARALLEL = 1e-8
"""Difference of the normals of a contact row and of one that was merged into it."""

HELD = 1e-8
"""Length of what held components leave of a unit tangent below which nothing slides along it."""

LEANING = 0.2
"""The same between bodies, whose normals are means over facets: at the end of one half of a round
side they lean by half the angle of a facet, 0.2 for facets of 23°."""


def friction_rows(
    scene: Scene,
    partition: Partition,
    exchange: NodeExchange,
    contact: ContactRows,
    held: HeldRows,
    tied: ContactRows,
    merged: ContactRows,
) -> FrictionRows | None:
    """The tangential rows of all contacts with friction (collective); None where there are none.

    Parameters
    ----------
    contact, held, tied
        Contact rows, held nodes and tied rows this rank owns.
    merged
        Rows that a tighter contact row of the same node makes redundant: it takes over the slip
        limits that are given of their contacts.
    """
    if not scene.has_friction:
        return None
    d = scene.dimension
    parts, coefficients, limits = [contact.none()], [np.zeros(0)], [np.zeros(0)]
    taken = _taken_over(scene, partition, exchange, contact, merged)
    for number, touching in enumerate(scene.touching):
        friction = touching.friction
        if friction is None:
            continue
        mine = contact.sources == number
        own = contact.of(mine)
        given = np.zeros(len(own.nodes))
        if friction.tresca is not None:
            shares = _shares(scene, partition, exchange, touching, own.nodes)
            given = friction.tresca * np.where(np.isnan(own.areas), shares, own.areas)
        if isinstance(touching, Contact):
            moves = touching.rigid in scene.moving
            free = own.wide.any() or moves
            tangents, along = _tangents(own, None if free else _held_at(own.nodes, held))
            left = along.ravel() > HELD
            rows = _at_obstacle(own, tangents)
            if touching.rigid is not None:
                rows = with_slips(rows, RigidUnknowns.of(scene, partition), touching.rigid)
        else:
            jumps = _jumps(scene, partition, exchange, number, held)
            tangents, along = _tangents(own, jumps.held[np.searchsorted(jumps.nodes, own.nodes)])
            left = along.ravel() > LEANING
            owned = [owned_rows(exchange, r, number) for r in jumps.rows]
            rows = _between(own, tangents, owned)
        parts.append(rows.of(left))
        each = np.repeat(given + taken[mine], d - 1)[left]
        limits.append(each)
        coefficients.append(np.full(len(each), friction.coulomb or 0.0))
    of_rows, of_limits = np.concatenate(coefficients), np.concatenate(limits)
    rows = ContactRows.join(parts)
    order = _order(parts)
    found = FrictionRows(rows, of_rows[order], of_limits[order])
    return _without_held(exchange, found, held, tied)


def always_rough(scene: Scene, contact: ContactRows) -> NDArray[np.bool_]:
    """Contact rows whose friction acts where they are open, too, (rows,)."""
    given = [c.friction is not None and c.friction.tresca is not None for c in scene.touching]
    return np.array([*given, False])[contact.sources]


def _order(parts: list[ContactRows]) -> NDArray[np.int64]:
    """Where `ContactRows.join` takes its rows from."""
    nodes, sources = (np.concatenate([getattr(p, n) for p in parts]) for n in ("nodes", "sources"))
    return np.lexsort((sources, nodes))


def _taken_over(
    scene: Scene,
    partition: Partition,
    exchange: NodeExchange,
    contact: ContactRows,
    merged: ContactRows,
) -> Array:
    """Slip limits of contact rows that come from merged ones, forces (rows,) (collective)."""
    result = np.zeros(len(contact.nodes))
    for number, touching in enumerate(scene.touching):
        friction = touching.friction
        own = merged.of(merged.sources == number)
        if friction is None or not friction.tresca:
            continue
        shares = _shares(scene, partition, exchange, touching, own.nodes)
        limit = friction.tresca * np.where(np.isnan(own.areas), shares, own.areas)
        first = np.searchsorted(contact.nodes, own.nodes)
        found = np.zeros(len(limit), bool)
        for nth in range(len(scene.touching)):
            at = np.minimum(first + nth, max(len(contact.nodes) - 1, 0))
            if len(contact.nodes):
                same = ~found & (contact.nodes[at] == own.nodes)
                apart = np.abs(contact.normals[at] - own.normals).max(axis=1)
                same &= apart < PARALLEL
                np.add.at(result, at[same], limit[same])
                found |= same
    return result


def _without_held(
    exchange: NodeExchange, found: FrictionRows, held: HeldRows, tied: ContactRows
) -> FrictionRows:
    """Rows without what is held, and without those that tied rows decide (collective)."""
    count = len(found.rows.nodes)
    numbered = replace(found.rows, areas=np.arange(count, dtype=float))  # they tell which are left
    cut = cut_held(exchange, numbered, held, 0.0, one_sided=False)
    cut = cut.of(undecided(exchange.comm, cut, tied))
    left = cut.areas.astype(np.int64)
    rows = replace(cut, areas=found.rows.areas[left])
    return FrictionRows(rows, found.coefficients[left], found.limits[left])


def _held_at(nodes: NDArray[np.int64], held: HeldRows) -> NDArray[np.bool_] | None:
    """Which components of some nodes are held, (n, d); None where nothing is held."""
    if not len(held.nodes):
        return None
    at = np.minimum(np.searchsorted(held.nodes, nodes), len(held.nodes) - 1)
    return np.asarray((held.nodes[at] == nodes)[:, None] & held.held[at])


def _tangents(rows: ContactRows, fixed: NDArray[np.bool_] | None) -> tuple[Array, Array]:
    """Unit tangents of contact rows, and the length that held components leave of each.

    (rows, d - 1, d) and (rows, d - 1).

    Parameters
    ----------
    fixed : (rows, d)
        Held components; tangents are turned to suit them.
    """
    normal = rows.normals / np.linalg.norm(rows.normals, axis=1, keepdims=True)
    d = normal.shape[1]
    if d == 2:
        tangents = np.stack([-normal[:, 1], normal[:, 0]], axis=1)[:, None]
    else:
        axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
        first = axis - np.einsum("ni,ni->n", axis, normal)[:, None] * normal
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        tangents = np.stack([first, np.cross(normal, first)], axis=1)
    along = np.ones(tangents.shape[:2])
    if fixed is None or not len(normal):
        return tangents, along
    some = np.flatnonzero(fixed.any(axis=1))
    left = np.where(fixed[some, None], 0.0, tangents[some])
    turn, along[some], _ = np.linalg.svd(left, full_matrices=False)
    tangents[some] = np.swapaxes(turn, 1, 2) @ tangents[some]
    return tangents, along


def _at_obstacle(own: ContactRows, tangents: Array) -> ContactRows:
    """Slips along tangents (rows, d - 1, d) with the weights that contact rows have on nodes."""
    d = tangents.shape[2]
    both = ContactEntries.join([own.entries, own.held], [0, 0])
    key, first, place = np.unique(
        np.stack([both.row, both.node]), axis=1, return_index=True, return_inverse=True
    )
    push = np.zeros((key.shape[1], d))
    np.add.at(push, (place.reshape(-1), both.component), both.value)
    size = np.linalg.norm(push, axis=1)
    weight = -np.sign(np.einsum("ei,ei->e", push, own.normals[key[0]])) * size
    return _rows(own, tangents, key[0], key[1], both.points[first], weight)


def _rows(
    own: ContactRows,
    tangents: Array,
    row: NDArray[np.int64],
    node: NDArray[np.int64],
    points: Array,
    weight: Array,
) -> ContactRows:
    """Rows Σ weight t · u[node] of all tangents, those of a contact row one after another.

    Parameters
    ----------
    row, node, points, weight : (entries,), …, (entries, 3), (entries,)
        Weights of nodes in each contact row.
    """
    count, k, d = tangents.shape
    value = weight[:, None, None] * tangents[row]
    entry, tangent, component = np.nonzero(np.abs(value) > 1e-14)
    force = np.zeros((len(row), k, 3))
    force[..., :d] = -value
    turned = np.cross((points - own.points[row])[:, None], force)
    total = np.zeros((count, k, 3))
    np.add.at(total, row, turned)
    entries = ContactEntries(
        row[entry] * k + tangent, node[entry], points[entry], component,
        value[entry, tangent, component],
    )  # fmt: skip
    return _record(own, tangents, total, entries)


def _record(
    own: ContactRows, tangents: Array, turned: Array, entries: ContactEntries
) -> ContactRows:
    """Tangential rows of contact rows.

    Parameters
    ----------
    turned : (rows, d - 1, 3)
        Moments about the nodes.
    """
    k, d = tangents.shape[1:]
    return ContactRows(
        nodes=np.repeat(own.nodes, k),
        points=np.repeat(own.points, k, axis=0),
        sources=np.repeat(own.sources, k),
        gaps=np.zeros(k * len(own.nodes)),
        normals=-tangents.reshape(-1, d),
        moments=turned.reshape(-1, 3),
        areas=np.repeat(own.areas, k),
        spread=np.ones(k * len(own.nodes)),
        entries=entries,
    )


def _jumps(
    scene: Scene, partition: Partition, exchange: NodeExchange, number: int, held: HeldRows
) -> MeanJumps:
    """Mean jumps of the displacements of a pair, of all ranks (collective)."""
    pair = scene.touching[number]
    assert isinstance(pair, BodyContact)
    sides: list[Surface] = []
    for body, boundary in ((pair.body, pair.boundary), (pair.other, pair.other_boundary)):
        side = gather_surface(scene, partition, facets_of(scene, partition, body, boundary))
        assert side is not None  # its contact rows were written
        sides.append(side)
    return mean_jumps(sides[0], sides[1], decided_by(exchange, held), gives=False)


def _between(own: ContactRows, tangents: Array, jumps: Sequence[ContactRows]) -> ContactRows:
    """Mean jumps of each component along tangents (rows, d - 1, d)."""
    k, count = tangents.shape[1], len(own.nodes)
    place = np.full(len(jumps[0].nodes), -1, np.int64)
    at = np.searchsorted(jumps[0].nodes, own.nodes)
    place[at] = np.arange(count)
    turned, parts = np.zeros((count, k, 3)), []
    for component, jump in enumerate(jumps):
        share = tangents[:, :, component]
        turned += share[:, :, None] * jump.moments[at][:, None]
        entries, row = jump.entries, place[jump.entries.row]
        for tangent in range(k):
            value = np.where(row >= 0, share[row, tangent], 0.0) * entries.value
            some = value != 0.0
            parts.append(
                ContactEntries(
                    row[some] * k + tangent, entries.node[some], entries.points[some],
                    entries.component[some], value[some],
                )
            )  # fmt: skip
    joined = ContactEntries.join(parts, [0] * len(parts))
    return _record(own, tangents, turned, joined)


def _shares(
    scene: Scene,
    partition: Partition,
    exchange: NodeExchange,
    touching: Contact | BodyContact,
    nodes: NDArray[np.int64],
) -> Array:
    """∫ φ_k over the boundary of a contact at some nodes this rank owns, (n,) (collective)."""
    every, values = [np.zeros(0, np.int64)], [np.zeros(0)]
    chosen = facets_of(scene, partition, touching.body, touching.boundary)
    for s, rows in zip(partition.subdomains, chosen, strict=True):
        if len(rows):
            facets = s.reference.facets[rows]
            share = moments(s.points()[facets], scene.dimension).sum(axis=1)
            every.append(s.nodes[facets].ravel())
            values.append(share.ravel())
    meeting = NodeExchange(partition.comm, np.concatenate(every), exchange.total)
    share = meeting.to_owners(np.concatenate(values))
    known, place = np.unique(meeting.nodes, return_inverse=True)
    sums = np.bincount(place.reshape(-1), share, len(known))
    at = np.minimum(np.searchsorted(known, nodes), max(len(known) - 1, 0))
    if not len(known):
        return np.zeros(len(nodes))
    return np.where(known[at] == nodes, sums[at], 0.0)
