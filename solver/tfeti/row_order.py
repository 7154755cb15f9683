"""The rows of B as a matrix, in an order in which B and Bᵀ read neighbouring memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solver.contact.row_kinds import RowKind
from solver.tfeti.coarse.gram import KernelRows
from solver.tfeti.coarse.row_patterns import RowPattern, patterns_of
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.matrix import ConstraintMatrix
from solver.tfeti.constraints.nodal import nodal_rows
from solver.tfeti.constraints.rows import Rows
from solver.tfeti.constraints.supports import SupportRows


@dataclass(frozen=True, eq=False)
class OrderedRows:
    """B and the data of its rows.

    Attributes
    ----------
    B : (dual, interface)
    c : (dual,)
        Right-hand side.
    kinds : (dual,)
        `RowKind` of each row.
    weight : (dual,)
        Weights in the coarse problem.
    held_unknowns : (dual,)
        Unknown that a held row holds, node · dimension + component; -1 on other rows.
    alike
        Groups of rows that repeat.
    """

    B: ConstraintMatrix
    c: NDArray[np.float64]
    kinds: NDArray[np.int8]
    weight: NDArray[np.float64]
    held_unknowns: NDArray[np.int64]
    alike: list[RowPattern]


def order_rows(
    exchange: NodeExchange,
    rows: Rows,
    supports: SupportRows,
    columns: NDArray[np.int64],
    size: int,
    kernels: Sequence[tuple[int, NDArray[np.float64]]],
) -> OrderedRows:
    """B on interface columns, with rows of one pattern next to each other (collective).

    Parameters
    ----------
    columns : (copies, dimension)
        Interface column of each component of this rank's copies, -1 where it has none.
    size
        Interface columns of this rank.
    kernels : one (members, (m, k) array) pair per class
        Rigid motions on the class's interface.
    """
    comm, d = exchange.comm, columns.shape[1]
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
    held = np.concatenate([rows.held_unknowns(d), np.full(extra, -1, np.int64)])
    return OrderedRows(B, c[order], kinds[order], weight[order], held[order], alike)


def _row_order(
    local: sparse.csr_matrix,
    kinds: NDArray[np.int8],
    seen: KernelRows,
    own: tuple[int, int],
    d: int,
) -> tuple[NDArray[np.int64], int, list[RowPattern]]:
    """An order of rows with patterns together, in which B reads neighbouring memory.

    Rows with equal coefficients for each component of nodes of this rank come first. Then come such
    rows that have nodes of other ranks as well. Contact and support rows come last, in their given
    order.

    Parameters
    ----------
    local
        The rows; those with equal coefficients for each component of a node are next to each other.
    own
        First column of this rank, and its number of columns.
    d
        Components of a node.

    Returns
    -------
    The order, the number of rows of the first kind, and the row patterns.
    """
    inner = (kinds == RowKind.GLUING) | (kinds == RowKind.DIRICHLET)
    runs = np.empty(0, np.int64)
    if seen.motions and not any(n % d for n in own):
        runs = nodal_rows(local, d).reshape(-1, d)
        runs = runs[inner[runs].all(axis=1), 0]
    begin, end = local.indptr[runs], local.indptr[runs + 1] - 1
    inside = (local.indices[begin] >= own[0]) & (local.indices[end] < sum(own))
    parts: list[NDArray[np.int64]] = []
    alike: list[RowPattern] = []
    for mine in (runs[inside], runs[~inside]):
        order, found = patterns_of(seen, mine, d, d * sum(map(len, parts)))
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
