"""Inverses of matrices much smaller than K, which every rank has as a whole."""

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from solver.factors import CholeskyFactor
from solver.vectors import Array, Mask


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
        if self._diagonal is None:
            self._factor = CholeskyFactor(matrix)

    def apply(self, values: Array) -> Array:
        """The product with values (rows,), or with each column of (rows, columns)."""
        if self._diagonal is not None:
            return (values.T / self._diagonal).T
        columns = values.reshape(len(values), -1)
        return self._factor.solve(columns).reshape(values.shape)


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
