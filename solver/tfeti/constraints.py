"""The rows of B: gluing, held unknowns, contact; orthonormal wherever geometry allows it.

Total FETI tears the bodies apart and puts every condition into one constraint matrix, B u = c on
gluing and held rows, B u ≤ c on contact rows. All copies of a node meet at its owner, who writes
the rows of that node:

held components
    one row for each copy, u = value; these make gluing rows of the same component redundant, so
    none are written.
gluing
    for each component that is not held, with m copies, the m - 1 Helmert rows: an orthonormal
    basis of the complement of (1, …, 1).
contact
    ĉᵀ u ≤ g on the mean of the copies, scaled to unit length: the row (ĉ, …, ĉ)/√m is orthogonal
    to the gluing rows. ĉ is the direction into the obstacle, -n, cut to the components that are
    not held; if nothing is left the row is decided by the held values and dropped. Of rows in the
    same direction only the tightest stays.

So B Bᵀ = I except where a node touches several planes that are not perpendicular, and B has full
row rank however the conditions overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from solver.tfeti.exchange import NodeExchange

PARALLEL = 1e-10
"""Two unit directions closer than this are one."""


class RowKind(IntEnum):
    """What a row of B stands for."""

    GLUING = 0
    DIRICHLET = 1
    CONTACT = 2
    SUPPORT = 3


class ContradictionError(ValueError):
    """Conditions on one node exclude each other.

    Attributes
    ----------
    first, second
        Sources (indices the caller gave) of the two conditions.
    node
        Global number of a node where it happens.
    amount
        By how much, in units of length.
    kind
        ``held twice`` or ``held inside an obstacle``.
    """

    def __init__(self, kind: str, first: int, second: int, node: int, amount: float) -> None:
        super().__init__(f"{kind}: conditions {first} and {second} at node {node}")
        self.kind, self.first, self.second = kind, first, second
        self.node, self.amount = node, amount


@dataclass(frozen=True, eq=False)
class NodeConditions:
    """Conditions at nodes as the subdomains of this rank see them; repetitions are harmless.

    Attributes
    ----------
    held_nodes, held_points, held, values, held_source
        Global node (k,), coordinates (k, 3), which components are held (k, dimension), to which
        displacement (k, dimension), and the index of the condition (k,).
    contact_nodes, contact_points, directions, gaps, contact_source
        Global node (k,), coordinates (k, 3), unit direction into the obstacle (k, dimension), gap
        along it (k,), and the index of the contact (k,).
    """

    held_nodes: NDArray[np.int64]
    held_points: NDArray[np.float64]
    held: NDArray[np.bool_]
    values: NDArray[np.float64]
    held_source: NDArray[np.int64]
    contact_nodes: NDArray[np.int64]
    contact_points: NDArray[np.float64]
    directions: NDArray[np.float64]
    gaps: NDArray[np.float64]
    contact_source: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class HeldRows:
    """Held nodes this rank owns: node, point (k, 3), components (k, d), values, eliminated."""

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    held: NDArray[np.bool_]
    values: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ContactRows:
    """Contact rows this rank owns, in row order.

    Attributes
    ----------
    nodes, points, sources
        Node (k,), coordinates (k, 3) and contact index (k,).
    directions : (k, dimension)
        Unit direction ĉ on the components that are not held.
    gaps : (k,)
        Largest displacement along ĉ.
    normals : (k, dimension)
        The obstacle's own normal n at the node.
    force_scale : (k,)
        Normal force of the obstacle over the force along ĉ; one unless components are held.
    copies : (k,)
        Number of copies the row is spread over: its multiplier is the force over √copies.
    """

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    sources: NDArray[np.int64]
    directions: NDArray[np.float64]
    gaps: NDArray[np.float64]
    normals: NDArray[np.float64]
    force_scale: NDArray[np.float64]
    copies: NDArray[np.int64]

    def none(self) -> ContactRows:
        """No rows."""
        return ContactRows(**{name: values[:0] for name, values in self.__dict__.items()})


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of B this rank owns, as coordinates over arrived copies.

    Attributes
    ----------
    kind, node : (rows,)
        Kind and node of each row, sorted by node, then kind.
    rhs : (rows,)
        c.
    row, copy, component, value : (entries,)
        Entries of B; `copy` counts the copies that arrived at this rank.
    """

    kind: NDArray[np.int8]
    node: NDArray[np.int64]
    rhs: NDArray[np.float64]
    row: NDArray[np.int64]
    copy: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]


