"""The quadratic program: minimise ½ xᵀAx - bᵀx over a separable convex set."""

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from solver.errors import NotFiniteError, QPError
from solver.qp.convex_set import SeparableSet
from solver.qp.operators import Operator, as_operator
from solver.vectors import Reduction, Vector


class SeparableQP:
    """A convex quadratic program; the data are checked.

    Parameters
    ----------
    A : dense or sparse array (n, n), LinearOperator, PETSc.Mat or Operator
        Symmetric, positive semidefinite Hessian.
    b : array (n,) or PETSc.Vec
        Right-hand side; the local part where A is distributed.
    feasible
        The set that x lies in.
    messages
        Messages on wrong data of the set on this rank.

    Raises
    ------
    QPError
        Naming the component, when sizes differ, something is NaN, or the set is empty.
    """

    def __init__(
        self, A: Any, b: Any, feasible: SeparableSet, messages: list[str] | None = None
    ) -> None:
        self.operator: Operator = as_operator(A)
        self.comm: MPI.Comm = self.operator.comm
        self.reduction = Reduction(self.comm)
        self._template = b if isinstance(b, PETSc.Vec) else None
        self.feasible = feasible
        faults: list[str] = []
        self.b: Vector = local_part(b, self.size, "b", faults)
        self._raise_first(faults + (messages or []), QPError)
        offset = self.reduction.offset(self.size)
        self._raise_first(_not_finite(self.b, offset) + feasible.not_finite(offset), NotFiniteError)
        self._raise_first(feasible.empty(offset), QPError)

    @property
    def size(self) -> int:
        """Components of this rank."""
        return self.operator.size

    def start(self, x0: Any) -> Vector:
        """Copy of the initial guess (zeros if None), projected into the set."""
        messages: list[str] = []
        x = np.zeros(self.size) if x0 is None else local_part(x0, self.size, "x0", messages).copy()
        self._raise_first(messages, QPError)
        bad = self.reduction.first(~np.isfinite(x))
        if bad is not None:
            raise NotFiniteError(f"component {bad}: the initial guess is not finite")
        self.feasible.project(x)
        return x

    def wrap(self, x: Vector) -> Any:
        """The vector x in the type of b."""
        if self._template is None:
            return x
        vector = self._template.duplicate()
        vector.setArray(x)
        return vector

    def _raise_first(self, messages: list[str], error: type[QPError]) -> None:
        """Raise on all ranks if any rank has a message, so that no rank waits for another."""
        all_messages = [message for part in self.comm.allgather(messages) for message in part]
        if all_messages:
            raise error(all_messages[0])


def local_part(values: Any, n: int, name: str, messages: list[str]) -> Vector:
    """This rank's components as a contiguous float array of its own."""
    if isinstance(values, PETSc.Vec):
        values = values.getArray(readonly=True)
    array = np.array(values, dtype=np.float64)
    if array.ndim == 0 and name != "b":
        array = np.full(n, float(array))
    if array.shape != (n,):
        messages.append(f"{name} has shape {array.shape}; the Hessian needs ({n},)")
        return np.zeros(n)
    return array


def _not_finite(b: Vector, offset: int) -> list[str]:
    bad = ~np.isfinite(b)
    if not bad.any():
        return []
    i = int(np.argmax(bad))
    return [f"component {offset + i}: b is {b[i]}"]
