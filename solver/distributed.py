"""Distributed PETSc vectors and matrices from the local parts of each rank, and back."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.vectors import Array


@contextmanager
def lent(comm: MPI.Intracomm, *arrays: Array) -> Iterator[list[PETSc.Vec]]:
    """Context manager of distributed PETSc vectors on the memory of local parts.

    The vectors are destroyed at the end of the block. Left to Python's garbage collector they would
    keep the arrays alive, gigabytes of temporaries in a large run.
    """
    vectors = [PETSc.Vec().createWithArray(values, comm=comm) for values in arrays]
    try:
        yield vectors
    finally:
        for vector in vectors:
            vector.destroy()


def petsc_rows(comm: MPI.Intracomm, local: sparse.csr_matrix, columns: int) -> PETSc.Mat:
    """A distributed PETSc matrix from each rank's rows, with its share of the columns.

    Rows are sorted; on one rank the matrix uses the memory of their arrays.
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


def local_rows(matrix: PETSc.Mat) -> sparse.csr_matrix:
    """A copy of this rank's rows of a distributed matrix, all columns."""
    begins, places, values = matrix.getValuesCSR()
    shape = (len(begins) - 1, matrix.getSize()[1])
    return sparse.csr_matrix((values, places, begins), shape=shape)


def transposed_rows(
    comm: MPI.Intracomm, local: sparse.csr_matrix, columns: int
) -> sparse.csr_matrix:
    """This rank's rows of the transpose, from its rows and its number of columns (collective)."""
    first, total = comm.exscan(local.shape[0]) or 0, comm.allreduce(local.shape[0])
    parts = []
    for begin, end in pairwise(np.cumsum([0, *comm.allgather(columns)])):
        part = local[:, begin:end].tocoo()
        parts.append((part.col, first + part.row, part.data))
    rows, places, values = (
        np.concatenate(arrays) for arrays in zip(*comm.alltoall(parts), strict=True)
    )
    return sparse.csr_matrix((values, (rows, places)), shape=(columns, total))
