"""Warm-started active sets: what a guess of the active set is worth to MPRGP.

Each problem is solved from its own start, and from three guesses whose products count as well:

``look``          ten conjugate gradient steps without bounds, clipped (``MPRGP(look=10)``)
``clipped``       as many as a residual of 0.1 ‖b‖ takes, at most 200
``loose``         MPRGP to a loose tolerance; the components that stay free are those which a
                  gradient step from there leaves inside; CG among them to the final tolerance,
                  clipped into the box
``active sets``   the same, with the free components chosen anew from each such face's solution
                  until they settle (primal-dual active sets; Hintermüller, Ito, Kunisch 2002), at
                  most ten times

MPRGP finishes from the guess to the final tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from contact_app.studies.published import as_published
from contact_app.studies.svm import FIGURES
from contact_app.studies.svm_training import GramOperator, read_libsvm
from solver import MPRGP, BoxQP
from solver.errors import QPError
from solver.qp.benchmark import problems
from solver.qp.examples import permon_string
from solver.qp.operators import Operator, estimate_norm
from solver.vectors import Mask, Vector

FACES = 10
LOOK = 10
LOOSE = 30.0
"""The loose tolerance in units of the final one, at most 0.5."""


@dataclass(frozen=True)
class Problem:
    """A box-constrained problem, its start and its tolerance."""

    name: str
    qp: BoxQP
    x0: Vector
    rtol: float


@dataclass(frozen=True)
class Guess:
    """A start and the products it took."""

    x: Vector
    products: int


def own_start(problem: Problem) -> Guess:
    """The problem's own start."""
    return Guess(problem.x0, 0)


def clipped(problem: Problem) -> Guess:
    """CG without bounds, clipped."""
    qp = problem.qp
    limit = max(10, min(200, qp.size))
    result = MPRGP(rtol=0.1, max_iterations=limit).solve(BoxQP(qp.operator, qp.b), problem.x0)
    return Guess(_clip(qp, result.x), result.counts.hessian)


def loose(problem: Problem) -> Guess:
    """One face from a loose solve."""
    return _faces(problem, 1)


def active_sets(problem: Problem) -> Guess:
    """Faces until they settle."""
    return _faces(problem, FACES)


GUESSES: dict[str, Callable[[Problem], Guess]] = {
    "own start": own_start,
    "look": own_start,
    "clipped": clipped,
    "loose": loose,
    "active sets": active_sets,
}


def _faces(problem: Problem, most: int) -> Guess:
    qp = problem.qp
    first = MPRGP(rtol=min(0.5, LOOSE * problem.rtol)).solve(qp, problem.x0)
    x, products = first.x, first.counts.hessian
    length, gradient = 1.0 / _largest(qp), np.empty(qp.size)
    previous = None
    for _ in range(most):
        qp.operator.apply(x, gradient)
        products += 1
        step = x - length * (gradient - qp.b)
        x = _clip(qp, step)
        free = x == step
        if previous is not None and (free == previous).all():
            break
        previous = free
        face = BoxQP(_Face(qp.operator, free), np.where(free, qp.b - _part(qp, x, free), x))
        result = MPRGP(rtol=0.1 * problem.rtol, max_iterations=500).solve(face, x)
        x, products = result.x, products + 1 + result.counts.hessian
    return Guess(_clip(qp, x), products)


class _Face:
    """A on the free components, the identity on the others."""

    def __init__(self, operator: Operator, free: Mask) -> None:
        self.comm, self.size = operator.comm, operator.size
        self._operator, self._free = operator, free

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product with x into out."""
        self._operator.apply(np.where(self._free, x, 0.0), out)
        out[~self._free] = x[~self._free]


def _part(qp: BoxQP, x: Vector, free: Mask) -> Vector:
    """A times the components that are not free."""
    result = np.empty(qp.size)
    qp.operator.apply(np.where(free, 0.0, x), result)
    return result


def _clip(qp: BoxQP, x: Vector) -> Vector:
    lower = -np.inf if qp.lower is None else qp.lower
    upper = np.inf if qp.upper is None else qp.upper
    return np.clip(x, lower, upper)


def _largest(qp: BoxQP) -> float:
    return estimate_norm(qp.operator)[0] or 1.0


def collection(data: Path | None) -> Iterator[Problem]:
    """PERMON's string, the problems of the benchmark, and the paper's data sets if there."""
    string = permon_string()
    yield Problem("string obstacle of PERMON", string, np.zeros(string.size), 1e-5)
    for made in problems():
        qp = BoxQP(made.A, made.b, made.lower, made.upper)
        yield Problem(made.name, qp, qp.start(None), 1e-6)
    for name in FIGURES if data is not None else ():
        assert data is not None
        samples = as_published(read_libsvm(data / f"{name}.libsvm"), name)
        n = len(samples.labels)
        qp = BoxQP(GramOperator(samples), np.ones(n), np.zeros(n), np.ones(n))
        start = np.full(n, 1.0 - 100.0 * np.finfo(float).eps)
        for rtol in (0.1, 0.01):
            yield Problem(f"{name}, tolerance {rtol:g}", qp, start, rtol)


def compare(data: Path | None = None) -> Iterator[str]:
    """Lines of a Markdown table: products in all, of them for the guess in parentheses."""
    yield "| problem | " + " | ".join(GUESSES) + " |"
    yield "|---|" + "---:|" * len(GUESSES)
    for problem in collection(data):
        cells = [_cell(problem, name) for name in GUESSES]
        yield f"| {problem.name} | " + " | ".join(cells) + " |"


def _cell(problem: Problem, name: str) -> str:
    try:
        guess = GUESSES[name](problem)
    except QPError:
        return "none"  # a face, or the problem without bounds, has no minimum
    look = LOOK if name == "look" else 0
    solver = MPRGP(rtol=problem.rtol, max_iterations=20_000, look=look)
    counts = solver.solve(problem.qp, guess.x).counts
    share = f" ({guess.products})" if guess.products else ""
    return f"{guess.products + counts.hessian}{share}"
