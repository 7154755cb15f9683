"""The rows of B: gluing, held unknowns, contact; orthonormal wherever geometry allows it.

Total FETI tears the bodies apart and puts every condition into one constraint matrix, B u = c on
gluing and held rows, B u ≤ c on contact rows. All copies of a node meet at its owner, who writes
the rows of that node:

held components
    one row for each copy, u = value; these make gluing rows of the same component redundant, so
    none are written.
gluing
    for each component that is not held, with m copies, m - 1 rows: an orthonormal basis of the
    complement of (1, …, 1), which `cross_points` chooses and weighs.
contact
    Σ a_k ū_k ≤ g on the means ū of the copies of one node or of several (which other ranks may
    own): each coefficient is shared equally by the m copies, a_k/m, which is orthogonal to the
    gluing rows, and the row is scaled to unit length. Held components go to the right-hand side;
    if nothing is left the row is decided by the held values and dropped. At an obstacle a is the
    direction into it, -n, at one node, and of rows in the same direction only the tightest stays.

tangential
    the slip along a tangent at a contact point with friction; a multiplier of either sign. All
    rows of a point are scaled alike, so that the bound on its friction force is a disc.
tied
    the same with equality: the mean jump of two surfaces, component by component.

So B Bᵀ = I except where contact and tied rows share nodes and are not perpendicular, and the rows
of obstacles, gluing and held unknowns have full rank however the conditions overlap.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from solver.contact.row_kinds import RowKind
from solver.tfeti.constraints.cross_points import Neighbours, coarse_solves_matter
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.options import TotalFetiOptions

MOST_COMPONENTS = 3
"""Components a node has at most."""

PARALLEL = 1e-10
"""Two unit directions closer than this are one."""


SHARED = RowKind.CONTACT, RowKind.TANGENT, RowKind.TIED
"""Kinds of rows over nodes that other ranks may own, in the order of their entries."""


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
        ``held twice``; ``held in contact``: inside what it may touch; ``squeezed`` between two
        obstacles.
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

    def of_contacts(self, some: NDArray[np.bool_]) -> NodeConditions:
        """The same with some of the contact rows (k,)."""
        names = ("contact_nodes", "contact_points", "directions", "gaps", "contact_source")
        return replace(self, **{name: getattr(self, name)[some] for name in names})


@dataclass(frozen=True, eq=False)
class HeldRows:
    """Held nodes this rank owns: node, point (k, 3), components (k, d), values, eliminated."""

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    held: NDArray[np.bool_]
    values: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ContactEntries:
    """Entries of contact rows, over nodes that any rank may own.

    Attributes
    ----------
    row : (entries,)
        Row among those of this rank.
    node, points, component, value : (entries,), (entries, 3), (entries,), (entries,)
        Node, its coordinates, component of the displacement and coefficient.
    """

    row: NDArray[np.int64]
    node: NDArray[np.int64]
    points: NDArray[np.float64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]

    @classmethod
    def none(cls) -> ContactEntries:
        """No entries."""
        number = np.zeros(0, np.int64)
        return cls(number, number, np.zeros((0, 3)), number, np.zeros(0))

    @classmethod
    def join(cls, parts: Sequence[ContactEntries], rows: Sequence[int]) -> ContactEntries:
        """The entries of parts that have so many rows, one after another."""
        starts = np.cumsum([0, *rows])[:-1]
        fields = [{**p.__dict__, "row": p.row + s} for p, s in zip(parts, starts, strict=True)]
        return cls(**{name: np.concatenate([f[name] for f in fields]) for name in fields[0]})

    def of_rows(self, keep: NDArray[np.bool_]) -> ContactEntries:
        """The entries of some rows (rows,), renumbered."""
        mine = keep[self.row]
        kept = ContactEntries(**{name: values[mine] for name, values in self.__dict__.items()})
        return replace(kept, row=(np.cumsum(keep) - 1)[kept.row])


ENTRIES = ("entries", "held", "rigid")
"""Fields of `ContactRows` that have entries instead of a value for each row."""


@dataclass(frozen=True, eq=False)
class ContactRows:
    """Contact rows this rank owns, Σ value · ū ≤ gap, sorted by node and then by contact.

    Attributes
    ----------
    nodes, points, sources
        Node a row belongs to (k,), its coordinates (k, 3) and contact index (k,).
    gaps : (k,)
        Distance left, by which the held part has been reduced.
    normals : (k, dimension)
        Force on the body for a multiplier of one: the normal out of what it touches.
    moments : (k, 3)
        Moment of that force about the node: zero unless the row has several nodes of the body.
    areas : (k,)
        Area on which the multiplier acts; NaN where it is the node's share of the boundary.
    spread : (k,)
        One over the length of the row on the copies: the multiplier of the scaled row times it is
        the force, its residual over it the distance.
    entries
        The coefficients, without held components.
    held
        The coefficients of held components, where `cut_held` took them out.
    rigid
        The coefficients of the motions of rigid bodies, at the nodes that stand for these. They
        count neither for the length of a row nor for whether it is wide: no stiffness resists them.
    """

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    sources: NDArray[np.int64]
    gaps: NDArray[np.float64]
    normals: NDArray[np.float64]
    moments: NDArray[np.float64]
    areas: NDArray[np.float64]
    spread: NDArray[np.float64]
    entries: ContactEntries
    held: ContactEntries = field(default_factory=ContactEntries.none)
    rigid: ContactEntries = field(default_factory=ContactEntries.none)

    @property
    def on_rigid(self) -> NDArray[np.bool_]:
        """Which rows have entries at a rigid body, (k,)."""
        result = np.zeros(len(self.nodes), bool)
        result[self.rigid.row] = True
        return result

    @property
    def wide(self) -> NDArray[np.bool_]:
        """Which rows have entries at several nodes, (k,)."""
        pairs = np.unique(np.stack([self.entries.row, self.entries.node], axis=1), axis=0)
        return np.bincount(pairs[:, 0], minlength=len(self.nodes)) > 1

    @classmethod
    def join(cls, parts: Sequence[ContactRows]) -> ContactRows:
        """Rows of several parts, sorted."""
        fields = [f for f in cls.__dataclass_fields__ if f not in ENTRIES]
        joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in fields}
        counts = [len(p.nodes) for p in parts]
        entries: dict[str, Any] = {
            name: ContactEntries.join([getattr(p, name) for p in parts], counts) for name in ENTRIES
        }
        order = np.lexsort((joined["sources"], joined["nodes"]))
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        return cls(
            **{name: values[order] for name, values in joined.items()},
            **{name: replace(own, row=place[own.row]) for name, own in entries.items()},
        )

    def of(self, keep: NDArray[np.bool_]) -> ContactRows:
        """Some of the rows, (k,)."""
        fields = {
            name: v.of_rows(keep) if name in ENTRIES else v[keep]
            for name, v in self.__dict__.items()
        }
        return ContactRows(**fields)

    def none(self) -> ContactRows:
        """No rows."""
        return self.of(np.zeros(len(self.nodes), bool))


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of B this rank owns, as coordinates over arrived copies.

    Attributes
    ----------
    kind, node : (rows,)
        Kind and node of each row, sorted by node, then kind.
    rhs : (rows,)
        c.
    weight : (rows,)
        Weights of gluing rows in a coarse problem that joins neighbours alone, others one.
    row, copy, component, value : (entries,)
        Entries of gluing and held rows; `copy` counts the copies that arrived at this rank.
    contact
        Entries of contact rows, after these of tangential and of tied rows.
    """

    kind: NDArray[np.int8]
    node: NDArray[np.int64]
    rhs: NDArray[np.float64]
    weight: NDArray[np.float64]
    row: NDArray[np.int64]
    copy: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]
    contact: SharedEntries

    @property
    def _shared(self) -> NDArray[np.int64]:
        """Places of contact rows, after these of tangential and of tied rows."""
        return np.concatenate([np.flatnonzero(self.kind == kind) for kind in SHARED])

    def touched(self, arrived: int, dimension: int) -> NDArray[np.bool_]:
        """Which components of the arrived copies some row touches (collective)."""
        touched = np.zeros((arrived, dimension), bool)
        touched[self.copy, self.component] = True
        self.contact.mark(touched)
        return touched

    def held_unknowns(self, dimension: int) -> NDArray[np.int64]:
        """Unknown that each held row holds, node · dimension + component, (rows,); else -1."""
        result = np.full(len(self.kind), -1, np.int64)
        mine = self.kind[self.row] == RowKind.DIRICHLET  # each has one entry
        row = self.row[mine]
        result[row] = self.node[row] * dimension + self.component[mine]
        return result

    def entries(
        self, columns: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Row, column and value of all entries of B (collective).

        Parameters
        ----------
        columns : (arrived, dimension)
            Column of each component of the arrived copies.
        """
        row, column, value = self.contact.spread_over(columns)
        return (
            np.concatenate([self.row, self._shared[row]]),
            np.concatenate([columns[self.copy, self.component], column]),
            np.concatenate([self.value, value]),
        )


class SharedEntries:
    """Coefficients at nodes that other ranks may own, shared equally by the copies of a node.

    Parameters
    ----------
    exchange
        Where the copies meet.
    entries
        Entries of rows of this rank, of any length; in B they have unit length.
    together : (rows,)
        Numbers from 0 on, the same for rows that are scaled alike: by the longest of them.
    rigid
        Entries at rigid bodies, which do not count for the length; where a row has no others, it
        is as long as these make it.

    Attributes
    ----------
    lengths : (rows,)
        Length of each unscaled row on the copies, or the longest of those scaled alike.
    """

    def __init__(
        self,
        exchange: NodeExchange,
        entries: ContactEntries,
        together: NDArray[np.int64],
        rigid: ContactEntries,
    ) -> None:
        own, rows = len(entries.row), len(together)
        entries = ContactEntries.join([entries, rigid], [0, 0])
        self._entries = entries
        self._order = np.argsort(exchange.nodes, kind="stable")
        self._query = exchange.among(entries.node)
        nodes, start, count = np.unique(
            exchange.nodes[self._order], return_index=True, return_counts=True
        )
        at = np.searchsorted(nodes, self._query.nodes)
        self._start, self._count = start[at], count[at]
        self._components = self._query.to_owners(entries.component)
        self.copies = self._query.from_owners(self._count)
        share = entries.value**2 / self.copies
        square, of_rigid = (
            np.bincount(entries.row[some], share[some], minlength=rows)
            for some in (slice(own), slice(own, None))
        )
        longest = np.zeros(int(together.max(initial=-1)) + 1)
        np.maximum.at(longest, together, np.where(square > 0.0, square, of_rigid))
        self.lengths: NDArray[np.float64] = np.sqrt(longest)[together]

    def mark(self, touched: NDArray[np.bool_]) -> None:
        """Mark the components (arrived, dimension) of arrived copies the entries touch."""
        copy, nth = self._asked_copies()
        touched[copy, self._components[nth]] = True

    def spread_over(
        self, columns: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Row, column and value on the copies, rows of unit length; `columns` as in `Rows`."""
        comm = self._query.comm
        most = comm.allreduce(int(self._count.max(initial=0)), op=MPI.MAX)
        found = np.full((len(self._count), most), -1, np.int64)
        copy, asked = self._asked_copies()
        found[asked, self._nth(asked)] = columns[copy, self._components[asked]]
        found = self._query.from_owners(found)
        entry, place = np.nonzero(found >= 0)
        row = self._entries.row[entry]
        value = (self._entries.value / self.copies)[entry] / self.lengths[row]
        return row, found[entry, place], value

    def _asked_copies(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Arrived copies of the nodes asked for, and the question each answers."""
        asked = np.repeat(np.arange(len(self._count)), self._count)
        return self._order[self._start[asked] + self._nth(asked)], asked

    def _nth(self, asked: NDArray[np.int64]) -> NDArray[np.int64]:
        """Number of each copy among those of its question."""
        return np.arange(len(asked)) - (np.cumsum(self._count) - self._count)[asked]


def merge_held(exchange: NodeExchange, conditions: NodeConditions) -> HeldRows:
    """Bring together what holds each owned node; a component may be held twice to one value.

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
    exchange: NodeExchange, conditions: NodeConditions, held: HeldRows, length: float
) -> tuple[ContactRows, ContactRows]:
    """Bring together the contact rows of each owned node and drop redundant ones.

    Parameters
    ----------
    length
        A length of the scene; penetrations of held nodes below 1e-9 of it are round-off.

    Returns
    -------
    The rows that are kept, and those that a tighter one in the same direction makes redundant.

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
    return rows.of(keep), rows.of(~keep)


def contact_rows(exchange: NodeExchange, conditions: NodeConditions) -> ContactRows:
    """The contact rows of each owned node, one a contact (collective)."""
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
    """Of rows of one node that are parallel keep the tightest, unless none of them is a mean.

    Rows at nodes alone are those of `merge_contact`, which has done so.

    Parameters
    ----------
    rows
        Sorted by node, without held components.
    length
        As in `merge_contact`.

    Returns
    -------
    The rows that are kept, and the others.

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


def unit_rows(rows: ContactRows) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """Contact rows over the nodes they name, scaled to unit length, and their lengths before.

    The nodes may belong to any rank: their numbers are the columns.

    Returns
    -------
    A matrix (rows, components of nodes), and (rows,).
    """
    entries = rows.entries
    column = entries.node * rows.normals.shape[1] + entries.component
    known, place = np.unique(column, return_inverse=True)
    matrix = sparse.csr_matrix(
        (entries.value, (entries.row, place.reshape(-1))), shape=(len(rows.nodes), len(known))
    )
    norm = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel())
    return matrix.multiply(1.0 / norm[:, None]).tocsr(), norm


