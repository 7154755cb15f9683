"""Sparse Cholesky factors of PETSc matrices."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from solver.distributed import petsc_rows
from solver.factors import compute_factor
from solver.vectors import Array, Mask, on_arrays


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
    """The inverse of a matrix much smaller than K, which every rank has as a whole.

    The messages of a distributed factor would cost more than its work. A diagonal matrix needs no
    factor.

    Raises
    ------
    ArithmeticError
        The matrix has no factor.
    """

    def __init__(self, matrix: sparse.csr_matrix) -> None:
        diagonal = matrix.diagonal()
        self._diagonal: Array | None = diagonal if matrix.nnz == len(diagonal) else None
        if self._diagonal is not None:
            return
        local = petsc_rows(MPI.COMM_SELF, sparse.csr_matrix(matrix).sorted_indices(), len(diagonal))
        self._pc = factored(local)
        self._right, self._left = local.createVecs()

    def apply(self, values: Array) -> Array:
        """The product with values (rows,), or with each column of (rows, columns)."""
        if values.ndim == 2:
            return np.stack([self.apply(column) for column in values.T], axis=1)
        if self._diagonal is not None:
            return values / self._diagonal
        out = np.empty_like(values)
        on_arrays(self._pc.apply, self._right, np.ascontiguousarray(values), self._left, out)
        return out


class BorderedInverse:
    """The inverse of a matrix from that of its block without a few rows, by block elimination.

    Raises
    ------
    ArithmeticError
        The matrix has no factor.
    """

    def __init__(
        self, inverse: "SmallInverse | BorderedInverse", matrix: sparse.csr_matrix, few: Mask
    ) -> None:
        self._inverse, self._few, self._most = inverse, np.flatnonzero(few), np.flatnonzero(~few)
        rows = matrix[self._few]
        self._border = rows[:, self._most].toarray()
        self._solved = inverse.apply(np.ascontiguousarray(self._border.T))
        complement = rows[:, self._few].toarray() - self._border @ self._solved
        try:
            self._factor = cho_factor(complement)
        except LinAlgError as error:
            raise ArithmeticError("the rows of means have no Cholesky factor") from error

    def apply(self, values: Array) -> Array:
        """The product with values (rows,), or with each column of (rows, columns)."""
        out, most = np.empty_like(values), self._inverse.apply(values[self._most])
        out[self._few] = few = cho_solve(self._factor, values[self._few] - self._border @ most)
        out[self._most] = most - self._solved @ few
        return out
