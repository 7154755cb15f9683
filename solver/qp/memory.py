"""Curvature stored over changes of the active set: a limited-memory preconditioner.

Every product of a solve tells the curvature along one direction, the pair (p, Ap). Conjugate
gradients forget them when the active set changes. Here the last few pairs, cut to the components
that are free now, build the inverse BFGS matrix

    H ← (I - p yᵀ/pᵀy) H (I - y pᵀ/pᵀy) + p pᵀ/pᵀy,   y = Ap,

which starts from a multiple of the identity or from another preconditioner, and serves as
preconditioner until the next restart; Morales and Nocedal, *Automatic preconditioning by limited
memory quasi-Newton updating*, SIAM J. Optim. 10 (2000), do the same for sequences of linear
systems. It is symmetric positive definite and constant between restarts, as CG needs. Pairs whose
cut spoils them (p is nearly orthogonal to y) are left out.
"""

from __future__ import annotations

import math

import numpy as np

from solver.qp.preconditioner import Preconditioner
from solver.vectors import Mask, Reduction, Vector

#: Least cosine between p and y after the cut.
COSINE = 1e-3


class CurvatureMemory:
    """The last ``pairs`` pairs, and the preconditioner they make; 4 ``pairs`` vectors."""

    def __init__(
        self, size: int, pairs: int, reduction: Reduction, base: Preconditioner | None = None
    ) -> None:
        self.base = base
        self._reduction = reduction
        self._seen = 0
        self._p, self._y = np.zeros((pairs, size)), np.zeros((pairs, size))
        self._cut_p, self._cut_y = np.zeros((pairs, size)), np.zeros((pairs, size))
        self._curvature = [0.0] * pairs
        self._scale = 1.0
        self._used: list[int] = []
        self._r, self._work = np.zeros(size), np.zeros(size)
        self._lengths = [0.0] * pairs

    @property
    def ready(self) -> bool:
        """Whether pairs serve, so that a step of length 1 is about the Newton step."""
        return bool(self._used)

    def observe(self, p: Vector, Ap: Vector) -> None:
        """Keep a pair; it takes the place of the oldest."""
        row = self._seen % len(self._p)
        np.copyto(self._p[row], p)
        np.copyto(self._y[row], Ap)
        self._seen += 1

    def restart(self, free_mask: Mask) -> None:
        """Cut the pairs to the free components; they serve until the next restart."""
        count, capacity = min(self._seen, len(self._p)), len(self._p)
        self._used = []
        for age in range(count, 0, -1):  # oldest first
            row = (self._seen - age) % capacity
            p, y = self._cut_p[row], self._cut_y[row]
            np.multiply(self._p[row], free_mask, out=p)
            np.multiply(self._y[row], free_mask, out=y)
            py, pp, yy = self._reduction.sums(
                float(np.dot(p, y)), float(np.dot(p, p)), float(np.dot(y, y))
            )
            if py > COSINE * math.sqrt(pp * yy) and math.isfinite(pp + yy):
                self._curvature[row] = py
                self._scale = py / yy
                self._used.append(row)

    def apply(self, r: Vector, free_mask: Mask, out: Vector) -> None:
        """H r by the two-loop recursion."""
        np.copyto(self._r, r)
        for row in reversed(self._used):
            self._lengths[row] = self._dot(self._cut_p[row], self._r) / self._curvature[row]
            self._subtract(self._lengths[row], self._cut_y[row], self._r)
        if self.base is not None:
            self.base.apply(self._r, free_mask, out)
            np.multiply(out, free_mask, out=out)
        else:
            np.multiply(self._r, self._scale if self._used else 1.0, out=out)
        for row in self._used:
            length = self._dot(self._cut_y[row], out) / self._curvature[row]
            self._subtract(length - self._lengths[row], self._cut_p[row], out)

    def _dot(self, x: Vector, y: Vector) -> float:
        return self._reduction.sums(float(np.dot(x, y)))[0]

    def _subtract(self, length: float, x: Vector, out: Vector) -> None:
        np.multiply(x, length, out=self._work)
        np.subtract(out, self._work, out=out)
