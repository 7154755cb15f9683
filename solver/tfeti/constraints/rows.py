"""The rows of B: gluing, held unknowns, contact; orthonormal wherever the geometry allows it.

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
    the mean jump of two surfaces, component by component, held at zero.
mean
    a rigid motion of a body in the mean over its surface, held on request.

So B Bᵀ = I except where contact, tied and mean rows share nodes and are not perpendicular, and the
rows of obstacles, gluing and held unknowns have full rank however the conditions overlap.
"""

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.contact.row_kinds import RowKind
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows, HeldRows, points_of
from solver.problem.constraints.shared_rows import SHARED, SharedRows
from solver.tfeti.constraints.cross_points import Neighbours, coarse_solves_matter
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.vectors import Array, Ints, Mask

MOST_COMPONENTS = 3
"""Largest number of components of a node."""


@dataclass(frozen=True, eq=False)
class Rows:
    """This rank's rows of B, as entries (row, copy, component, value) on arrived copies."""

    kind: NDArray[np.int8]
    node: Ints
    """Kind and node of each row, sorted by node, then kind. Shape (rows,)."""
    rhs: Array  # (rows,)
    """c."""
    weight: Array  # (rows,)
    """Weights of gluing rows in a coarse problem that joins neighbours alone; one for other
    rows."""
    row: Ints
    copy: Ints
    component: Ints
    value: Array
    """Entries of gluing and held rows; `copy` counts the copies that arrived at this rank. Shape
    (entries,)."""
    shared: "SharedEntries"
    """Entries of the rows of `SHARED`, kind by kind."""

    @property
    def _shared(self) -> Ints:
        """Places of the rows of `SHARED`, kind by kind."""
        return np.concatenate([np.flatnonzero(self.kind == kind) for kind in SHARED])

    def touched(self, arrived: int, dimension: int) -> Mask:
        """Mask (arrived, dimension) of the components with an entry in some row (collective)."""
        touched = np.zeros((arrived, dimension), bool)
        touched[self.copy, self.component] = True
        self.shared.mark(touched)
        return touched

    def held_unknowns(self, dimension: int) -> Ints:
        """Unknown of each held row, node · dimension + component, (rows,); -1 for other rows."""
        result = np.full(len(self.kind), -1, np.int64)
        held = self.kind[self.row] == RowKind.DIRICHLET  # each has one entry
        row = self.row[held]
        result[row] = self.node[row] * dimension + self.component[held]
        return result

    def entries(self, columns: Ints) -> tuple[Ints, Ints, Array]:
        """Row, column and value of all entries of B (collective).

        Parameters
        ----------
        columns : (arrived, dimension)
            Column of each component of the arrived copies.
        """
        row, column, value = self.shared.spread_over(columns)
        return (
            np.concatenate([self.row, self._shared[row]]),
            np.concatenate([columns[self.copy, self.component], column]),
            np.concatenate([self.value, value]),
        )


class SharedEntries:
    """Coefficients at nodes of any ranks, shared equally by the copies of a node.

    Parameters
    ----------
    exchange
        Exchange between the copies of nodes.
    entries
        Entries of this rank's rows. Rows may have any length; in B they have unit length.
    together : (rows,)
        Numbers from 0 on, equal for rows that are scaled together: by the length of the longest
        row.
    rigid
        Entries at rigid bodies. They count for the length of a row only if it has no other entries.

    Attributes
    ----------
    lengths : (rows,)
        Length of each unscaled row on the copies, or the largest length of the rows scaled
        together.
    """

    def __init__(
        self, exchange: NodeExchange, entries: ContactEntries, together: Ints, rigid: ContactEntries
    ) -> None:
        local, rows = len(entries.row), len(together)
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
            for some in (slice(local), slice(local, None))
        )
        longest = np.zeros(int(together.max(initial=-1)) + 1)
        np.maximum.at(longest, together, np.where(square > 0.0, square, of_rigid))
        self.lengths: Array = np.sqrt(longest)[together]

    def mark(self, touched: Mask) -> None:
        """Mark the components (arrived, dimension) of arrived copies that have entries."""
        copy, nth = self._requested_copies()
        touched[copy, self._components[nth]] = True

    def spread_over(self, columns: Ints) -> tuple[Ints, Ints, Array]:
        """Row, column and value on the copies, rows of unit length; `columns` as in `Rows`."""
        comm = self._query.comm
        most = comm.allreduce(int(self._count.max(initial=0)), op=MPI.MAX)
        places = np.full((len(self._count), most), -1, np.int64)
        copy, requested = self._requested_copies()
        places[requested, self._nth(requested)] = columns[copy, self._components[requested]]
        places = self._query.from_owners(places)
        entry, place = np.nonzero(places >= 0)
        row = self._entries.row[entry]
        value = (self._entries.value / self.copies)[entry] / self.lengths[row]
        return row, places[entry, place], value

    def _requested_copies(self) -> tuple[Ints, Ints]:
        """Arrived copies of the requested nodes, and the request of each copy."""
        requested = np.repeat(np.arange(len(self._count)), self._count)
        return self._order[self._start[requested] + self._nth(requested)], requested

    def _nth(self, requested: Ints) -> Ints:
        """Number of each copy among the copies of its request."""
        return np.arange(len(requested)) - (np.cumsum(self._count) - self._count)[requested]


