"""The quadratic program with bounds: minimise ½ xᵀAx - bᵀx over l ≤ x ≤ u (paper, equation 1)."""

from typing import Any

from solver.qp.box import Box
from solver.qp.operators import as_operator
from solver.qp.separable_qp import SeparableQP, local_part
from solver.vectors import Vector


class BoxQP(SeparableQP):
    """A convex quadratic program with bounds; the data are checked.

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
        operator = as_operator(A)
        n, messages = operator.size, list[str]()
        self.lower: Vector | None = (
            None if lower is None else local_part(lower, n, "the lower bound", messages)
        )
        self.upper: Vector | None = (
            None if upper is None else local_part(upper, n, "the upper bound", messages)
        )
        super().__init__(operator, b, Box(self.lower, self.upper), messages)
