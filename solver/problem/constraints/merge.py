"""Merging of the conditions of all ranks: equal conditions become one, contradictions are errors.

Of parallel contact rows of one node only the tightest remains. Held components move from contact
rows to the right-hand sides.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import (
    ContactEntries,
    ContactRows,
    ContradictionError,
    HeldRows,
    NodeConditions,
    pairs_at_nodes,
    unit_rows,
)
from solver.vectors import Array, Ints, Mask

MOSTLY_HELD = 0.1
"""Sum of the coefficients of free components of a row in the mean, over that of all, below which
the row is as good as held. Where two bodies are held along a common edge, the mean gap about its
nodes depends on free nodes with factors down to rounding errors, and the force of the row would be
the forces on those nodes divided by these factors."""

PARALLEL = 1e-10
"""Unit directions closer than this count as parallel."""


def merge_held(exchange: NodeExchange, conditions: NodeConditions) -> HeldRows:
    """Merge the displacement conditions of each owned node; equal values may repeat (collective).

    Raises
    ------
    ContradictionError
        Two conditions ask different displacements of one component.
    """
    meeting = exchange.among(conditions.held_nodes)
    held, values = meeting.to_owners(conditions.held), meeting.to_owners(conditions.values)
    source, points = (
        meeting.to_owners(conditions.held_source),
        meeting.to_owners(conditions.held_points),
    )
    nodes, first, place = np.unique(meeting.nodes, return_index=True, return_inverse=True)
    merged = np.zeros((len(nodes), held.shape[1]), bool)
    np.logical_or.at(merged, place, held)
    lowest = np.full(merged.shape, np.inf)
    np.minimum.at(lowest, place, np.where(held, values, np.inf))
    conflict = held & (np.abs(values - lowest[place]) > 1e-12 * np.abs(values))
    problem = None
    if conflict.any():
        at, component = np.argwhere(conflict)[0]
        same = np.flatnonzero((place == place[at]) & held[:, component])
        other = same[np.argmin(values[same, component])]
        amount = float(values[at, component] - values[other, component])
        problem = ("held twice", int(source[other]), int(source[at]), int(nodes[place[at]]), amount)
    _raise_together(exchange, problem)
    return HeldRows(nodes, points[first], merged, np.where(merged, lowest, 0.0))


def merge_contact(
    exchange: NodeExchange,
    conditions: NodeConditions,
    held: HeldRows,
    length: float,
    means: Sequence[ContactRows] = (),
) -> tuple[ContactRows, ContactRows]:
    """Merge the contact rows of each owned node and drop redundant ones (collective).

    Parameters
    ----------
    length
        A length of the scene; penetrations of held nodes below 1e-9 of it are round-off.
    means
        Rows of contacts in the mean, before held components are removed.

    Returns
    -------
    The remaining rows, and the rows that a tighter parallel row makes redundant.

    Raises
    ------
    ContradictionError
        Held displacements push a node into an obstacle, or two obstacles leave it no room.
    """
    rows = cut_held(exchange, contact_rows(exchange, conditions), held, length)
    cut = np.zeros_like(rows.normals)
    cut[rows.entries.row, rows.entries.component] = rows.entries.value
    norm = np.linalg.norm(cut, axis=1)
    direction, gap = cut / norm[:, None], rows.gaps / norm
    _raise_together(exchange, _squeezed(rows, direction, gap, 1e-9 * length))
    keep = tightest_of_each_node(rows.nodes, direction, gap)
    remaining, redundant = rows.of(keep), rows.of(~keep)
    if not means:
        return remaining, redundant
    free = [cut_held(exchange, mean, held, length) for mean in means]
    remaining, parallel = drop_parallel(exchange, ContactRows.join([remaining, *free]), length)
    return remaining, ContactRows.join([redundant, parallel])


def contact_rows(exchange: NodeExchange, conditions: NodeConditions) -> ContactRows:
    """The contact rows of each owned node, one per contact (collective)."""
    meeting = exchange.among(conditions.contact_nodes)
    source, points = (
        meeting.to_owners(conditions.contact_source),
        meeting.to_owners(conditions.contact_points),
    )
    direction, gap = meeting.to_owners(conditions.directions), meeting.to_owners(conditions.gaps)
    pair = np.stack([meeting.nodes, source], axis=1)
    _, chosen = np.unique(pair, axis=0, return_index=True)
    node, points, direction = meeting.nodes[chosen], points[chosen], direction[chosen]
    row, component = np.nonzero(np.abs(direction) > 1e-14)
    return ContactRows(
        nodes=node,
        points=points,
        sources=source[chosen],
        gaps=gap[chosen],
        normals=-direction,
        moments=np.zeros((len(node), 3)),
        areas=np.full(len(node), np.nan),
        spread=np.ones(len(node)),
        entries=ContactEntries(row, node[row], points[row], component, direction[row, component]),
    )


def drop_parallel(
    exchange: NodeExchange, rows: ContactRows, length: float
) -> tuple[ContactRows, ContactRows]:
    """Keep the tightest of parallel rows of one node, where one of them is a row in the mean.

    `merge_contact` has done so already for rows at single nodes.

    Parameters
    ----------
    rows
        Sorted by node, without held components.
    length
        As in `merge_contact`.

    Returns
    -------
    The remaining rows, and the dropped ones.

    Raises
    ------
    ContradictionError
        Two opposite rows leave no room.
    """
    matrix, norm = unit_rows(rows)
    gap = rows.gaps / norm
    keep = np.ones(len(rows.nodes), bool)
    problem = None
    for i, j in pairs_at_nodes(rows.nodes):
        cosine = np.asarray(matrix[i].multiply(matrix[j]).sum(axis=1)).ravel()
        mean = ~(np.isnan(rows.areas[i]) & np.isnan(rows.areas[j]))
        same = mean & (cosine > 1.0 - PARALLEL) & keep[i] & keep[j]
        keep[np.where(gap[i] <= gap[j], j, i)[same]] = False
        opposite = mean & (cosine < PARALLEL - 1.0)
        tight = np.flatnonzero(opposite & (gap[i] + gap[j] < -1e-9 * length))
        if len(tight):
            k = int(tight[np.argmin((gap[i] + gap[j])[tight])])
            problem = (
                "squeezed", int(rows.sources[i[k]]), int(rows.sources[j[k]]),
                int(rows.nodes[i[k]]), float(-(gap[i[k]] + gap[j[k]]) * norm[i[k]]),
            )  # fmt: skip
    _raise_together(exchange, problem)
    return rows.of(keep), rows.of(~keep)


def cut_held(
    exchange: NodeExchange, rows: ContactRows, held: HeldRows, length: float, sides: int = 1
) -> ContactRows:
    """Move held components from the rows to their gaps; rows without other entries are dropped.

    Parameters
    ----------
    length
        As in `merge_contact`.
    sides
        From how many sides held displacements may violate a row: 1 for contact, 2 for equations, 0
        for tangential rows.

    Raises
    ------
    ContradictionError
        Held displacements alone violate a row.
    """
    entries = rows.entries
    query = exchange.among(entries.node)
    component = query.to_owners(entries.component)
    fixed, value = np.zeros(len(component), bool), np.zeros(len(component))
    if len(held.nodes):
        at = np.minimum(np.searchsorted(held.nodes, query.nodes), len(held.nodes) - 1)
        fixed = (held.nodes[at] == query.nodes) & held.held[at, component]
        value = np.where(fixed, held.values[at, component], 0.0)
    fixed, value = query.from_owners(fixed), query.from_owners(value)
    count = len(rows.nodes)
    gaps = rows.gaps - np.bincount(entries.row, entries.value * value, minlength=count)
    left = np.bincount(entries.row, np.where(fixed, 0.0, entries.value**2), minlength=count)
    decided, rounding = (left < 1e-18) & ~rows.on_rigid, 1e-9 * length
    if sides == 1:
        size = np.abs(entries.value)
        every = np.bincount(entries.row, size, minlength=count)
        free_part = np.bincount(entries.row, np.where(fixed, 0.0, size), minlength=count)
        weak = rows.wide & (free_part < MOSTLY_HELD * every) & ~rows.on_rigid
        decided |= weak & (gaps >= -rounding)
    excess = np.where(decided, np.abs(gaps) if sides == 2 else -gaps, -np.inf)
    problem = None
    if sides and excess.max(initial=-np.inf) > rounding:
        worst = int(np.argmax(excess))
        problem = (
            "held in contact", int(rows.sources[worst]), -1, int(rows.nodes[worst]),
            float(excess[worst]),
        )  # fmt: skip
    _raise_together(exchange, problem)
    free, cut = entries.some(~fixed), entries.some(fixed)
    return replace(rows, gaps=gaps, entries=free, held=cut).of(~decided)


def _squeezed(rows: ContactRows, direction: Array, gap: Array, least: float) -> tuple | None:
    """The worst node that two rows in opposite directions leave no room, as a contradiction.

    If a node is free to move in one direction only, any two obstacles can leave it no room.
    """
    problem, worst = None, -least
    for i, j in pairs_at_nodes(rows.nodes):
        opposite = np.linalg.norm(direction[i] + direction[j], axis=1) < PARALLEL
        room = np.where(opposite, gap[i] + gap[j], np.inf)
        if len(room) and room.min() < worst:
            k = int(np.argmin(room))
            worst = float(room[k])
            problem = (
                "squeezed", int(rows.sources[i[k]]), int(rows.sources[j[k]]),
                int(rows.nodes[i[k]]), -worst,
            )  # fmt: skip
    return problem


def tightest_of_each_node(node: Ints, direction: Array, gap: Array) -> Mask:
    """Mark, of the rows of one node in one direction, the one with the smallest gap."""
    keep = np.ones(len(node), bool)
    for i, j in pairs_at_nodes(node):
        same = np.linalg.norm(direction[i] - direction[j], axis=1) < PARALLEL
        same &= keep[i] & keep[j]
        looser = np.where(gap[i] <= gap[j], j, i)
        keep[looser[same]] = False
    return keep


def _raise_together(exchange: NodeExchange, problem: tuple | None) -> None:
    """Raise the first rank's problem on every rank."""
    problems = [p for p in exchange.comm.allgather(problem) if p is not None]
    if problems:
        raise ContradictionError(*problems[0])
