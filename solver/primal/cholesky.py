"""Sparse Cholesky factors of PETSc matrices."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from solver.factors import compute_factor
from solver.tfeti.constraints.matrix import local_rows
from solver.vectors import on_arrays

Array = NDArray[np.float64]


def factored(matrix: PETSc.Mat) -> PETSc.PC:
    """A factor by CHOLMOD, by MUMPS on several ranks (collective).

    Raises
    ------
    ArithmeticError
        The matrix has no Cholesky factor.
    """
    pc = PETSc.PC().create(matrix.comm)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    pc.setType("cholesky")
    pc.setFactorSolverType("cholmod" if matrix.comm.size == 1 else "mumps")
    compute_factor(pc, matrix)
    return pc


class SmallInverse:
    """The inverse of a matrix much smaller than K; every rank has the whole factor.

    The messages of a distributed factor would cost more than its work. A diagonal matrix needs no
    factor.

    Raises
    ------
    ArithmeticError
        The matrix has no factor.
    """

    def __init__(self, matrix: PETSc.Mat) -> None:
        self._comm: MPI.Intracomm = matrix.comm.tompi4py()
        local, first = local_rows(matrix), matrix.getOwnershipRange()[0]
        rows = np.repeat(np.arange(local.shape[0]), np.diff(local.indptr))
        coupled = self._comm.allreduce(int((local.indices != first + rows).any()))
        self._diagonal: Array | None = None
        if not coupled:
            self._diagonal = local.diagonal(first)
            return
        if self._comm.size > 1:
            matrix = gathered(self._comm, local)
        self._counts = np.array(self._comm.allgather(local.shape[0]))
        self._of_rank = slice(first, first + local.shape[0])
        self._pc = factored(matrix)
        self._right, self._left = matrix.createVecs()

    def apply(self, values: Array) -> Array:
        """The product with this rank's values (collective)."""
        if self._diagonal is not None:
            return values / self._diagonal
        every = values
        if self._comm.size > 1:
            every = np.empty(self._counts.sum())
            self._comm.Allgatherv(np.ascontiguousarray(values), [every, self._counts])
        out = np.empty_like(every)
        on_arrays(self._pc.apply, self._right, every, self._left, out)
        return out[self._of_rank]


def gathered(comm: MPI.Intracomm, local: sparse.csr_matrix) -> PETSc.Mat:
    """A matrix of this rank alone from all ranks' rows (collective)."""
    joined = sparse.vstack(comm.allgather(local), format="csr")
    joined.sort_indices()
    begins, places = (part.astype(PETSc.IntType) for part in (joined.indptr, joined.indices))
    return PETSc.Mat().createAIJ(
        joined.shape, csr=(begins, places, joined.data), comm=PETSc.COMM_SELF
    )
