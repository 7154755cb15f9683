"""Products of distributed matrices in dense blocks, for the levels of multigrid.

Nodes have two or three unknowns, aggregates three or six, and all unknowns of two neighbours are
coupled. In blocks a product Pᵀ A P does the same arithmetic with one index for 18 or 36 entries: on
122,097 unknowns it takes a third of the CPU time of PETSc's product of single entries.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import local_rows
from solver.vectors import Array, Ints

AT_ONCE = 500_000
"""Approximate number of entries of A in the rows that are multiplied at once.

The product of so many rows fits the memory that the last ones left: larger products are twice as
slow on fresh memory."""


@dataclass(frozen=True, eq=False)
class BlockRows:
    """A distributed matrix, of which each rank has some rows."""

    comm: MPI.Intracomm
    local: sparse.bsr_matrix
    """This rank's rows with all columns, in blocks."""
    columns: int
    """Number of blocks of columns that belong to this rank."""

    @classmethod
    def of(cls, matrix: PETSc.Mat) -> "BlockRows":
        """A PETSc matrix in blocks of its block sizes."""
        size = matrix.getBlockSizes()
        local = local_rows(matrix).tobsr(size)
        return cls(matrix.comm.tompi4py(), local, matrix.getLocalSize()[1] // size[1])

    @classmethod
    def of_rows(cls, matrix: PETSc.Mat, block: int) -> "BlockRows":
        """A PETSc matrix in blocks of one row and some columns."""
        local = local_rows(matrix).tobsr((1, block))
        return cls(matrix.comm.tompi4py(), local, matrix.getLocalSize()[1] // block)

    @classmethod
    def stacked(cls, parts: "Sequence[BlockRows]") -> "BlockRows":
        """This rank's rows of matrices of the same columns, one below the other."""
        return cls(parts[0].comm, _stacked([part.local for part in parts]), parts[0].columns)

    def some(self, rows: Ints) -> "BlockRows":
        """Some of this rank's rows of blocks."""
        return BlockRows(self.comm, _some(self.local, rows), self.columns)

    def scaled(self, factors: Array) -> "BlockRows":
        """The matrix with a factor for each row of blocks of this rank."""
        local = self.local
        data = local.data * np.repeat(factors, np.diff(local.indptr))[:, None, None]
        scaled = _blocks(data, local.indices, local.indptr, local.shape, local.blocksize)
        return BlockRows(self.comm, scaled, self.columns)

    @property
    def rows(self) -> int:
        """Number of blocks of rows of this rank."""
        return int(self.local.shape[0] // self.local.blocksize[0])

    def _starts(self, count: int) -> Ints:
        """First blocks of all ranks, and the number of all, of `count` here (collective)."""
        return np.cumsum([0, *self.comm.allgather(count)])

    def times(self, right: "BlockRows") -> "BlockRows":
        """The product with a matrix whose rows are this one's columns (collective)."""
        local, others = self._factors(right)
        return BlockRows(self.comm, local @ others, right.columns)

    def times_matrix(self, right: PETSc.Mat) -> "BlockRows":
        """The product with a PETSc matrix, of which a rank converts the rows it needs (collective).

        On contact rows of a pair it takes a third of the time of PETSc's product.
        """
        height, width = right.getBlockSizes()
        needed, place = np.unique(self.local.indices, return_inverse=True)
        numbers = (needed[:, None] * height + np.arange(height)).ravel()
        chosen = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        columns = PETSc.IS().createStride(right.getSize()[1], 0, 1, comm=PETSc.COMM_SELF)
        (rows,) = right.createSubMatrices([chosen], [columns])
        factor = local_rows(rows).tobsr((height, width))
        rows.destroy()
        shape = self.local.shape[0], len(numbers)
        local = _blocks(
            self.local.data, place.ravel(), self.local.indptr, shape, self.local.blocksize
        )
        return BlockRows(self.comm, local @ factor, right.getLocalSize()[1] // width)

    def galerkin(self, P: "BlockRows") -> "BlockRows":
        """Pᵀ A P (collective).

        Multiply in batches of rows: the whole A P needs more memory than A.
        """
        local, others = self._factors(P)
        total = P.local.shape[1]
        result = _zeros((total, total), (P.local.blocksize[1], P.local.blocksize[1]))
        for rows in np.array_split(np.arange(self.rows), self.local.data.size // AT_ONCE + 1):
            result = result + _some(P.local, rows).T @ (_some(local, rows) @ others)
        return self._at_owners(result, P.columns)

    def transposed_times(self, right: "BlockRows") -> "BlockRows":
        """Aᵀ B with a matrix of the same rows and columns (collective)."""
        return self._at_owners(self.local.T @ right.local, self.columns)

    def gram(self) -> "BlockRows":
        """Aᵀ A (collective)."""
        return self.transposed_times(self)

    def plus(self, other: "BlockRows") -> "BlockRows":
        """The sum with a matrix of the same rows and columns."""
        return BlockRows(self.comm, self.local + other.local, self.columns)

    def plus_diagonal(self, values: Array) -> "BlockRows":
        """The sum of the square matrix and a diagonal, whose entries these are, (entries,)."""
        size, first = self.local.blocksize[0], self.comm.exscan(self.columns) or 0
        entries = np.zeros((self.rows, size, size))
        at = np.arange(size)
        entries[:, at, at] = values.reshape(self.rows, size)
        places, begins = first + np.arange(self.rows), np.arange(self.rows + 1)
        added = _blocks(entries, places, begins, self.local.shape, self.local.blocksize)
        return BlockRows(self.comm, self.local + added, self.columns)

    def _at_owners(self, part: sparse.bsr_matrix, columns: int) -> "BlockRows":
        """The sum of a square matrix over all ranks, by its rows of each rank (collective).

        Parameters
        ----------
        columns
            Number of blocks of this rank.
        """
        if self.comm.size > 1:
            starts = self._starts(columns)
            parts = [_some(part, np.arange(*ends)) for ends in pairwise(starts)]
            first, *others = self.comm.alltoall(parts)
            part = sum(others, start=first)
        return BlockRows(self.comm, part, columns)

    def _factors(self, right: "BlockRows") -> tuple[sparse.bsr_matrix, sparse.bsr_matrix]:
        """This rank's rows, and the rows of another matrix by which they are multiplied."""
        local = self.local
        if self.comm.size == 1:
            return local, right.local
        needed, place = np.unique(local.indices, return_inverse=True)
        shape = local.shape[0], len(needed) * local.blocksize[1]
        renumbered = _blocks(local.data, place.ravel(), local.indptr, shape, local.blocksize)
        return renumbered, right.rows_of_all(needed)

    def rows_of_all(self, chosen: NDArray[np.integer]) -> sparse.bsr_matrix:
        """Some rows of all ranks, by their sorted numbers (collective)."""
        starts = self._starts(self.rows)
        ends = np.searchsorted(chosen, starts)
        requests = self.comm.alltoall([chosen[a:b] for a, b in pairwise(ends)])
        first = starts[self.comm.rank]
        sent = self.comm.alltoall([_some(self.local, numbers - first) for numbers in requests])
        return _stacked(sent)

    def with_diagonal(self) -> "BlockRows":
        """The square matrix with its largest diagonal entry where one is zero (collective)."""
        first = (self.comm.exscan(self.columns) or 0) * self.local.blocksize[1]
        values = self.local.tocsr().diagonal(first)[: self.local.shape[0]]
        top = self.comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX)
        extra = sparse.diags(np.where(values == 0.0, top, 0.0), first, self.local.shape)
        return BlockRows(self.comm, self.local + extra.tobsr(self.local.blocksize), self.columns)

    @property
    def _sizes(self) -> list[tuple[int, int]]:
        """Local and global rows and columns, for PETSc."""
        return [
            (count, PETSc.DETERMINE)
            for count in (self.local.shape[0], self.columns * self.local.blocksize[1])
        ]

    @cached_property
    def matrix(self) -> PETSc.Mat:
        """`to_petsc`, made once (collective at the first call)."""
        return self.to_petsc()

    def to_petsc(self) -> PETSc.Mat:
        """The matrix for PETSc, in single entries (collective)."""
        self.local.sort_indices()  # fewer numbers than those of single entries
        rows = self.local.tocsr()
        rows.sort_indices()
        begins, places = (part.astype(PETSc.IntType) for part in (rows.indptr, rows.indices))
        matrix = PETSc.Mat().createAIJ(self._sizes, csr=(begins, places, rows.data), comm=self.comm)
        matrix.setBlockSizes(*self.local.blocksize)
        return matrix

    def to_blocks(self) -> PETSc.Mat:
        """The square matrix for PETSc, in blocks (collective)."""
        self.local.sort_indices()
        begins, places = (
            part.astype(PETSc.IntType) for part in (self.local.indptr, self.local.indices)
        )
        values = np.ascontiguousarray(self.local.data)
        matrix = PETSc.Mat().createBAIJ(
            self._sizes, self.local.blocksize[0], csr=(begins, places, values), comm=self.comm
        )
        matrix.assemble()
        return matrix


def _blocks(
    data: Array,
    indices: NDArray[np.integer],
    indptr: NDArray[np.integer],
    shape: tuple[int, int],
    size: tuple[int, int],
) -> sparse.bsr_matrix:
    return sparse.bsr_matrix((data, indices, indptr), shape=shape, blocksize=size)


def _some(matrix: sparse.bsr_matrix, rows: NDArray[np.integer]) -> sparse.bsr_matrix:
    """Some rows of blocks."""
    counts = np.diff(matrix.indptr)[rows]
    indptr = np.concatenate([[0], np.cumsum(counts)])
    at = np.arange(indptr[-1]) + np.repeat(matrix.indptr[rows] - indptr[:-1], counts)
    shape = len(rows) * matrix.blocksize[0], matrix.shape[1]
    return _blocks(matrix.data[at], matrix.indices[at], indptr, shape, matrix.blocksize)


def _stacked(parts: Sequence[sparse.bsr_matrix]) -> sparse.bsr_matrix:
    """Matrices of the same columns, one below the other."""
    counts = np.concatenate([np.diff(part.indptr) for part in parts])
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    shape = sum(part.shape[0] for part in parts), parts[0].shape[1]
    data, indices = (np.concatenate(arrays) for arrays in (
        [part.data for part in parts], [part.indices for part in parts]))  # fmt: skip
    return _blocks(data, indices, indptr, shape, parts[0].blocksize)


def _zeros(shape: tuple[int, int], size: tuple[int, int]) -> sparse.bsr_matrix:
    """A matrix of zeros, without any block."""
    indptr = np.zeros(shape[0] // size[0] + 1, np.int64)
    return _blocks(np.zeros((0, *size)), np.zeros(0, np.int64), indptr, shape, size)
