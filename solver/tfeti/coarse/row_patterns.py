"""Row patterns: groups of rows of B that repeat, and G applied to all of a pattern at once.

The rows that have entries on the same subdomains (the rows of a face, an edge or a corner) form a
group. Their rows of Gᵀ = B R are a dense matrix V on the rigid motions of these subdomains. Between
congruent subdomains V repeats: such groups have one pattern. If the rows of each pattern follow one
another, the product with Gᵀ is one dense product for each pattern. It reads and writes dual vectors
once and needs no interface vector.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from solver.tfeti.coarse.gram import Blocks, KernelRows
from solver.tfeti.options import TotalFetiOptions
from solver.vectors import blocks, runs

ROWS_AT_ONCE = 2**16
"""Number of rows that are processed at once: half a megabyte, which fits into the cache."""

Hashes = NDArray[np.uint64]
_Factors = tuple[Any, Any]


@dataclass(frozen=True, eq=False)
class RowPattern:
    """Groups of n equal rows on m subdomains each, one group after another.

    Attributes
    ----------
    first
        First row of the groups.
    starts : (groups, m)
        First coarse unknown of each subdomain, over all ranks.
    V : (n, m · motions)
        Rows of Gᵀ of each group.
    """

    first: int
    starts: NDArray[np.int64]
    V: NDArray[np.float64]

    @property
    def rows(self) -> slice:
        """Slice of the rows of all groups."""
        return slice(self.first, self.first + len(self.starts) * len(self.V))


@dataclass(frozen=True, eq=False)
class _Entries:
    """Entries of the first components of nodal rows, one for each subdomain of a row.

    Attributes
    ----------
    begins : (rows + 1,)
        First entry of each row.
    start, place : (entries,)
        First coarse unknown of the subdomain, and the kernel of the node's first component.
    value : (entries,)
    """

    begins: NDArray[np.int64]
    start: NDArray[np.int64]
    place: NDArray[np.int64]
    value: NDArray[np.float64]

    def of(self, rows: NDArray[np.int64]) -> _Entries:
        """The entries of some rows."""
        counts = np.diff(self.begins)[rows]
        begins = np.concatenate([[0], np.cumsum(counts)])
        entry = runs(self.begins[rows], counts)
        return _Entries(begins, self.start[entry], self.place[entry], self.value[entry])

    @property
    def nth(self) -> NDArray[np.int64]:
        """Number of each entry within its row."""
        return np.arange(self.begins[-1]) - np.repeat(self.begins[:-1], np.diff(self.begins))

    def summed(self, hashes: Hashes) -> Hashes:
        """One hash for each row, which depends on the order of the entries."""
        return np.asarray(np.add.reduceat(_mixed(hashes, self.nth), self.begins[:-1]))


def patterns_of(
    kernels: KernelRows, rows: NDArray[np.int64], components: int, first: int = 0
) -> tuple[NDArray[np.int64], list[RowPattern]]:
    """An order of rows in which the rows of a pattern follow one another, and the patterns.

    If nothing repeats, this is the order of the subdomains.

    Parameters
    ----------
    rows
        First rows of runs of `components` rows with the same coefficients for each component of
        some nodes.
    first
        Place of the first of these rows among all rows.

    Returns
    -------
    The order of the runs (runs without a pattern come last), and the patterns.
    """
    fits, entries = _entries(kernels, rows)
    none = np.flatnonzero(~fits)
    if not fits.any():
        return none, []
    begin, end = entries.begins[:-1], entries.begins[1:] - 1
    touched = entries.summed(entries.start.view(np.uint64))
    order = np.lexsort((entries.place[begin], touched, entries.start[end], entries.start[begin]))
    entries = entries.of(order)

    # groups of rows on the same subdomains, with a hash that is equal for equal groups
    touched = touched[order]
    groups = np.flatnonzero(np.concatenate([[True], touched[1:] != touched[:-1]]))
    sizes = np.diff(groups, append=len(touched))
    seen = kernels.signatures(components)[entries.place] ^ entries.value.view(np.uint64)
    of_rows = entries.summed(seen)
    within = np.arange(len(touched)) - np.repeat(groups, sizes)
    alike = np.add.reduceat(_mixed(of_rows, within), groups)
    _, one, pattern = np.unique(alike, return_index=True, return_inverse=True)
    appears = np.empty(len(one), np.int64)
    appears[np.argsort(one)] = np.arange(len(one))
    by_pattern = np.argsort(appears[pattern], kind="stable")

    patterns: list[RowPattern] = []
    for mine in np.split(by_pattern, np.cumsum(np.bincount(appears[pattern]))[:-1]):
        one_group = entries.of(groups[mine[0]] + np.arange(sizes[mine[0]]))
        width = one_group.begins[1]
        place, value = one_group.place.reshape(-1, width), one_group.value.reshape(-1, width)
        V = kernels.values(place, value, components)
        starts = entries.start[entries.begins[groups[mine]][:, None] + np.arange(width)]
        patterns.append(RowPattern(first, starts, V))
        first = patterns[-1].rows.stop
    nth = runs(groups[by_pattern], sizes[by_pattern])
    return np.concatenate([np.flatnonzero(fits)[order[nth]], none]), patterns


def _entries(kernels: KernelRows, rows: NDArray[np.int64]) -> tuple[NDArray[np.bool_], _Entries]:
    """Rows with entries on floating subdomains alone, on each one once; and their entries."""
    begins, start, width, place, value = kernels.entries_of(rows)
    row = np.repeat(np.arange(len(rows)), np.diff(begins))
    bad = width < kernels.motions
    bad[1:] |= (row[1:] == row[:-1]) & (start[1:] == start[:-1])
    fits = np.ones(len(rows), bool)
    fits[row[bad]] = False
    entries = _Entries(begins, start, place, value)
    return fits, entries if fits.all() else entries.of(np.flatnonzero(fits))


def _mixed(hashes: Hashes, nth: NDArray[np.int64]) -> Hashes:
    """Hashes whose sum depends on the order of the entries."""
    mixed = (hashes ^ hashes >> np.uint64(32)) * np.uint64(0x9E3779B97F4A7C15)
    mixed += nth.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed = (mixed ^ mixed >> np.uint64(29)) * np.uint64(0x165667B19E3779F9)
    return np.asarray(mixed ^ mixed >> np.uint64(32))


def pays(
    comm: MPI.Intracomm, patterns: Sequence[RowPattern], rows: int, options: TotalFetiOptions
) -> bool:
    """Whether to apply G pattern by pattern rather than as Rᵀ times Bᵀ (collective).

    Parameters
    ----------
    rows
        Number of rows of B on this rank.
    """
    inside = sum(k.rows.stop - k.rows.start for k in patterns)
    least = options.pattern_rows if comm.size == 1 else options.pattern_rows_on_ranks
    good = least * len(patterns) <= rows and rows - inside <= options.other_rows * rows
    return bool(comm.allreduce(int(good), op=MPI.MIN))


def blocks_of(
    patterns: Sequence[RowPattern], motions: int, weights: NDArray[np.float64]
) -> tuple[Blocks, NDArray[np.bool_]]:
    """G W Gᵀ of the patterns whose groups have the same weights, Vᵀ W V once for each pattern.

    Parameters
    ----------
    weights : (dual,)
        W.

    Returns
    -------
    The blocks, and the mask of the rows that they contain.
    """
    inside = np.zeros(len(weights), bool)
    parts = [Blocks.of([], motions)]
    for pattern in patterns:
        groups, m = pattern.starts.shape
        weight = weights[pattern.rows].reshape(groups, -1)
        if not _even(weight):
            continue
        inside[pattern.rows] = True
        product = (pattern.V.T * weight[0]) @ pattern.V
        between = product.reshape(m, motions, m, motions).transpose(0, 2, 1, 3)
        pairs = np.stack(
            np.broadcast_arrays(pattern.starts[:, :, None], pattern.starts[:, None]), -1
        )
        values = np.broadcast_to(between, (groups, *between.shape)).reshape(-1, motions, motions)
        starts = pairs.reshape(-1, 2)
        parts.append(Blocks(starts, np.full_like(starts, motions), values))
    return Blocks.join(parts), inside


@dataclass(frozen=True, eq=False)
class _Part:
    """The rows of a pattern, n to a group, and the motions of its groups, (groups, m · motions).

    Attributes
    ----------
    factors
        V for the restriction and Vᵀ for the extension, both also with W, each stored in the order
        of memory in which the product with a narrow matrix is twice as fast.
    """

    rows: slice
    motions: NDArray[np.float64]
    factors: tuple[_Factors, _Factors]

    def few(self, room: NDArray[np.float64]) -> Iterator[tuple[slice, slice, NDArray[np.float64]]]:
        """Iterate over a few groups at a time.

        The groups, their rows, and work space for their values.
        """
        n = len(self.factors[0][0])
        for groups in blocks(len(self.motions), max(len(room) // n, 1)):
            begin, end = n * groups.start, n * groups.stop
            rows = slice(self.rows.start + begin, self.rows.start + end)
            yield groups, rows, room[: end - begin]


class PatternProduct:
    """G and its transpose, pattern by pattern (protocol `Restriction`).

    Coarse vectors are whole on every rank.

    Parameters
    ----------
    kernels
        The rows of Gᵀ; the rows of B are in the order of the patterns.
    total
        Coarse unknowns of all ranks.
    metric : (dual,)
        W. A pattern whose groups have different weights is applied row by row, as are rows without
        a pattern.
    """

    def __init__(
        self,
        kernels: KernelRows,
        patterns: Sequence[RowPattern],
        total: int,
        metric: NDArray[np.float64],
        rows_at_once: int = ROWS_AT_ONCE,
    ) -> None:
        self._comm = kernels.comm
        patterns = [k for k in patterns if _even(metric[k.rows].reshape(len(k.starts), -1))]
        inside = np.zeros(len(kernels.entries), bool)
        for pattern in patterns:
            inside[pattern.rows] = True
        self._others = np.flatnonzero(~inside)
        rest = kernels.matrix(self._others, total)
        self._rest = _factors(rest), _factors(sparse.diags(metric[self._others]) @ rest)
        # subdomains one after another, each with all motions
        seen = [np.zeros(0, np.int64), *(k.starts.ravel() // kernels.motions for k in patterns)]
        self._seen = np.concatenate(seen)
        self._shape = total // kernels.motions, kernels.motions
        places = (self._seen, np.arange(len(self._seen)))
        shape = self._shape[0], len(self._seen)
        self._sum = sparse.csr_matrix((np.ones(len(self._seen)), places), shape=shape)
        self._motions = np.empty((len(self._seen), kernels.motions))

        ends = np.cumsum([0, *(k.starts.size for k in patterns)])
        self._parts = []
        for k, a, b in zip(patterns, ends[:-1], ends[1:], strict=True):
            motions = self._motions[a:b].reshape(len(k.starts), -1)
            weights, plain = metric[k.rows][: len(k.V), None], _factors(k.V)
            weighed = plain if (weights == 1.0).all() else _factors(weights * k.V)
            self._parts.append(_Part(k.rows, motions, (plain, weighed)))
        widest = max((len(k.V) for k in patterns), default=0)
        self._room = np.empty(max(widest, min(rows_at_once, len(kernels.entries))))

    def weighted(self, weights: NDArray[np.float64]) -> PatternProduct:
        """The restriction for the rows of B times weights.

        These are one on the rows of patterns.
        """
        result = copy(self)
        left = sparse.diags(weights[self._others])
        plain, weighed = (_factors(left @ rest) for rest, _ in self._rest)
        result._rest = plain, weighed
        return result

    def restrict(self, dual: NDArray[np.float64], out: NDArray[np.float64], metric: bool) -> None:
        """G, or G W, times a dual vector (collective)."""
        for p in self._parts:
            V, _ = p.factors[metric]
            np.matmul(dual[p.rows].reshape(len(p.motions), -1), V, out=p.motions)
        out.reshape(self._shape)[:] = self._sum @ self._motions
        out += self._rest[metric][1] @ dual[self._others]
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, out)

    def extend(self, coarse: NDArray[np.float64], out: NDArray[np.float64], metric: bool) -> None:
        """Gᵀ, or W Gᵀ, times a coarse vector."""
        self._spread(coarse)
        for p in self._parts:
            np.matmul(p.motions, p.factors[metric][1], out=out[p.rows].reshape(len(p.motions), -1))
        out[self._others] = self._rest[metric][0] @ coarse

    def remove(self, coarse: NDArray[np.float64], x: NDArray[np.float64], metric: bool) -> None:
        """Subtract Gᵀ, or W Gᵀ, times a coarse vector from x, without a work vector."""
        self._spread(coarse)
        for p in self._parts:
            for groups, rows, room in p.few(self._room):
                motions = p.motions[groups]
                np.matmul(motions, p.factors[metric][1], out=room.reshape(len(motions), -1))
                x[rows] -= room
        x[self._others] -= self._rest[metric][0] @ coarse

    def _spread(self, coarse: NDArray[np.float64]) -> None:
        """The motions of the subdomains of each group."""
        np.take(coarse.reshape(self._shape), self._seen, 0, out=self._motions, mode="clip")


def _even(weights: NDArray[np.float64]) -> bool:
    """Whether the weights (groups, n) are equal in all groups."""
    return bool((weights == weights[0]).all())


def _factors(V: Any) -> tuple[Any, Any]:
    """A matrix and its transpose, each contiguous in memory."""
    return (V, V.T.tocsr()) if sparse.issparse(V) else (V, V.T.copy())
