"""Box-constrained quadratic programmes on which strategies fail (see ``failing_scenes``)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from contact_app.studies.qp_solvers import Problem, random_box, support_vector_machine
from solver.qp import examples

#: min ½ xᵀAx - bᵀx over lower ≤ x ≤ upper: A, b, lower, upper, x0.
Data = tuple[Any, Any, Any, Any, Any]


@dataclass(frozen=True)
class QPCase:
    """A problem; `refused` if an error has to name the cause."""

    name: str
    make: Callable[[], Data]
    refused: bool = False


def _of(problem: Problem) -> Data:
    return problem.A, problem.b, problem.lower, problem.upper, None


def _figure_1() -> Data:
    qp, x0 = examples.figure_1()
    return _dense(qp), qp.b, qp.lower, qp.upper, x0


def _cycle() -> Data:
    qp = examples.cycling_problem()
    return _dense(qp), qp.b, qp.lower, qp.upper, None


def _dense(qp: Any) -> np.ndarray:
    columns = np.zeros((qp.size, qp.size))
    for j, unit in enumerate(np.eye(qp.size)):
        qp.operator.apply(unit, columns[j])
    return columns


def _box(n: int = 60, **changes: Any) -> Data:
    """A random box with replaced data: (index, value) of b, lower or upper."""
    data = dict(zip(("A", "b", "lower", "upper", "x0"), _of(random_box(n, 100.0)), strict=True))
    for name, (index, value) in changes.items():
        data[name] = data[name].copy()
        data[name][index] = value
    return tuple(data.values())


def _equal_bounds() -> Data:
    A, b, lower, upper, x0 = _box()
    upper = np.where(np.arange(len(b)) % 3 == 0, lower, upper)
    return A, b, lower, upper, x0


def _zero_load() -> Data:
    A, b, _, upper, _ = _box()
    return A, 0.0 * b, np.full(len(b), 0.1), 0.2 + upper, None


def _indefinite(boxed: bool) -> Data:
    A, b, lower, upper, x0 = _box()
    none = np.full(len(b), np.inf)
    return A - 5.0 * sparse.identity(len(b)), b, lower, upper if boxed else none, x0


def _unbounded() -> Data:
    n = 60
    diagonal = np.where(np.arange(n) == 7, 0.0, 1.0)
    return sparse.diags(diagonal), np.ones(n), np.zeros(n), np.full(n, np.inf), None


QP_CASES = (
    QPCase("projected CG step raises the cost (Figure 1)", _figure_1),
    QPCase("projected CG steps cycle", _cycle),
    QPCase("semidefinite Hessian", lambda: _of(support_vector_machine("l1", 300))),
    QPCase("condition 1e12", lambda: _of(random_box(60, 1e12))),
    QPCase("dual degenerate", lambda: _of(random_box(400, 1e3, degenerate=True))),
    QPCase("l = u", _equal_bounds),
    QPCase(
        "infinite bounds",
        lambda: _box(lower=(slice(None, None, 2), -np.inf), upper=(slice(1, None, 3), np.inf)),
    ),
    QPCase("b = 0", _zero_load),
    QPCase("l > u", lambda: _box(lower=(4, 10.0)), refused=True),
    QPCase("NaN in b", lambda: _box(b=(3, np.nan)), refused=True),
    QPCase("indefinite Hessian", lambda: _indefinite(False), refused=True),
    QPCase("indefinite Hessian in a finite box", lambda: _indefinite(True)),
    QPCase("cost unbounded below", _unbounded, refused=True),
)
