"""Where the time of an iteration goes: ``python -m solver.qp.profiling``.

Runs MPRGP on a diagonal Hessian of many variables, whose product is one pass itself, and prints
the seconds of each part of an iteration beside those of copying a vector, and what the loop
allocates.
"""

from __future__ import annotations

import time
import tracemalloc
from collections import defaultdict
from typing import Any

import numpy as np
from mpi4py import MPI

from solver.qp.box_qp import BoxQP
from solver.qp.iterate import Iterate
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.vectors import Vector

PARTS = (
    "evaluate", "probe", "advance", "conjugate", "aim_chopped", "project_step",
    "half_step_and_aim", "aim_reduced",
)  # fmt: skip


class Diagonal:
    """A diagonal Hessian that keeps the seconds it took."""

    def __init__(self, diagonal: Vector) -> None:
        self.comm, self.size = MPI.COMM_SELF, diagonal.size
        self.diagonal = diagonal
        self.seconds, self.products = 0.0, 0

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product into out."""
        began = time.perf_counter()
        np.multiply(self.diagonal, x, out=out)
        self.seconds += time.perf_counter() - began
        self.products += 1


class Timed(Iterate):
    """An iterate that keeps the seconds of its passes, without those of products inside."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.spent: dict[str, list[float]] = defaultdict(list)
        for name in PARTS:
            setattr(self, name, self._timed(name))

    def _timed(self, name: str) -> Any:
        method = getattr(super(), name)

        def call(*arguments: Any, **options: Any) -> Any:
            began, inside = time.perf_counter(), self.operator.seconds  # type: ignore[attr-defined]
            answer = method(*arguments, **options)
            product = self.operator.seconds - inside  # type: ignore[attr-defined]
            self.spent[name].append(time.perf_counter() - began - product)
            return answer

        return call


def profile(n: int = 1_000_000, expansion: str = "projcg-safe") -> str:
    """Solve twice, and tabulate where the time went and what the second solve allocated."""
    it, copy, total, _ = _solve(n, expansion)
    peak = _solve(n, expansion, trace=True)[3]  # tracing slows the loop down
    operator: Any = it.operator
    counts = it.counts
    lines = [
        f"n = {n}, {expansion}: {counts.cg} CG, {counts.expansion} expansion, "
        f"{counts.proportioning} proportioning steps, {counts.hessian} products, {total:.3f} s",
        f"allocated inside the loop at most: {peak / 1024:.1f} KiB (a vector has {8 * n // 1024})",
        "",
        "| part | calls | ms each | in vector copies |",
        "|---|---:|---:|---:|",
        _row("product", operator.products, operator.seconds / operator.products, copy),
    ]
    for name in PARTS:
        if it.spent[name]:
            mean = sum(it.spent[name]) / len(it.spent[name])
            lines.append(_row(f"`{name}`", len(it.spent[name]), mean, copy))
    return "\n".join(lines)


def _solve(n: int, expansion: str, trace: bool = False) -> tuple[Timed, float, float, int]:
    """Solve a box problem: the iterate, seconds of a copy and of the loop, bytes at its peak."""
    operator = Diagonal(np.linspace(1.0, 50.0, n))
    qp = BoxQP(operator, np.sin(np.arange(n)), lower=-0.01, upper=0.02)
    solver = MPRGP(expansion, norm=50.0)
    it = Timed(qp, norm=50.0)
    it.measure_b()
    solver.strategy.prepare(it)
    it.evaluate()
    copy = min(_seconds_of_copy(it.g, it.p.copy()) for _ in range(5))
    if trace:
        tracemalloc.start()
    began = time.perf_counter()
    solver.minimise(
        it, lambda it: Reason.CONVERGED if it.projected_gradient_norm < 1e-8 * it.b_norm else None
    )
    total = time.perf_counter() - began
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return it, copy, total, peak


def _row(name: str, calls: int, seconds: float, copy: float) -> str:
    return f"| {name} | {calls} | {1e3 * seconds:.2f} | {seconds / copy:.1f} |"


def _seconds_of_copy(source: Vector, target: Vector) -> float:
    began = time.perf_counter()
    np.copyto(target, source)
    return time.perf_counter() - began


if __name__ == "__main__":
    print(profile())
