"""Tangential rows at contact points: the slip of a node, or its mean about one.

At an obstacle the slip is that of the node along a tangent of the obstacle, or, where contact rows
are means about vertices (`averaged_rows`), the same mean of it. Between bodies it is the mean jump
of the displacements with the multiplier functions of mortar contact, as of tied surfaces
(`meshes.ties`), along the tangents of the mean normal of the node: two flat surfaces that slide
against each other do so by one slip, and rigid motions of both bodies are no slip.

A tangent that displacement conditions hold has no row, since nothing slides along it. At nodes,
tangents are turned so that their free parts are orthogonal. Between bodies that are held along it
on both sides, as at a plane of symmetry, a tangent has no row either: the mean about the node would
be that of one half, which slides, where the mean of the whole does not.

The slip limit that Tresca's law is given per area acts on the area of the node, ∫ φ_k over the
boundary, or on that of the mean.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from contact_app.model.pairs import owned_rows
from contact_app.scene.conditions import Friction
from meshes.arrays import Array, Ints, Mask
from meshes.ties import MeanJumps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows, HeldRows
from solver.problem.constraints.friction import FrictionRows
from solver.problem.constraints.merge import cut_held
from solver.problem.constraints.ties import undecided

PARALLEL = 1e-8
"""Difference of the normals of a contact row and of one that was merged into it."""

HELD = 1e-8
"""Length of the free part of a unit tangent below which nothing slides along it."""

LEANING = 0.2
"""Limit of this length between bodies, whose normals are means over facets.

