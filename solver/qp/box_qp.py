"""The quadratic program with bounds: minimise ½ xᵀAx - bᵀx over l ≤ x ≤ u (paper, equation 1)."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from solver.errors import NotFiniteError, QPError
from solver.qp.operators import Operator, as_operator
from solver.vectors import Reduction, Vector


class BoxQP:
    """A convex quadratic program with bounds, checked.

    Parameters
    ----------
    A : dense or sparse array (n, n), LinearOperator, PETSc.Mat or Operator
        Symmetric, positive semidefinite Hessian.
    b : array (n,) or PETSc.Vec
        Right-hand side; the local part where A is distributed.
    lower, upper : array (n,), float, PETSc.Vec or None
        Bounds; None where there is none, ±inf for components without one.

    Raises
    ------
    QPError
        Naming the component, when sizes differ, something is NaN, or l > u.

    Examples
    --------
    >>> BoxQP([[2.0, 0.0], [0.0, 2.0]], [1.0, 1.0], lower=[0.0, 1.0], upper=[1.0, 0.5])
    Traceback (most recent call last):
    ...
    solver.errors.QPError: component 1: the lower bound 1 exceeds the upper bound 0.5
    """

    def __init__(self, A: Any, b: Any, lower: Any = None, upper: Any = None) -> None:
        self.operator: Operator = as_operator(A)
        self.comm: MPI.Comm = self.operator.comm
        self.reduction = Reduction(self.comm)
        self._template = b if isinstance(b, PETSc.Vec) else None
        n = self.operator.size
        messages: list[str] = []
        self.b: Vector = _local(b, n, "b", messages)
        self.lower = None if lower is None else _local(lower, n, "the lower bound", messages)
        self.upper = None if upper is None else _local(upper, n, "the upper bound", messages)
        self._raise_first(messages, QPError)
        offset = self.reduction.offset(n)
        self._raise_first(_not_finite(self.b, self.lower, self.upper, offset), NotFiniteError)
        self._raise_first(_crossed(self.lower, self.upper, offset), QPError)

    @property
    def size(self) -> int:
        """Components of this rank."""
        return self.operator.size

    def start(self, x0: Any) -> Vector:
        """Copy of the initial guess, projected into the box; of zeros when it is None."""
        messages: list[str] = []
        x = np.zeros(self.size) if x0 is None else _local(x0, self.size, "x0", messages).copy()
        self._raise_first(messages, QPError)
        bad = self.reduction.first(~np.isfinite(x))
        if bad is not None:
            raise NotFiniteError(f"component {bad}: the initial guess is not finite")
        if self.lower is not None:
            np.maximum(x, self.lower, out=x)
        if self.upper is not None:
            np.minimum(x, self.upper, out=x)
        return x

    def wrap(self, x: Vector) -> Any:
        """The vector x as the kind that b was given as."""
        if self._template is None:
            return x
        vector = self._template.duplicate()
        vector.setArray(x)
        return vector

    def _raise_first(self, messages: list[str], error: type[QPError]) -> None:
        """Raise on all ranks when any has something to say, so that none waits for another."""
        found = [message for part in self.comm.allgather(messages) for message in part]
        if found:
            raise error(found[0])


def _local(values: Any, n: int, name: str, messages: list[str]) -> Vector:
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


def _not_finite(b: Vector, lower: Vector | None, upper: Vector | None, offset: int) -> list[str]:
    messages = []
    checks = [("b", b, ~np.isfinite(b))]
    if lower is not None:
        checks.append(("the lower bound", lower, np.isnan(lower) | np.isposinf(lower)))
    if upper is not None:
        checks.append(("the upper bound", upper, np.isnan(upper) | np.isneginf(upper)))
    for name, values, bad in checks:
        if bad.any():
            i = int(np.argmax(bad))
            messages.append(f"component {offset + i}: {name} is {values[i]}")
    return messages


def _crossed(lower: Vector | None, upper: Vector | None, offset: int) -> list[str]:
    if lower is None or upper is None or not (lower > upper).any():
        return []
    i = int(np.argmax(lower > upper))
    return [
        f"component {offset + i}: the lower bound {lower[i]:g} exceeds the upper bound {upper[i]:g}"
    ]