def cut_held(
    exchange: NodeExchange,
    rows: ContactRows,
    held: HeldRows,
    length: float,
    one_sided: bool = True,
) -> ContactRows:
    """Move what is held from the rows to their gaps; rows with nothing left are dropped.

    Parameters
    ----------
    length
        As in `merge_contact`.
    one_sided
        Whether rows ask anything of what is held; slips of held nodes may be what they are.

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
    decided = (left < 1e-18) & ~rows.on_rigid
    inside = decided & (gaps < -1e-9 * length) & one_sided
    problem = None
    if inside.any():
        worst = int(np.argmin(np.where(inside, gaps, np.inf)))
        problem = (
            "held in contact", int(rows.sources[worst]), -1, int(rows.nodes[worst]),
            float(-gaps[worst]),
        )  # fmt: skip
    _raise_together(exchange, problem)
    free, cut = (
        ContactEntries(**{name: v[some] for name, v in entries.__dict__.items()})
        for some in (~fixed, fixed)
    )
    return replace(rows, gaps=gaps, entries=free, held=cut).of(~decided)


def write_rows(
    exchange: NodeExchange,
    subdomains: NDArray[np.int64],
    held: HeldRows,
    contact: ContactRows,
    eliminated: NDArray[np.bool_],
    options: TotalFetiOptions | None = None,
    tied: ContactRows | None = None,
    tangential: ContactRows | None = None,
) -> tuple[Rows, ContactRows, ContactRows, ContactRows]:
    """Write the rows of the owned nodes (collective).

    Parameters
    ----------
    subdomains : (copies,)
        Number of the subdomain of each of this rank's copies, among all.
    eliminated : (held nodes,)
        Held nodes whose conditions are imposed in the stiffness itself: no rows.
    tied
        Rows that hold with equality, written as contact rows are; sorted by node.
    tangential
        Rows of slips at contact points, written as contact rows are; sorted by node and contact.

    Returns
    -------
    The rows, and the contact, tangential and tied rows, in row order, with their spread filled in.
    """
    dimension = contact.normals.shape[1]
    order = np.argsort(exchange.nodes, kind="stable")
    nodes, start, copies = np.unique(exchange.nodes[order], return_index=True, return_counts=True)
    is_held = np.zeros((len(nodes), dimension), bool)
    value = np.zeros((len(nodes), dimension))
    at = np.searchsorted(nodes, held.nodes)
    is_held[at], value[at] = held.held, held.values
    skipped = np.zeros(len(nodes), bool)
    skipped[at] = eliminated
    of_copy = exchange.to_owners(subdomains)
    two = order[start[copies == 2][:, None] + np.arange(2)]
    many = (options or TotalFetiOptions()).many_subdomains
    if not coarse_solves_matter(exchange.comm, subdomains, dimension, many):
        two = two[:0]
    neighbours = Neighbours(exchange.comm, of_copy[two])

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
            if m == 1:
                continue
            free, where = group[~fixed], copy[~fixed]
            for of, stencil, weight in neighbours.patterns(of_copy[where]):
                parts.append(
                    _Part.of(
                        RowKind.GLUING, nodes[free[of]], stencil, where[of], component,
                        np.zeros(len(of) * (m - 1)), weight,
                    )
                )  # fmt: skip
    shared, every = _shared(exchange, contact, tangential, tied)
    parts += [_Part.shared(kind, rows) for kind, rows in zip(SHARED, every, strict=True)]
    return _assemble(parts, shared), every[0], every[1], every[2]


def _shared(
    exchange: NodeExchange,
    contact: ContactRows,
    tangential: ContactRows | None,
    tied: ContactRows | None,
) -> tuple[SharedEntries, list[ContactRows]]:
    """Entries of rows of all kinds of `SHARED`, and these rows with their spread (collective)."""
    every = [contact, *(contact.none() if r is None else r for r in (tangential, tied))]
    counts = [len(rows.nodes) for rows in every]
    joined, rigid = (
        ContactEntries.join([getattr(rows, name) for rows in every], counts)
        for name in ("entries", "rigid")
    )
    first, last = counts[0], counts[0] + counts[1]
    together = np.arange(sum(counts))
    together[first:last] = first + points_of(every[1])
    shared = SharedEntries(exchange, joined, together, rigid)
    spreads = np.split(1.0 / shared.lengths, np.cumsum(counts)[:-1])
    return shared, [replace(r, spread=s) for r, s in zip(every, spreads, strict=True)]


def points_of(rows: ContactRows) -> NDArray[np.int64]:
    """Number of the contact point of each row, (rows,): rows of one node and contact share it."""
    new = (np.diff(rows.nodes) != 0) | (np.diff(rows.sources) != 0)
    return np.cumsum(np.concatenate([np.zeros(min(len(rows.nodes), 1), bool), new]))


@dataclass(frozen=True, eq=False)
class _Part:
    """Rows of one kind before they are sorted into place, those of a node by `nth`."""

    kind: RowKind
    node: NDArray[np.int64]
    nth: NDArray[np.int64]
    rhs: NDArray[np.float64]
    weight: NDArray[np.float64]
    row: NDArray[np.int64]
    copy: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]

    @classmethod
    def shared(cls, kind: RowKind, rows: ContactRows) -> _Part:
        """Rows whose entries are shared ones, with their spread filled in."""
        none, rhs = np.zeros(0, np.int64), rows.gaps * rows.spread
        nth, weight = np.arange(len(rhs)), np.ones(len(rhs))
        return cls(kind, rows.nodes, nth, rhs, weight, none, none, none, np.zeros(0))

    @classmethod
    def of(
        cls,
        kind: RowKind,
        nodes: NDArray[np.int64],
        stencil: NDArray[np.float64],
        copies: NDArray[np.int64],
        component: int,
        rhs: NDArray[np.float64],
        weight: NDArray[np.float64] | None = None,
    ) -> _Part:
        """The same stencil (rows, m) and weights (rows,) on the copies (nodes, m) of each node.

        Rows of it that do the same to other components are next to each other.
        """
        per_node, m = stencil.shape
        r, c = np.nonzero(stencil)
        base = np.arange(len(nodes))[:, None]
        row = (base * per_node + r).ravel()
        return cls(
            kind,
            np.repeat(nodes, per_node),
            np.tile(np.arange(per_node) * MOST_COMPONENTS + component, len(nodes)),
            rhs,
            np.tile(np.ones(per_node) if weight is None else weight, len(nodes)),
            row,
            copies[:, c].ravel(),
            np.full(len(row), component, np.int64),
            np.tile(stencil[r, c], len(nodes)),
        )


def _assemble(parts: list[_Part], contact: SharedEntries) -> Rows:
    """Number the rows by node, then kind, then as their part says."""
    kind = np.concatenate([np.full(len(p.node), p.kind, np.int8) for p in parts])
    node = np.concatenate([p.node for p in parts])
    offsets = np.cumsum([0, *(len(p.node) for p in parts)])
    order = np.lexsort((np.concatenate([p.nth for p in parts]), kind, node))
    new = np.empty(len(node), np.int64)
    new[order] = np.arange(len(node))
    row = np.concatenate([o + p.row for o, p in zip(offsets, parts, strict=False)])
    return Rows(
        kind=kind[order],
        node=node[order],
        rhs=np.concatenate([p.rhs for p in parts])[order],
        weight=np.concatenate([p.weight for p in parts])[order],
        row=new[row.astype(np.int64)],
        copy=np.concatenate([p.copy for p in parts]),
        component=np.concatenate([p.component for p in parts]),
        value=np.concatenate([p.value for p in parts]),
        contact=contact,
    )


def pairs_at_nodes(
    node: NDArray[np.int64],
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of rows that share a node, the rows sorted by node; each pair once."""
    if len(node) == 0:
        return
    _, start, count = np.unique(node, return_index=True, return_counts=True)
    for a in range(int(count.max())):
        for b in range(a):
            both = start[count > a]
            yield both + b, both + a


def _squeezed(
    rows: ContactRows, direction: NDArray[np.float64], gap: NDArray[np.float64], least: float
) -> tuple | None:
    """The worst node that two rows in opposite directions leave no room, as a contradiction.

    Where held components leave a node one direction to move in, any two obstacles can do that.
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


def tightest_of_each_node(
    node: NDArray[np.int64], direction: NDArray[np.float64], gap: NDArray[np.float64]
) -> NDArray[np.bool_]:
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