def merge_held(exchange: NodeExchange, conditions: NodeConditions) -> HeldRows:
    """Bring together what holds each owned node; a component may be held twice to one value.

    Raises
    ------
    ContradictionError
        Two conditions ask different displacements of one component.
    """
    meeting = NodeExchange(exchange.comm, conditions.held_nodes, exchange.total)
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
    exchange: NodeExchange, conditions: NodeConditions, held: HeldRows, length: float
) -> ContactRows:
    """Bring together the contact rows of each owned node and drop redundant ones.

    Parameters
    ----------
    length
        A length of the scene; penetrations of held nodes below 1e-9 of it are round-off.

    Raises
    ------
    ContradictionError
        Held displacements push a node into an obstacle.
    """
    meeting = NodeExchange(exchange.comm, conditions.contact_nodes, exchange.total)
    source, points = (
        meeting.to_owners(conditions.contact_source),
        meeting.to_owners(conditions.contact_points),
    )
    direction, gap = meeting.to_owners(conditions.directions), meeting.to_owners(conditions.gaps)
    pair = np.stack([meeting.nodes, source], axis=1)
    _, chosen = np.unique(pair, axis=0, return_index=True)
    node, source, points = meeting.nodes[chosen], source[chosen], points[chosen]
    direction, gap = direction[chosen], gap[chosen]

    place = np.minimum(np.searchsorted(held.nodes, node), max(len(held.nodes) - 1, 0))
    known = (held.nodes[place] == node) if len(held.nodes) else np.zeros(len(node), bool)
    free = np.ones(direction.shape, bool)
    free[known] = ~held.held[place[known]]
    if known.any():
        gap = gap.copy()
        gap[known] -= np.einsum("ij,ij->i", direction[known], held.values[place[known]])
    cut = np.where(free, direction, 0.0)
    norm = np.linalg.norm(cut, axis=1)
    decided = norm < 1e-9
    inside = decided & (gap < -1e-9 * length)
    problem = None
    if inside.any():
        worst = int(np.argmin(np.where(inside, gap, np.inf)))
        problem = (
            "held inside an obstacle", int(source[worst]), -1, int(node[worst]), float(-gap[worst])
        )  # fmt: skip
    _raise_together(exchange, problem)

    keep = ~decided
    node, source, points, normal = node[keep], source[keep], points[keep], -direction[keep]
    scale = 1.0 / norm[keep]
    direction, gap = cut[keep] * scale[:, None], gap[keep] * scale
    keep = _tightest(node, direction, gap)
    return ContactRows(
        nodes=node[keep],
        points=points[keep],
        sources=source[keep],
        directions=direction[keep],
        gaps=gap[keep],
        normals=normal[keep],
        force_scale=scale[keep],
        copies=np.ones(int(keep.sum()), np.int64),
    )


def write_rows(
    exchange: NodeExchange,
    held: HeldRows,
    contact: ContactRows,
    eliminated: NDArray[np.bool_],
) -> tuple[Rows, ContactRows]:
    """Write the rows of the owned nodes.

    Parameters
    ----------
    eliminated : (held nodes,)
        Held nodes whose conditions are imposed in the stiffness itself: no rows.

    Returns
    -------
    The rows, and the contact rows with their number of copies filled in, in row order.
    """
    dimension = contact.directions.shape[1]
    order = np.argsort(exchange.nodes, kind="stable")
    nodes, start, copies = np.unique(exchange.nodes[order], return_index=True, return_counts=True)
    is_held = np.zeros((len(nodes), dimension), bool)
    value = np.zeros((len(nodes), dimension))
    at = np.searchsorted(nodes, held.nodes)
    is_held[at], value[at] = held.held, held.values
    skipped = np.zeros(len(nodes), bool)
    skipped[at] = eliminated

    parts: list[_Part] = []
    for m in np.unique(copies):
        group = np.flatnonzero(copies == m)
        copy = order[start[group][:, None] + np.arange(m)]
        for component in range(dimension):
            fixed = is_held[group, component]
            rows = group[fixed & ~skipped[group]]
            where = copy[fixed & ~skipped[group]]
            parts.append(
                _Part.of(
                    RowKind.DIRICHLET, nodes[rows], np.eye(m), where, component,
                    np.repeat(value[rows, component], m),
                )
            )  # fmt: skip
            if m > 1:
                where = copy[~fixed]
                parts.append(
                    _Part.of(
                        RowKind.GLUING, nodes[group[~fixed]], helmert(int(m)), where, component,
                        np.zeros(len(where) * (m - 1)),
                    )
                )  # fmt: skip
    at = np.searchsorted(nodes, contact.nodes)
    contact = ContactRows(**{**contact.__dict__, "copies": copies[at]})
    parts.append(_contact_part(contact, at, start, order, dimension))
    return _assemble(parts), contact