At the end of one half of a round side they are inclined by half the angle of a facet, 0.2 for
facets of 23°.
"""


@dataclass(frozen=True, eq=False)
class RoughContact:
    """A contact with friction."""

    number: int
    """Number of the contact, as `sources` of contact rows count it."""
    law: Friction
    shares: Callable[[Ints], Array]
    """From numbers of nodes this rank owns, (n,), to ∫ φ_k over the boundary (collective)."""
    slips: Callable[[ContactRows], tuple[ContactRows, Mask]]
    """From the contact rows of the contact to their tangential rows, and the mask of those along
    which something can slide (collective)."""

    def limits(self, rows: ContactRows) -> Array:
        """Given slip limits of contact rows, forces (rows,); zero without any (collective)."""
        if self.law.limit == 0.0:
            return np.zeros(len(rows.nodes))
        shares = self.shares(rows.nodes)
        return self.law.limit * np.where(np.isnan(rows.areas), shares, rows.areas)


def tangential_rows(
    exchange: NodeExchange,
    rough: Sequence[RoughContact],
    contact: ContactRows,
    merged: ContactRows,
    held: HeldRows,
    tied: ContactRows,
) -> FrictionRows:
    """The tangential rows of contacts with friction (collective).

    Parameters
    ----------
    rough
        In the order of their numbers.
    contact, held, tied
        Contact rows, held nodes and tied rows this rank owns.
    merged
        Rows that a tighter contact row of the same node makes redundant: it takes over the slip
        limits that are given of their contacts.
    """
    if not rough:
        return FrictionRows.none(contact)
    d = contact.normals.shape[1]
    parts, coefficients, limits = [contact.none()], [np.zeros(0)], [np.zeros(0)]
    reused = _taken_over(rough, contact, merged)
    for each in rough:
        of_contact = contact.sources == each.number
        of_contact_rows = contact.of(of_contact)
        rows, is_free = each.slips(of_contact_rows)
        parts.append(rows.of(is_free))
        limits.append(np.repeat(each.limits(of_contact_rows) + reused[of_contact], d - 1)[is_free])
        coefficients.append(np.full(int(is_free.sum()), each.law.coefficient))
    of_rows, of_limits = np.concatenate(coefficients), np.concatenate(limits)
    nodes, sources = (np.concatenate([getattr(p, n) for p in parts]) for n in ("nodes", "sources"))
    order = np.lexsort((sources, nodes))  # as `join` sorts them
    slip_rows = FrictionRows(ContactRows.join(parts), of_rows[order], of_limits[order])
    return _without_held(exchange, slip_rows, held, tied)


def slips_at_obstacle(contact: ContactRows, held: HeldRows | None) -> tuple[ContactRows, Mask]:
    """Slips at the contact rows of an obstacle, and the mask of those that are not held.

    Parameters
    ----------
    held
        Held nodes, to which tangents are turned; None where the obstacle moves.
    """
    fixed = None if held is None or contact.wide.any() else _held_at(contact.nodes, held)
    tangents, along = _tangents(contact, fixed)
    return _at_obstacle(contact, tangents), along.ravel() > HELD


def slips_between(
    exchange: NodeExchange, contact: ContactRows, jumps: MeanJumps, number: int
) -> tuple[ContactRows, Mask]:
    """Slips at the contact rows of a pair, and the mask of those not held (collective).

    Parameters
    ----------
    jumps
        Mean jumps of the displacements of the pair, of all ranks.
    number
        Of the contact.
    """
    tangents, along = _tangents(contact, jumps.held[np.searchsorted(jumps.nodes, contact.nodes)])
    owned = [owned_rows(exchange, rows, number) for rows in jumps.rows]
    return _between(contact, tangents, owned), along.ravel() > LEANING


def summed_at(exchange: NodeExchange, every: Ints, values: Array, nodes: Ints) -> Array:
    """Sums over all ranks of values at nodes, at some nodes this rank owns, (n,) (collective).

    Parameters
    ----------
    every, values : (k,), (k,)
        Nodes of any ranks, repeated ones, too.
    """
    meeting = NodeExchange(exchange.comm, every, exchange.total)
    arrived = meeting.to_owners(values)
    distinct, place = np.unique(meeting.nodes, return_inverse=True)
    sums = np.bincount(place.reshape(-1), arrived, len(distinct))
    if not len(distinct):
        return np.zeros(len(nodes))
    at = np.minimum(np.searchsorted(distinct, nodes), len(distinct) - 1)
    return np.where(distinct[at] == nodes, sums[at], 0.0)


def _taken_over(rough: Sequence[RoughContact], contact: ContactRows, merged: ContactRows) -> Array:
    """Slip limits of contact rows that come from merged ones, forces (rows,) (collective)."""
    result = np.zeros(len(contact.nodes))
    for each in rough:
        merged_rows = merged.of(merged.sources == each.number)
        limit = each.limits(merged_rows)
        first = np.searchsorted(contact.nodes, merged_rows.nodes)
        last = np.searchsorted(contact.nodes, merged_rows.nodes, side="right")
        is_reused = np.zeros(len(limit), bool)
        for nth in range(int((last - first).max(initial=0))):
            at = np.minimum(first + nth, max(len(contact.nodes) - 1, 0))
            same = ~is_reused & (first + nth < last)
            difference = np.abs(contact.normals[at] - merged_rows.normals).max(axis=1, initial=0.0)
            same &= difference < PARALLEL
            np.add.at(result, at[same], limit[same])
            is_reused |= same
    return result


def _without_held(
    exchange: NodeExchange, slips: FrictionRows, held: HeldRows, tied: ContactRows
) -> FrictionRows:
    """Rows without held components and without rows that tied rows determine (collective)."""
    count = len(slips.rows.nodes)
    numbered = replace(slips.rows, areas=np.arange(count, dtype=float))  # the areas number the rows
    cut = cut_held(exchange, numbered, held, 0.0, sides=0)
    cut = cut.of(undecided(exchange.comm, cut, tied))
    remaining = cut.areas.astype(np.int64)
    rows = replace(cut, areas=slips.rows.areas[remaining])
    return FrictionRows(rows, slips.coefficients[remaining], slips.limits[remaining])


def _held_at(nodes: Ints, held: HeldRows) -> Mask | None:
    """Mask of the held components of some nodes, (n, d); None if nothing is held."""
    if not len(held.nodes):
        return None
    at = np.minimum(np.searchsorted(held.nodes, nodes), len(held.nodes) - 1)
    return np.asarray((held.nodes[at] == nodes)[:, None] & held.held[at])


def _tangents(rows: ContactRows, fixed: Mask | None) -> tuple[Array, Array]:
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
    free = np.where(fixed[some, None], 0.0, tangents[some])
    turn, along[some], _ = np.linalg.svd(free, full_matrices=False)
    tangents[some] = np.swapaxes(turn, 1, 2) @ tangents[some]
    return tangents, along


def _at_obstacle(contact: ContactRows, tangents: Array) -> ContactRows:
    """Slips along tangents (rows, d - 1, d) with the weights that contact rows have on nodes."""
    count, k, d = tangents.shape
    both = ContactEntries.join([contact.entries, contact.held], [0, 0])
    key, first, place = np.unique(
        np.stack([both.row, both.node]), axis=1, return_index=True, return_inverse=True
    )
    push = np.zeros((key.shape[1], d))
    np.add.at(push, (place.reshape(-1), both.component), both.value)
    size = np.linalg.norm(push, axis=1)
    weight = -np.sign(np.einsum("ei,ei->e", push, contact.normals[key[0]])) * size
    row, points = key[0], both.points[first]
    value = weight[:, None, None] * tangents[row]
    entry, tangent, component = np.nonzero(np.abs(value) > 1e-14)
    force = np.zeros((len(row), k, 3))
    force[..., :d] = -value
    turned = np.cross((points - contact.points[row])[:, None], force)
    total = np.zeros((count, k, 3))
    np.add.at(total, row, turned)
    entries = ContactEntries(
        row[entry] * k + tangent, key[1][entry], points[entry], component,
        value[entry, tangent, component],
    )  # fmt: skip
    return _record(contact, tangents, total, entries)


def _record(
    contact: ContactRows, tangents: Array, turned: Array, entries: ContactEntries
) -> ContactRows:
    """Tangential rows of contact rows.

    Parameters
    ----------
    turned : (rows, d - 1, 3)
        Moments about the nodes.
    """
    k, d = tangents.shape[1:]
    return ContactRows(
        nodes=np.repeat(contact.nodes, k),
        points=np.repeat(contact.points, k, axis=0),
        sources=np.repeat(contact.sources, k),
        gaps=np.zeros(k * len(contact.nodes)),
        normals=-tangents.reshape(-1, d),
        moments=turned.reshape(-1, 3),
        areas=np.repeat(contact.areas, k),
        spread=np.ones(k * len(contact.nodes)),
        entries=entries,
    )


def _between(contact: ContactRows, tangents: Array, jumps: Sequence[ContactRows]) -> ContactRows:
    """Mean jumps of each component along tangents (rows, d - 1, d)."""
    k, count = tangents.shape[1], len(contact.nodes)
    place = np.full(len(jumps[0].nodes), -1, np.int64)
    at = np.searchsorted(jumps[0].nodes, contact.nodes)
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
    return _record(contact, tangents, turned, joined)
