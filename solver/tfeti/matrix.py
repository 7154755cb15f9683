"""The constraint matrix B and its transpose, applied to local parts of distributed vectors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from solver.vectors import on_arrays

FEW = 0.1
"""Share of weights that differ from one up to which they are taken one by one."""


@contextmanager
def lent(comm: MPI.Intracomm, *arrays: NDArray[np.float64]) -> Iterator[list[PETSc.Vec]]:
    """Distributed PETSc vectors on the memory of the local parts, for as long as the block runs.

    They are destroyed at its end: left to Python's collector they would keep the arrays alive,
    gigabytes of temporaries in a large run.
    """
    vectors = [PETSc.Vec().createWithArray(values, comm=comm) for values in arrays]
    try:
        yield vectors
    finally:
        for vector in vectors:
            vector.destroy()


def petsc_rows(comm: MPI.Intracomm, local: sparse.csr_matrix, columns: int) -> PETSc.Mat:
    """A distributed PETSc matrix from each rank's rows, with its share of the columns.

    Rows are sorted; on one rank the matrix lives on their arrays.
    """
    size = ((local.shape[0], PETSc.DETERMINE), (columns, PETSc.DETERMINE))
    begins, places = (part.astype(PETSc.IntType) for part in (local.indptr, local.indices))
    matrix = PETSc.Mat()
    if comm.size == 1:
        matrix.createAIJWithArrays(size, (begins, places, local.data), comm=comm)
    else:
        matrix.createAIJ(size, csr=(begins, places, local.data), comm=comm)
    matrix.assemble()
    return matrix


def scale_rows(matrix: PETSc.Mat, weights: NDArray[np.float64]) -> None:
    """Multiply each row of a matrix by a weight, in place; local parts."""
    with lent(matrix.comm, weights) as (left,):
        matrix.diagonalScale(L=left)


class ConstraintMatrix:
    """B and its explicit transpose, whose product is twice as fast as a transposed one.

    Attributes
    ----------
    matrix : PETSc matrix (dual, interface)
        Not to be changed any more.
    rows, columns : int
        Of this rank.
    """

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.matrix = matrix
        self.comm: MPI.Intracomm = matrix.getComm().tompi4py()
        self.rows, self.columns = (int(n) for n in matrix.getLocalSize())
        # their own arrays are never touched: they only lend their shape
        self._dual, self._interface = (
            PETSc.Vec().createWithArray(np.empty(n), comm=self.comm)
            for n in (self.rows, self.columns)
        )

    @cached_property
    def _transpose(self) -> PETSc.Mat:
        return self.matrix.transpose(PETSc.Mat())

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put B x into out: (interface,) to (dual,)."""
        on_arrays(self.matrix.mult, self._interface, x, self._dual, out)

    def apply_transpose(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put Bᵀ x into out: (dual,) to (interface,)."""
        on_arrays(self._transpose.mult, self._dual, x, self._interface, out)

    def scaled(self, weights: RowWeights) -> ScaledConstraintMatrix:
        """W B, for weights of this rank's rows."""
        return ScaledConstraintMatrix(self, weights)


class RowWeights:
    """Weights of this rank's rows; where few differ from one, only those are touched.

    Parameters
    ----------
    values : (dual,)
    """

    def __init__(self, values: NDArray[np.float64]) -> None:
        self.values = values
        self._places = np.flatnonzero(values != 1.0)
        self._few = len(self._places) < FEW * len(values)
        self._others = values[self._places]

    def times(self, x: NDArray[np.float64], room: NDArray[np.float64]) -> NDArray[np.float64]:
        """W x: x itself where that is the same, else what is put into `room`."""
        if not self._few:
            return np.multiply(self.values, x, out=room)
        if not x[self._places].any():
            return x
        np.copyto(room, x)
        room[self._places] *= self._others
        return room

    def scale(self, x: NDArray[np.float64]) -> None:
        """Replace x by W x."""
        if self._few:
            x[self._places] *= self._others
        else:
            x *= self.values


class ScaledConstraintMatrix(ConstraintMatrix):
    """W B, applied as it is written: what it serves for is over before copies would pay."""

    def __init__(self, B: ConstraintMatrix, weights: RowWeights) -> None:
        self._B, self._weights = B, weights
        self.comm, self.rows, self.columns = B.comm, B.rows, B.columns
        self._room = np.empty(B.rows)

    @cached_property
    def matrix(self) -> PETSc.Mat:  # type: ignore[override]
        """Made when it is asked for."""
        result = self._B.matrix.copy()
        scale_rows(result, self._weights.values)
        return result

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put W B x into out."""
        self._B.apply(x, out)
        self._weights.scale(out)

    def apply_transpose(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put Bᵀ W x into out."""
        self._B.apply_transpose(self._weights.times(x, self._room), out)
