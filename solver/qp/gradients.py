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
        for name in Scratch.NAMES:
            setattr(self, name, getattr(scratch, name)[:size])

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
    t: Vector
    s: Vector
    u: Vector
    trial: Vector
    at_lower: Mask
    at_upper: Mask
    mask: Mask
    side: Mask
    sign: Mask

    def split(self) -> None:
        """Free and chopped gradient of g at x, and the mask of free components.

        Without bounds there is nothing to split: the free gradient is g itself.
        """
        if self.lower_edge is None and self.upper_edge is None:
            return
        # products with masks: several times faster than masked copies
        active, outward, kept = self.at_lower, self.mask, self.at_upper
        active.fill(False)
        outward.fill(False)
        side, sign = self.side, self.sign
        if self.lower_edge is not None:
            np.less_equal(self.x, self.lower_edge, out=side)
            np.logical_or(active, side, out=active)
            np.greater(self.g, 0.0, out=sign)
            np.logical_and(side, sign, out=side)
            np.logical_or(outward, side, out=outward)
        if self.upper_edge is not None:
            np.greater_equal(self.x, self.upper_edge, out=side)
            np.logical_or(active, side, out=active)
            np.less(self.g, 0.0, out=sign)
            np.logical_and(side, sign, out=side)
            np.logical_or(outward, side, out=outward)
        np.logical_not(active, out=self.is_free)
        np.multiply(self.g, self.is_free, out=self.free)
        np.logical_not(outward, out=kept)
        np.multiply(self.g, kept, out=self.chopped)  # the projected gradient
        np.subtract(self.chopped, self.free, out=self.chopped)

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

    def step(self, alpha: float) -> None:
        """P(x - αp)."""
        np.multiply(self.p, alpha, out=self.t)
        np.subtract(self.x, self.t, out=self.x)
        self.project()

    @np.errstate(invalid="ignore")  # ∞ - ∞ where there is no bound
    def step_to_bound(self, alpha: float) -> None:
        """P(x - αp), with components that come within rounding of a bound put on it.

        What is left of the distance to the bound is compared with what there was, for a bound
        at zero has no scale of its own.
        """
        if self.lower is not None:
            _towards(self.lower, self.x, out=self.s)
        if self.upper is not None:
            _towards(self.upper, self.x, out=self.u)
        self.step(alpha)
        if self.lower is not None:
            np.less_equal(self.x, self.s, out=self.mask)
            if self.mask.any():
                np.copyto(self.x, self.lower, where=self.mask)
        if self.upper is not None:
            np.greater_equal(self.x, self.u, out=self.mask)
            if self.mask.any():
                np.copyto(self.x, self.upper, where=self.mask)

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

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def inverse_longest_step(self) -> float:
        """Inverse of the largest length that keeps x - length * p in the box; 0 if it is free.

        At a bound 0/0 is passed over, and a step away from it is -∞: never the longest.
        """
        inverse = 0.0
        if self.lower is not None:
            np.subtract(self.x, self.lower, out=self.t)
            np.divide(self.p, self.t, out=self.t)
            inverse = max(inverse, float(np.fmax.reduce(self.t, initial=0.0)))
        if self.upper is not None:
            np.subtract(self.upper, self.x, out=self.t)
            np.divide(self.p, self.t, out=self.t)
            inverse = max(inverse, -float(np.fmin.reduce(self.t, initial=0.0)))
        return inverse


def _towards(bound: Vector, x: Vector, out: Vector) -> None:
    """Put the point ten rounding errors of x - bound away from the bound into out."""
    np.subtract(x, bound, out=out)
    np.multiply(out, ACTIVITY, out=out)
    np.add(out, bound, out=out)


class Scratch:
    """Work space that the blocks share."""

    FLOATS = ("t", "s", "u", "trial")
    MASKS = ("at_lower", "at_upper", "mask", "side", "sign")
    NAMES = FLOATS + MASKS

    def __init__(self, size: int) -> None:
        for name in self.FLOATS:
            setattr(self, name, np.empty(size))
        for name in self.MASKS:
            setattr(self, name, np.empty(size, dtype=bool))