def helmert(m: int) -> NDArray[np.float64]:
    """Orthonormal rows (m - 1, m) that span the complement of (1, …, 1)."""
    rows = np.zeros((m - 1, m))
    for k in range(1, m):
        rows[k - 1, :k] = 1.0
        rows[k - 1, k] = -k
        rows[k - 1] /= np.sqrt(k * (k + 1.0))
    return rows


@dataclass(frozen=True, eq=False)
class _Part:
    """Rows of one kind before they are sorted into place."""

    kind: RowKind
    node: NDArray[np.int64]
    rhs: NDArray[np.float64]
    row: NDArray[np.int64]
    copy: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        kind: RowKind,
        nodes: NDArray[np.int64],
        stencil: NDArray[np.float64],
        copies: NDArray[np.int64],
        component: int,
        rhs: NDArray[np.float64],
    ) -> _Part:
        """The same stencil (rows, m) on the copies (nodes, m) of each node."""
        per_node, m = stencil.shape
        r, c = np.nonzero(stencil)
        base = np.arange(len(nodes))[:, None]
        row = (base * per_node + r).ravel()
        return cls(
            kind,
            np.repeat(nodes, per_node),
            rhs,
            row,
            copies[:, c].ravel(),
            np.full(len(row), component, np.int64),
            np.tile(stencil[r, c], len(nodes)),
        )


def _contact_part(
    contact: ContactRows,
    at: NDArray[np.int64],
    start: NDArray[np.int64],
    order: NDArray[np.int64],
    dimension: int,
) -> _Part:
    """Contact rows spread over the copies of their nodes."""
    m = contact.copies
    row = np.repeat(np.arange(len(m)), m)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(m) - m, m)
    copy = order[np.repeat(start[at], m) + nth]
    value = contact.directions[row] / np.sqrt(m[row])[:, None]
    entry, component = np.nonzero(np.abs(value) > 1e-14)
    return _Part(
        RowKind.CONTACT,
        contact.nodes,
        contact.gaps * np.sqrt(m),
        row[entry],
        copy[entry],
        component,
        value[entry, component],
    )


def _assemble(parts: list[_Part]) -> Rows:
    """Number the rows by node, then kind, then as they were written."""
    kind = np.concatenate([np.full(len(p.node), p.kind, np.int8) for p in parts])
    node = np.concatenate([p.node for p in parts])
    offsets = np.cumsum([0, *(len(p.node) for p in parts)])
    order = np.lexsort((np.arange(len(node)), kind, node))
    new = np.empty(len(node), np.int64)
    new[order] = np.arange(len(node))
    row = np.concatenate([o + p.row for o, p in zip(offsets, parts, strict=False)])
    return Rows(
        kind=kind[order],
        node=node[order],
        rhs=np.concatenate([p.rhs for p in parts])[order],
        row=new[row.astype(np.int64)],
        copy=np.concatenate([p.copy for p in parts]),
        component=np.concatenate([p.component for p in parts]),
        value=np.concatenate([p.value for p in parts]),
    )


def _tightest(
    node: NDArray[np.int64], direction: NDArray[np.float64], gap: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Mark, of the rows of one node in one direction, the one with the smallest gap."""
    keep = np.ones(len(node), bool)
    if len(node) == 0:
        return keep
    _, start, count = np.unique(node, return_index=True, return_counts=True)
    for a in range(int(count.max())):
        for b in range(a):
            both = start[count > a]
            i, j = both + b, both + a
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
