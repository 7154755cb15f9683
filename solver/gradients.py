"""The splitting of the gradient (paper, section 2), on one block of the vectors.

With A(x) the set of components at a bound (active) and F(x) the others (free),

* free gradient g^f: g on F, 0 on A;
* chopped gradient g^c: on A the part of g along which the cost falls inside the box,
  min(g, 0) at a lower bound, max(g, 0) at an upper one, 0 where both bounds coincide;
* projected gradient g^P = g^f + g^c: zero exactly at the solution;
* reduced free gradient g^r = (x - P(x - α g^f)) / α: a step α along it stays in the box.

A component is active when its distance to a bound is at most ten rounding errors of the bound's
scale, which is u - l where both are finite and |bound| otherwise. So the splitting, and with it
every count, is the same in all units.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solver.vectors import Mask, Vector

#: Rounding errors of the bound's scale within which a component counts as active.
ACTIVITY = 10.0 * np.finfo(np.float64).eps


def activity_edges(
    lower: Vector | None, upper: Vector | None
) -> tuple[Vector | None, Vector | None]:
    """Values at or beyond which a component is active at its lower, its upper bound."""
    low_scale: Vector | None
    high_scale: Vector | None
    if lower is not None and upper is not None:
        width = upper - lower
        one_sided = ~np.isfinite(width)
        low_scale = np.where(one_sided, np.abs(lower), width)
        high_scale = np.where(one_sided, np.abs(upper), width)
    else:
        low_scale = None if lower is None else np.abs(lower)
        high_scale = None if upper is None else np.abs(upper)
    return _edge(lower, low_scale, 1.0), _edge(upper, high_scale, -1.0)


def _edge(bound: Vector | None, scale: Vector | None, sign: float) -> Vector | None:
    if bound is None or scale is None:
        return None
    finite = np.isfinite(bound)
    return bound + sign * ACTIVITY * np.where(finite, scale, 0.0)


class Block:
    """Views of one block of an iterate's vectors, with the kernels that pass over them.

    Elementwise operations on a block stay in the cache; no kernel allocates.
    """

    def __init__(self, rows: slice, vectors: Mapping[str, Any], scratch: Scratch) -> None:
        for name, vector in vectors.items():
            setattr(self, name, None if vector is None else vector[rows])
        size = rows.stop - rows.start
        self.t, self.s, self.trial = scratch.t[:size], scratch.s[:size], scratch.trial[:size]
        self.at_lower, self.at_upper = scratch.at_lower[:size], scratch.at_upper[:size]
        self.mask = scratch.mask[:size]

    x: Vector
    g: Vector
    p: Vector
    Ap: Vector
    b: Vector
    z: Vector
    free: Vector
    chopped: Vector
    lower: Vector | None
    upper: Vector | None
    lower_edge: Vector | None
    upper_edge: Vector | None
    is_free: Mask

    def split(self) -> None:
        """Free and chopped gradient of g at x, and the mask of free components."""
        np.copyto(self.free, self.g)
        if self.lower_edge is None and self.upper_edge is None:
            self.chopped.fill(0.0)
            return
        low, high, outward = self.at_lower, self.at_upper, self.mask
        projected = self.chopped
        np.copyto(projected, self.g)
        self.is_free.fill(True)
        if self.lower_edge is not None:
            np.less_equal(self.x, self.lower_edge, out=low)
            np.copyto(self.is_free, False, where=low)
            np.greater(self.g, 0.0, out=outward)
            np.logical_and(outward, low, out=outward)
            np.copyto(projected, 0.0, where=outward)
        if self.upper_edge is not None:
            np.greater_equal(self.x, self.upper_edge, out=high)
            np.copyto(self.is_free, False, where=high)
            np.less(self.g, 0.0, out=outward)
            np.logical_and(outward, high, out=outward)
            np.copyto(projected, 0.0, where=outward)
        np.logical_not(self.is_free, out=self.mask)
        np.copyto(self.free, 0.0, where=self.mask)
        np.subtract(projected, self.free, out=self.chopped)

    def project(self) -> None:
        """Move x to the nearest point of the box."""
        if self.lower is not None:
            np.maximum(self.x, self.lower, out=self.x)
        if self.upper is not None:
            np.minimum(self.x, self.upper, out=self.x)

    def project_into(self, alpha: float, out: Vector) -> None:
        """P(x - αp) into out."""
        np.multiply(self.p, alpha, out=out)
        np.subtract(self.x, out, out=out)
        if self.lower is not None:
            np.maximum(out, self.lower, out=out)
        if self.upper is not None:
            np.minimum(out, self.upper, out=out)

    def step_to_bound(self, alpha: float) -> None:
        """x - αp, with components that come within rounding of their bound put on it."""
        for bound, towards in ((self.lower, np.greater), (self.upper, np.less)):
            if bound is None:
                continue
            # the gap left, |x - αp - bound|, against the gap there was, where p leads to the bound
            np.subtract(self.x, bound, out=self.s)
            np.multiply(self.p, alpha, out=self.t)
            np.subtract(self.s, self.t, out=self.t)
            np.abs(self.t, out=self.t)
            np.abs(self.s, out=self.s)
            np.multiply(self.s, ACTIVITY, out=self.s)
            np.less_equal(self.t, self.s, out=self.at_lower)
            towards(self.p, 0.0, out=self.mask)
            np.logical_and(self.at_lower, self.mask, out=self.at_lower)
            np.isfinite(bound, out=self.mask)
            np.logical_and(self.at_lower, self.mask, out=self.at_lower)
            # what reaches the bound is moved beyond it, and projected onto it exactly
            np.copyto(self.x, bound, where=self.at_lower)
        np.multiply(self.p, alpha, out=self.t)
        np.subtract(self.x, self.t, out=self.x)
        self.project()

    def reduced(self, alpha: float, out: Vector) -> None:
        """Reduced free gradient for the step length alpha, into out."""
        np.copyto(out, self.free)
        if self.lower is not None:
            np.subtract(self.x, self.lower, out=self.t)
            np.divide(self.t, alpha, out=self.t)
            np.minimum(out, self.t, out=out)
        if self.upper is not None:
            np.subtract(self.x, self.upper, out=self.t)
            np.divide(self.t, alpha, out=self.t)
            np.maximum(out, self.t, out=out)

    def longest_step(self) -> float:
        """Largest length that keeps x - length * p in the box."""
        longest = np.inf
        if self.lower is not None:
            np.subtract(self.x, self.lower, out=self.t)
            longest = min(longest, self._least_ratio(np.greater))
        if self.upper is not None:
            np.subtract(self.x, self.upper, out=self.t)
            longest = min(longest, self._least_ratio(np.less))
        return longest

    def _least_ratio(self, towards: np.ufunc) -> float:
        towards(self.p, 0.0, out=self.at_lower)
        self.s.fill(np.inf)
        np.divide(self.t, self.p, out=self.s, where=self.at_lower)
        return float(np.min(self.s, initial=np.inf))


class Scratch:
    """Work space that the blocks share."""

    def __init__(self, size: int) -> None:
        self.t, self.s, self.trial = (np.empty(size) for _ in range(3))
        self.at_lower, self.at_upper, self.mask = (np.empty(size, dtype=bool) for _ in range(3))