def write_rows(
    exchange: NodeExchange,
    subdomains: Ints,
    held: HeldRows,
    shared: SharedRows,
    eliminated: Mask,
    options: TotalFetiOptions | None = None,
) -> tuple[Rows, SharedRows]:
    """Write the rows of the owned nodes (collective).

    Parameters
    ----------
    subdomains : (copies,)
        Number (over all ranks) of the subdomain of each of this rank's copies.
    eliminated : (held nodes,)
        Mask of held nodes that are eliminated from the stiffness: they get no rows.

    Returns
    -------
    The rows, and the rows of `shared` with `spread` filled in.
    """
    dimension = shared.contact.normals.shape[1]
    order, nodes, start, copies = exchange.copies_of_nodes
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
    entries, shared = _with_spread(exchange, shared)
    parts += [_Part.shared(kind, rows) for kind, rows in shared.by_kind.items()]
    return _assemble(parts, entries), shared


def _with_spread(exchange: NodeExchange, shared: SharedRows) -> tuple[SharedEntries, SharedRows]:
    """Entries of the shared rows, and these rows with `spread` filled in (collective)."""
    every = list(shared.by_kind.values())
    counts = [len(rows.nodes) for rows in every]
    joined, rigid = (
        ContactEntries.join([getattr(rows, name) for rows in every], counts)
        for name in ("entries", "rigid")
    )
    first, last = counts[0], counts[0] + counts[1]
    together = np.arange(sum(counts))
    together[first:last] = first + points_of(every[1])
    entries = SharedEntries(exchange, joined, together, rigid)
    spreads = np.split(1.0 / entries.lengths, np.cumsum(counts)[:-1])
    contact, slips, tied, means = (
        replace(rows, spread=spread) for rows, spread in zip(every, spreads, strict=True)
    )
    return entries, SharedRows(contact, replace(shared.friction, rows=slips), tied, means)


@dataclass(frozen=True, eq=False)
class _Part:
    """Rows of one kind before sorting; `nth` orders the rows of a node."""

    kind: RowKind
    node: Ints
    nth: Ints
    rhs: Array
    weight: Array
    row: Ints
    copy: Ints
    component: Ints
    value: Array

    @classmethod
    def shared(cls, kind: RowKind, rows: ContactRows) -> "_Part":
        """Part of shared rows, whose `spread` is known."""
        none, rhs = np.zeros(0, np.int64), rows.gaps * rows.spread
        nth, weight = np.arange(len(rhs)), np.ones(len(rhs))
        return cls(kind, rows.nodes, nth, rhs, weight, none, none, none, np.zeros(0))

    @classmethod
    def of(
        cls,
        kind: RowKind,
        nodes: Ints,
        stencil: Array,
        copies: Ints,
        component: int,
        rhs: Array,
        weight: Array | None = None,
    ) -> "_Part":
        """The same stencil (rows, m) and weights (rows,) on the copies (nodes, m) of each node.

        Rows with equal coefficients for other components are neighbours.
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


def _assemble(parts: list[_Part], shared: SharedEntries) -> Rows:
    """Number the rows by node, then by kind, then by `nth` of their part."""
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
        shared=shared,
    )
