"""The constraint matrix B and its transpose, applied to local parts of distributed vectors."""

from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.backend import Turn
from solver.distributed import petsc_rows, transposed_rows
from solver.vectors import Array, Mask, on_arrays

REDUNDANT = 1e-12
"""Relative addition to the diagonal of a Gram matrix of rows, which may depend on one another: such
rows then share their force, and leave jumps of this size."""


class ConstraintMatrix:
    """B and its explicit transpose; a product with this is twice as fast as a transposed product.

    Parameters
    ----------
    local : (dual, all columns)
        This rank's rows with sorted entries; the caller must not change it afterwards.
    columns
        Interface unknowns of this rank.

    Attributes
    ----------
    rows : int
        Of this rank.
    first : int
        First column of this rank.
    """

    def __init__(self, comm: MPI.Intracomm, local: sparse.csr_matrix, columns: int) -> None:
        self.comm, self.local = comm, local
        self.rows, self.columns = local.shape[0], columns
        self.first = comm.exscan(columns) or 0

    @cached_property
    def matrix(self) -> PETSc.Mat:
        """B as one PETSc matrix (collective)."""
        return petsc_rows(self.comm, self.local, self.columns)

    @cached_property
    def _transpose(self) -> PETSc.Mat:
        """Explicit (collective); on several ranks PETSc's own takes three times as long."""
        if self.comm.size == 1:
            return self.matrix.transpose(PETSc.Mat())
        rows = transposed_rows(self.comm, self.local, self.columns)
        return petsc_rows(self.comm, rows, self.rows)

    @cached_property
    def _vectors(self) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Distributed vectors without memory of their own, for multipliers and interface."""
        dual, interface = (
            PETSc.Vec().createWithArray(np.empty(n), comm=self.comm)
            for n in (self.rows, self.columns)
        )
        return dual, interface

    def apply(self, x: Array, out: Array) -> None:
        """Put B x into out: (interface,) to (dual,)."""
        dual, interface = self._vectors
        on_arrays(self.matrix.mult, interface, x, dual, out)

    def apply_transpose(self, x: Array, out: Array) -> None:
        """Put Bᵀ x into out: (dual,) to (interface,)."""
        dual, interface = self._vectors
        on_arrays(self._transpose.mult, dual, x, interface, out)

    def scaled(self, weights: Array) -> "ScaledConstraintMatrix":
        """W B, for weights (dual,) of the rows."""
        return ScaledConstraintMatrix(self, weights)


class TurnedConstraintMatrix(ConstraintMatrix):
    """B with turned tangential frames."""

    def __init__(self, B: ConstraintMatrix, turn: Turn) -> None:
        self._B, self._turn = B, turn
        self.comm, self.rows, self.columns, self.first = B.comm, B.rows, B.columns, B.first

    @cached_property
    def local(self) -> sparse.csr_matrix:  # type: ignore[override]
        """This rank's rows, computed at the first call."""
        result = (self._turn.matrix(self.rows) @ self._B.local).tocsr()
        result.sort_indices()
        return result

    def apply(self, x: Array, out: Array) -> None:
        """Put the product with x into out."""
        self._B.apply(x, out)
        out[:] = self._turn.turned(out)

    def apply_transpose(self, x: Array, out: Array) -> None:
        """Put the product of the transpose with x into out."""
        self._B.apply_transpose(self._turn.back(x), out)


class ScaledConstraintMatrix(ConstraintMatrix):
    """W B, applied as a product of two factors: it is used too few times for a copy to pay."""

    def __init__(self, B: ConstraintMatrix, weights: Array) -> None:
        self._B, self._weights = B, weights
        self.comm, self.rows, self.columns, self.first = B.comm, B.rows, B.columns, B.first
        self._room = np.empty(B.rows)

    @cached_property
    def local(self) -> sparse.csr_matrix:  # type: ignore[override]
        """Rows of W B, computed at the first call; rows of weight zero are empty.

        A product with a diagonal would reverse the entries of each row.
        """
        local = self._B.local.copy()
        local.data *= np.repeat(self._weights, np.diff(local.indptr))
        local.eliminate_zeros()
        return local

    def apply(self, x: Array, out: Array) -> None:
        """Put W B x into out."""
        self._B.apply(x, out)
        out *= self._weights

    def apply_transpose(self, x: Array, out: Array) -> None:
        """Put Bᵀ W x into out."""
        self._B.apply_transpose(np.multiply(self._weights, x, out=self._room), out)


def without_columns(B: ConstraintMatrix, removed: Mask) -> ConstraintMatrix:
    """B without some columns of this rank (interface,).

    B itself if no rank names any (collective).
    """
    columns = np.concatenate(B.comm.allgather(B.first + np.flatnonzero(removed)))
    if not len(columns):
        return B
    local = B.local.copy()
    local.data[np.isin(local.indices, columns)] = 0.0
    local.eliminate_zeros()
    return ConstraintMatrix(B.comm, local, B.columns)
