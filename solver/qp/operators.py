"""Linear operators: one small protocol, and adapters for matrices of numpy, scipy and PETSc.

A symmetric operator is applied to this rank's part of a distributed vector and fills this
rank's part of the product. Dense and sparse arrays and scipy's operators are on one rank;
PETSc matrices, also shell matrices, on the ranks of their communicator.
"""

import math
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.linalg import LinearOperator

from solver.errors import NotFiniteError, QPError
from solver.vectors import Reduction, Vector, on_arrays


@runtime_checkable
class Operator(Protocol):
    """A symmetric linear operator on distributed vectors.

    An operator may have two more attributes: ``image``, an array that is linear in the last x,
    which an iterate updates by recurrence; and ``image_norm(image)``, which SMALBE uses as ‖Cx‖
    (`PenalisedOperator` of the coarse problem has both).
    """

    comm: MPI.Comm
    """Communicator of all ranks."""
    size: int
    """Components of this rank."""

    def apply(self, x: Vector, out: Vector, /) -> None:
        """Put the product with x into out; both (size,), contiguous, and distinct."""


class MatrixOperator:
    """A dense or sparse array, or a scipy LinearOperator, on one rank."""

    def __init__(self, matrix: Any) -> None:
        self.comm = MPI.COMM_SELF
        self.size = int(matrix.shape[0])
        self.matrix = matrix
        self._dense = isinstance(matrix, np.ndarray)

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product with x into out."""
        if self._dense:
            np.dot(self.matrix, x, out=out)
        else:
            out[:] = self.matrix @ x


class PETScOperator:
    """A PETSc matrix of any type; x and out are lent to PETSc vectors, not copied."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.comm = matrix.getComm().tompi4py()
        self.size = int(matrix.getLocalSize()[0])
        self.matrix = matrix
        self._x, self._out = matrix.createVecs()

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product with x into out."""
        on_arrays(self.matrix.mult, self._x, x, self._out, out)


def as_operator(matrix: Any) -> Operator:
    """Adapt a dense or sparse array, LinearOperator or PETSc.Mat; pass an Operator through.

    Raises
    ------
    QPError
        When it is not square or, for arrays, has an entry that is not finite or not symmetric.
    """
    if isinstance(matrix, PETSc.Mat):
        rows, columns = matrix.getSize()
        _check_square(rows, columns)
        return PETScOperator(matrix)
    if scipy.sparse.issparse(matrix):
        _check_square(*matrix.shape)
        matrix = scipy.sparse.csr_array(matrix, dtype=np.float64)
        _check_sparse(matrix)
        return MatrixOperator(matrix)
    if isinstance(matrix, LinearOperator):
        _check_square(*matrix.shape)
        return MatrixOperator(matrix)
    if isinstance(matrix, Operator):
        return matrix
    array = np.ascontiguousarray(matrix, dtype=np.float64)
    if array.ndim != 2:
        raise QPError(f"the Hessian is an array with {array.ndim} dimensions; a matrix has 2")
    _check_square(*array.shape)
    _check_dense(array)
    return MatrixOperator(array)


def _check_square(rows: int, columns: int) -> None:
    if rows != columns:
        raise QPError(f"the Hessian is {rows} x {columns}; it must be square")


def _check_dense(array: np.ndarray) -> None:
    if not np.isfinite(array).all():
        i, j = np.argwhere(~np.isfinite(array))[0]
        raise NotFiniteError(f"the Hessian's entry ({i}, {j}) is {array[i, j]}")
    scale = float(np.abs(array).max(initial=0.0))
    skew = np.abs(array - array.T)
    if skew.max(initial=0.0) > 1e-9 * scale:
        i, j = np.unravel_index(int(np.argmax(skew)), skew.shape)
        raise QPError(
            f"the Hessian is not symmetric: entry ({i}, {j}) is {array[i, j]:.6g}, "
            f"entry ({j}, {i}) is {array[j, i]:.6g}"
        )


def _check_sparse(array: Any) -> None:
    if not np.isfinite(array.data).all():
        coo = array.tocoo()
        k = int(np.argmax(~np.isfinite(coo.data)))
        raise NotFiniteError(f"the Hessian's entry ({coo.row[k]}, {coo.col[k]}) is {coo.data[k]}")
    skew = abs(array - array.T).tocoo()
    if skew.nnz and skew.data.max() > 1e-9 * np.abs(array.data).max():
        k = int(np.argmax(skew.data))
        raise QPError(f"the Hessian is not symmetric at entry ({skew.row[k]}, {skew.col[k]})")


def estimate_norm(operator: Operator, rtol: float = 1e-5, most: int = 50) -> tuple[float, int]:
    """Largest eigenvalue of a symmetric semidefinite operator, from below, by the power method.

    Starts from the vector of ones, as the paper's implementation does, and ends when the
    Rayleigh quotient changes by less than ``rtol``, relatively. If the vector of ones lies in the
    kernel, as for many stiffness matrices, it starts again from an uneven vector.

    Returns
    -------
    norm : float
    multiplications : int
        Hessian multiplications spent.
    """
    reduction = Reduction(operator.comm)
    first = reduction.offset(operator.size)
    number = np.arange(first, first + operator.size, dtype=np.float64)
    starts = (np.ones(operator.size), 1.0 + np.sin(1.0 + 2.3 * number))
    product = np.empty(operator.size)
    norm, multiplications = 0.0, 0
    for x in starts:
        length = reduction.norm(x)
        if length == 0.0:
            break
        x /= length
        previous = 0.0
        for _ in range(most):
            operator.apply(x, product)
            multiplications += 1
            quotient, square = reduction.sums(
                float(np.dot(x, product)), float(np.dot(product, product))
            )
            if not math.isfinite(quotient + square):
                raise NotFiniteError(
                    "a Hessian multiplication is not finite: component "
                    f"{reduction.first(~np.isfinite(product))}"
                )
            norm = max(norm, quotient)
            if square == 0.0 or abs(quotient - previous) <= rtol * abs(quotient):
                break
            previous = quotient
            np.divide(product, math.sqrt(square), out=x)
        if norm > 1e-12 * math.sqrt(square) and norm > 0.0:
            break
    return norm, multiplications
