"""Equalities Cx = c on distributed vectors: from arrays, operators or PETSc matrices."""

import math
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from solver.errors import NotFiniteError, QPError
from solver.qp.operators import MatrixOperator, Operator, PETScOperator, estimate_norm
from solver.vectors import Vector, on_arrays


@runtime_checkable
class Equalities(Protocol):
    """The matrix C of the equalities, on distributed vectors."""

    comm: MPI.Comm
    rows: int
    """Rows of this rank. An optional attribute ``norm`` is ‖C‖ where it is known (1 for a
    projector); else the power method finds it."""

    def apply(self, x: Vector, out: Vector, /) -> None:
        """Put Cx (rows,) into out."""

    def apply_transpose(self, m: Vector, out: Vector, /) -> None:
        """Put Cᵀm (size,) into out."""

    def penalised(self, operator: Operator, rho: float, /) -> Operator:
        """The operator x -> Ax + ρ CᵀCx."""


class _Penalising:
    """Equalities whose penalty is added to an operator by two products."""

    def penalised(self: Equalities, operator: Operator, rho: float) -> Operator:
        """The operator x -> Ax + ρ CᵀCx."""
        return Penalised(operator, self, rho)


class MatrixEqualities(_Penalising, MatrixOperator):
    """Equalities from a dense or sparse array or a LinearOperator, on one rank."""

    def __init__(self, matrix: Any) -> None:
        super().__init__(matrix)
        self.rows, self._transpose = self.size, matrix.T

    def apply_transpose(self, m: Vector, out: Vector) -> None:
        """Put Cᵀm into out."""
        out[:] = self._transpose @ m


class PETScEqualities(_Penalising, PETScOperator):
    """Equalities from a PETSc matrix of any type."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        super().__init__(matrix)
        self.rows = self.size

    def apply_transpose(self, m: Vector, out: Vector) -> None:
        """Put Cᵀm into out."""
        on_arrays(self.matrix.multTranspose, self._out, m, self._x, out)


class Penalised:
    """The operator x -> Ax + ρ CᵀCx."""

    def __init__(self, operator: Operator, equalities: Equalities, rho: float) -> None:
        self.comm, self.size = operator.comm, operator.size
        self.operator, self.equalities, self.rho = operator, equalities, rho
        self._rows, self._column = np.zeros(equalities.rows), np.zeros(operator.size)

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product with x into out."""
        self.operator.apply(x, out)
        self.equalities.apply(x, self._rows)
        np.multiply(self._rows, self.rho, out=self._rows)
        self.equalities.apply_transpose(self._rows, self._column)
        np.add(out, self._column, out=out)


def as_equalities(C: Any, comm: MPI.Comm) -> Equalities:
    """Adapt an array, LinearOperator or PETSc.Mat; pass Equalities through."""
    if isinstance(C, PETSc.Mat):
        return PETScEqualities(C)
    if isinstance(C, Equalities):
        return C
    if scipy.sparse.issparse(C):
        C = scipy.sparse.csr_array(C, dtype=np.float64)
    elif not hasattr(C, "matvec"):
        C = np.atleast_2d(np.asarray(C, dtype=np.float64))
    if comm.size > 1:
        raise QPError("a distributed problem needs distributed equalities, such as a PETSc.Mat")
    data = getattr(C, "data", None) if scipy.sparse.issparse(C) else C
    if isinstance(data, np.ndarray) and not np.isfinite(data).all():
        raise NotFiniteError("the matrix of the equalities has entries that are not finite")
    return MatrixEqualities(C)


def equalities_norm(equalities: Equalities, size: int) -> float:
    """‖C‖: the known value, or an estimate by the power method on CᵀC."""
    norm = getattr(equalities, "norm", None)
    if norm:
        return float(norm)

    class Gram:
        comm = equalities.comm

        def __init__(self) -> None:
            self.size = size
            self._rows = np.zeros(equalities.rows)

        def apply(self, x: Vector, out: Vector) -> None:
            equalities.apply(x, self._rows)
            equalities.apply_transpose(self._rows, out)

    return math.sqrt(estimate_norm(Gram())[0]) or 1.0
