"""Assembly of G W Gᵀ by blocks, from the rows of B applied to the rigid motions of subdomains.

A row of Gᵀ = B R has a run of entries for each subdomain on which the row of B has entries. The
rows on the same subdomains (the rows of a face, an edge or a corner) form a small dense matrix V,
and Vᵀ W V is their contribution to G W Gᵀ. Each rank sums its own rows, all faces with equally many
rows at once. Gᵀ has twelve entries a row, more than B, so it is computed in chunks of rows and not
stored. Products of sparse matrices by scipy take twice as long (on the cube of 60³ cells 0.12 s of
CPU, not 0.06 s, of the 0.31 s that the model takes) and store Gᵀ, 104 bytes a row. Between
congruent subdomains V repeats, and Vᵀ W V is computed once.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from solver.exchange import NodeExchange
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.vectors import Array, Ints, runs


@dataclass(frozen=True, eq=False)
class RowGroups:
    """Groups of n local rows of Gᵀ; the rows of a group have entries on the same m subdomains."""

    rows: Ints  # (groups, n)
    """Local numbers."""
    starts: Ints
    widths: Ints
    """First coarse unknown of each subdomain, numbered over all ranks, and its number of coarse
    unknowns. Shape (groups, m)."""
    values: Array  # (patterns, n, m · motions)
    """Entries, for each subdomain as many as rigid motions, zero beyond its width."""
    pattern: Ints  # (groups,)
    """Row pattern of each group: its place in `values`."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """A sum of dense blocks between subdomains, on this rank."""

    starts: Ints
    widths: Ints
    """First coarse unknown of the block's rows and columns, and the number of used ones. Shape (n,
    2)."""
    values: Array  # (n, motions, motions)

    @property
    def motions(self) -> int:
        """Size of a block."""
        return self.values.shape[1]

    @classmethod
    def of(
        cls, groups_of_rows: Iterable[RowGroups], motions: int, weights: Array | None = None
    ) -> "Blocks":
        """Vᵀ W V of all groups, with a weight for each local row of B (one unless given)."""
        parts = [cls(*(np.empty((0, 2), np.int64),) * 2, np.empty((0, motions, motions)))]
        for rows in groups_of_rows:
            groups, m = rows.starts.shape
            V, pattern = rows.values, rows.pattern
            weighed = V
            if weights is not None:
                V, pattern = V[pattern], np.arange(groups)
                weighed = V * weights[rows.rows][:, :, None]
            product = (weighed.transpose(0, 2, 1) @ V).reshape(-1, m, motions, m, motions)
            starts, widths = (
                np.stack(np.broadcast_arrays(of[:, :, None], of[:, None]), axis=-1).reshape(-1, 2)
                for of in (rows.starts, rows.widths)
            )
            blocks = product.transpose(0, 1, 3, 2, 4)[pattern].reshape(-1, motions, motions)
            parts.append(cls(starts, widths, blocks))
        return cls.join(parts)

    @classmethod
    def join(cls, parts: "Sequence[Blocks]") -> "Blocks":
        """The sum of several sums."""
        starts, widths, values = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("starts", "widths", "values")
        )
        return cls(starts, widths, values)

    @property
    def _keys(self) -> Ints:
        return self.starts[:, 0] << 32 | self.starts[:, 1]

    def summed(self) -> "Blocks":
        """The sum with each block once, sorted."""
        keys = self._keys
        order = np.argsort(keys, kind="stable")
        first = np.flatnonzero(np.diff(keys[order], prepend=-1))
        if len(first) == 0:
            return self
        # sums of many short rows: a sparse product takes a fifth of the time of reduceat
        which = sparse.csr_matrix(
            (np.ones(len(order)), order, np.append(first, len(order))), (len(first), len(order))
        )
        values = which @ self.values.reshape(len(order), -1)
        chosen = order[first]
        values = values.reshape(-1, *self.values.shape[1:])
        return Blocks(self.starts[chosen], self.widths[chosen], values)

    def without(self, vanishing: float) -> "Blocks":
        """The sum without blocks whose entries are all below a magnitude."""
        some = np.abs(self.values).max(axis=(1, 2), initial=0.0) > vanishing
        return Blocks(self.starts[some], self.widths[some], self.values[some])

    def plus(self, part: "Blocks") -> "Blocks":
        """The sum with a part whose blocks are among these; both are `summed`."""
        values = self.values.copy()
        values[np.searchsorted(self._keys, part._keys)] += part.values
        return Blocks(self.starts, self.widths, values)

    def to_owners(self, exchange: NodeExchange) -> "Blocks":
        """Each block at the rank that owns its rows (collective)."""
        return Blocks(*map(exchange.to_owners, (self.starts, self.widths, self.values)))

    def places(self, first: int, rows: int, columns: int) -> sparse.csr_matrix:
        """Places of the matrix entries in ``values.ravel()``, as entries of a sparse matrix.

        Its rows are those from `first` on. The blocks are `summed`. The values may change; the
        pattern may not. Blocks include entries that vanish: the factorisation is faster so.
        """
        motions = np.arange(self.motions)
        used = (motions[:, None] < self.widths[:, 0, None, None]) & (
            motions < self.widths[:, 1, None, None]
        )
        row, column = np.broadcast_arrays(
            self.starts[:, 0, None, None] + motions[:, None] - first,
            self.starts[:, 1, None, None] + motions,
        )
        result = sparse.csr_matrix(
            (np.flatnonzero(used), (row[used], column[used])), shape=(rows, columns)
        )
        result.sort_indices()
        return result


class KernelRows:
    """The rows of Gᵀ = B R.

    Parameters
    ----------
    B : (dual, interface)
        Constraint matrix on interface unknowns, a run of the columns for each subdomain.
    kernels : one (members, (m, k) array) pair per class
        Kernel on the class's m interface unknowns, in the order of B's columns.
    chunk
        Entries of B in one chunk.

    Attributes
    ----------
    motions
        Largest number of rigid motions of a subdomain.
    entries : (dual,)
        Number of entries of each local row of B, at least the number of its subdomains.
    places : (3, columns)
        First coarse unknown of the subdomain of a column, the number of these, and the place of the
        column's kernel in a table. Columns of other ranks follow those of this rank.
    """

    def __init__(
        self,
        B: ConstraintMatrix,
        kernels: Sequence[tuple[int, Array]],
        chunk: int = TotalFetiOptions.chunk,
    ) -> None:
        self.comm, self._at_once = B.comm, chunk
        members, sizes, widths = np.array([(n, *R.shape) for n, R in kernels]).reshape(-1, 3).T
        self.motions = int(self.comm.allreduce(int(widths.max(initial=0)), op=MPI.MAX))
        coarse = members * widths
        first = (self.comm.exscan(int(coarse.sum())) or 0) + np.cumsum(coarse) - coarse
        self._repeated = bool((members > 1).any())
        self._table = np.zeros((int(sizes.sum()), self.motions))
        self.places, end, kernel = np.empty((3, B.columns), np.int32), 0, 0
        for start, (n, R) in zip(first, kernels, strict=True):
            size, width = R.shape
            self._table[kernel : kernel + size, :width] = R
            places = self.places[:, end : end + n * size].reshape(3, n, size)
            places[0], places[1] = start + width * np.arange(n)[:, None], width
            places[2] = kernel + np.arange(size)
            end, kernel = end + n * size, kernel + size
        self._begins, self._columns, self._values = B.local.indptr, B.local.indices, B.local.data
        self.entries = np.diff(self._begins)
        if self.comm.size > 1:
            self._ask(B)

    def _ask(self, B: ConstraintMatrix) -> None:
        """Give columns of other ranks numbers after those of this rank, and the owners' data."""
        away = (self._columns < B.first) | (self._columns >= B.first + B.columns)
        columns, nth = np.unique(self._columns[away].astype(np.int64), return_inverse=True)
        total = B.local.shape[1]
        starts = np.array([*self.comm.allgather(B.first), total], np.int64)
        exchange = NodeExchange(self.comm, columns, total, starts)
        places = self.places[:, exchange.nodes - B.first]
        kernel = exchange.from_owners(self._table[places[2]])
        places = exchange.from_owners(np.ascontiguousarray(places.T)).T
        places[2] = len(self._table) + np.arange(len(columns))
        self._table = np.concatenate([self._table, kernel])
        self.places = np.concatenate([self.places, places], axis=1)
        self._columns = self._columns - B.first
        self._columns[away] = B.columns + nth

    def row_groups(self, rows: Ints, scale: Array | None = None) -> Iterator[RowGroups]:
        """Some local rows, grouped by their subdomains, times factors (dual,) if these are given.

        Rows without floating subdomains are left out.
        """
        ends, step = np.cumsum(self.entries[rows]), self._at_once
        cuts = np.searchsorted(ends, np.arange(step, ends[-1] if len(ends) else 0, step))
        for chunk in np.split(rows, cuts):
            yield from self._chunk(chunk, scale)

    def entries_of(self, rows: Ints) -> tuple[Ints, NDArray[np.int32], Array]:
        """Entries of B in some rows, which ascend.

        Returns
        -------
        First entries of the rows (rows + 1,); and number of the column and value of each entry.
        """
        counts = self.entries[rows]
        begins = np.concatenate([[0], np.cumsum(counts)])
        entry: slice | Ints = slice(0)
        if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
            entry = slice(self._begins[rows[0]], self._begins[rows[-1] + 1])
        elif len(rows):
            entry = runs(self._begins[rows], counts)
        return begins, self._columns[entry], self._values[entry]

    def _chunk(self, rows: Ints, scale: Array | None) -> Iterator[RowGroups]:
        begins, column, value = self.entries_of(rows)
        start, width, place = np.take(self.places, column, axis=1)
        row = np.repeat(np.arange(len(rows)), np.diff(begins))
        if scale is not None:
            value = value * scale[rows][row]
        floating = width > 0
        if not floating.all():
            row, start, width = row[floating], start[floating], width[floating]
            place, value = place[floating], value[floating]
        if len(row) == 0:
            return
        # columns are sorted, so subdomains are sorted, too
        other = np.r_[True, (row[1:] != row[:-1]) | (start[1:] != start[:-1])]
        several = None
        if not other.all():
            first = np.flatnonzero(other)
            several = np.add.reduceat(self._table[place] * value[:, None], first, axis=0)
            row, start, width = row[first], start[first], width[first]
        touched = np.bincount(row)[row]
        for m in np.flatnonzero(np.bincount(touched)):
            pairs = np.flatnonzero(touched == m).reshape(-1, m)
            pairs = pairs[np.lexsort(start[pairs].T)]
            starts = start[pairs].T
            first = np.flatnonzero(np.r_[True, (starts[:, 1:] != starts[:, :-1]).any(axis=0)])
            sizes = np.diff(first, append=len(pairs))
            for n in np.unique(sizes):
                begins = first[sizes == n]
                of = pairs[begins[:, None] + np.arange(n)]
                pattern = np.arange(len(of))
                if several is None:
                    at, factor = place[of], value[of]
                    if self._repeated:
                        some, pattern = _distinct(at, factor)
                        at, factor = at[some], factor[some]
                    values = self._table[at]
                    values *= factor[..., None]
                else:
                    values = several[of]
                yield RowGroups(
                    rows[row[of[:, :, 0]]], starts[:, begins].T.astype(np.int64),
                    width[pairs[begins]],
                    values.reshape(len(values), n, -1), pattern,
                )  # fmt: skip


def _distinct(place: NDArray[np.int32], value: Array) -> tuple[Ints, Ints]:
    """Groups with different row patterns, and the pattern of each group.

    Parameters
    ----------
    place, value : (groups, n, m)
        Kernel and value of each entry of the rows.
    """
    ends = place[:, [0, -1]].reshape(len(place), -1)
    _, first, pattern = np.unique(ends, axis=0, return_index=True, return_inverse=True)
    like = first[pattern]
    other = (place != place[like]).any(axis=(1, 2)) | (value != value[like]).any(axis=(1, 2))
    like[other] = np.flatnonzero(other)
    some, pattern = np.unique(like, return_inverse=True)
    return some, pattern
