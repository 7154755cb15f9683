"""The rows of B as a matrix, in an order in which B and Bᵀ read neighbouring memory."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solver.contact.row_kinds import RowKind
from solver.exchange import NodeExchange
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.tfeti.coarse.gram import KernelRows
from solver.tfeti.constraints.rows import Rows
from solver.tfeti.constraints.supports import SupportRows
from solver.vectors import Array, Ints


@dataclass(frozen=True, eq=False)
class OrderedRows:
    """B and the data of its rows."""

    B: ConstraintMatrix  # (dual, interface)
    c: Array  # (dual,)
    """Right-hand side."""
    kinds: NDArray[np.int8]  # (dual,)
    """`RowKind` of each row."""
    weight: Array  # (dual,)
    """Weights in the coarse problem."""
    held_unknowns: Ints  # (dual,)
    """Unknown that a held row holds, node · dimension + component; -1 on other rows."""


def order_rows(
    exchange: NodeExchange,
    rows: Rows,
    supports: SupportRows,
    columns: Ints,
    size: int,
    kernels: Sequence[tuple[int, Array]],
) -> OrderedRows:
    """B on interface columns, with rows on the same subdomains next to each other (collective).

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
    kernel_rows = KernelRows(ConstraintMatrix(comm, local, size), kernels)
    order = _row_order(kinds, kernel_rows)
    B = ConstraintMatrix(comm, local[order], size)
    held = np.concatenate([rows.held_unknowns(d), np.full(extra, -1, np.int64)])
    return OrderedRows(B, c[order], kinds[order], weight[order], held[order])


def _row_order(kinds: NDArray[np.int8], kernel_rows: KernelRows) -> Ints:
    """An order of rows in which B reads neighbouring memory.

    Gluing and Dirichlet rows are sorted by their subdomains, and within these by their nodes.
    Contact and support rows come last, in their given order.
    """
    inner = (kinds == RowKind.GLUING) | (kinds == RowKind.DIRICHLET)
    rows = np.flatnonzero(inner)
    begins, column, _ = kernel_rows.entries_of(rows)
    start = kernel_rows.places[0][column]
    first, last = begins[:-1], begins[1:] - 1
    together = np.add.reduceat(start, first)  # differs where only subdomains between them differ
    ends, rest = (
        np.left_shift(a, 32, dtype=np.int64) | b
        for a, b in ((start[first], start[last]), (together, column[first]))
    )
    rows = rows[np.lexsort((rest, ends))]
    return np.concatenate([rows, np.flatnonzero(~inner)])
