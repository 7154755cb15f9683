"""Products of distributed PETSc matrices with local parts of vectors, and parts of matrices."""

from itertools import pairwise

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import local_rows
from solver.primal.blocks import made_once
from solver.vectors import Array, Ints, Mask, on_arrays


def multiply(matrix: PETSc.Mat, x: Array) -> Array:
    """A product on local parts (collective)."""
    out = np.empty(matrix.getLocalSize()[0])
    right, left = vectors_of(matrix)
    on_arrays(matrix.mult, right, np.ascontiguousarray(x), left, out)
    return out


def multiply_transposed(matrix: PETSc.Mat, x: Array) -> Array:
    """A product with the transpose (collective)."""
    out = np.empty(matrix.getLocalSize()[1])
    right, left = vectors_of(matrix)
    on_arrays(matrix.multTranspose, left, np.ascontiguousarray(x), right, out)
    return out


def vectors_of(matrix: PETSc.Mat) -> tuple[PETSc.Vec, PETSc.Vec]:
    """Vectors of the size of a matrix's columns and rows; only their shapes are used.

    They are made once: to make one is collective.
    """
    vectors: tuple[PETSc.Vec, PETSc.Vec] = made_once(matrix, "vectors", matrix.createVecs)
    return vectors


def chosen_rows(matrix: PETSc.Mat, rows: Ints) -> PETSc.Mat:
    """Some of this rank's rows, all columns (collective)."""
    first = matrix.getOwnershipRange()[0]
    chosen = PETSc.IS().createGeneral((first + rows).astype(PETSc.IntType), comm=matrix.comm)
    begin, end = matrix.getOwnershipRangeColumn()
    columns = PETSc.IS().createStride(end - begin, begin, 1, comm=matrix.comm)
    return matrix.createSubMatrix(chosen, columns)


def chosen_columns(matrix: PETSc.Mat, columns: Ints) -> PETSc.Mat:
    """Some of this rank's columns, all rows (collective)."""
    first = matrix.getOwnershipRangeColumn()[0]
    chosen = PETSc.IS().createGeneral((first + columns).astype(PETSc.IntType), comm=matrix.comm)
    begin, end = matrix.getOwnershipRange()
    rows = PETSc.IS().createStride(end - begin, begin, 1, comm=matrix.comm)
    return matrix.createSubMatrix(rows, chosen)


def own_columns(matrix: PETSc.Mat) -> sparse.csr_matrix:
    """The rows of all ranks, restricted to this rank's columns; made once (collective)."""
    return made_once(matrix, "own columns", lambda: _own_columns(matrix))


def _own_columns(matrix: PETSc.Mat) -> sparse.csr_matrix:
    local, comm = local_rows(matrix), matrix.comm.tompi4py()
    if comm.size == 1:
        return local
    parts = [local[:, first:last] for first, last in pairwise(matrix.getOwnershipRangesColumn())]
    return sparse.vstack(comm.alltoall(parts), format="csr")


def set_diagonal(K: PETSc.Mat, where: Mask, value: float) -> None:
    """Give entries of the diagonal a value (collective)."""
    if not K.comm.tompi4py().allreduce(int(where.any())):
        return
    diagonal = K.getDiagonal()
    diagonal.getArray()[where] = value
    K.setDiagonal(diagonal)


def with_diagonal(K: PETSc.Mat, where: Mask, value: float) -> PETSc.Mat:
    """The matrix with another value in some diagonal entries; itself without any (collective)."""
    if not K.comm.tompi4py().allreduce(int(where.any())):
        return K
    result = K.copy()
    set_diagonal(result, where, value)
    return result
