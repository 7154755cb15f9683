"""The box l ≤ x ≤ u as a separable convex set.

A component is active when its distance to a bound is at most ten rounding errors of the bound's
scale, which is u - l where both are finite and |bound| otherwise. So the splitting, and every count
of steps, is independent of the units. The chopped gradient is min(g, 0) at a lower bound, max(g, 0)
at an upper one, 0 where both bounds coincide.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.qp.convex_set import Scratch
from solver.vectors import Mask, Vector, blocks

#: Rounding errors of the bound's scale within which a component counts as active.
ACTIVITY = 10.0 * np.finfo(np.float64).eps


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds (n,), ±inf for components without one; None where no component has one."""

    lower: Vector | None = None
    upper: Vector | None = None

    @property
    def is_everything(self) -> bool:
        """Whether there are no bounds."""
        return self.lower is None and self.upper is None

    @property
    def curved(self) -> bool:
        """Never: a step along a bound stays on it."""
        return False

    def blocks(self, size: int) -> Iterator[slice]:
        """Slices of components that are processed together."""
        return blocks(size)

    def not_finite(self, offset: int) -> list[str]:
        """Messages on bounds that are NaN, or infinite so that no point is left."""
        checks = []
        if self.lower is not None:
            bad = np.isnan(self.lower) | np.isposinf(self.lower)
            checks.append(("the lower bound", self.lower, bad))
        if self.upper is not None:
            bad = np.isnan(self.upper) | np.isneginf(self.upper)
            checks.append(("the upper bound", self.upper, bad))
        messages = []
        for name, values, bad in checks:
            if bad.any():
                i = int(np.argmax(bad))
                messages.append(f"component {offset + i}: {name} is {values[i]}")
        return messages

    def empty(self, offset: int) -> list[str]:
        """Messages on components whose lower bound exceeds the upper bound."""
        lower, upper = self.lower, self.upper
        if lower is None or upper is None or not (lower > upper).any():
            return []
        i = int(np.argmax(lower > upper))
        return [
            f"component {offset + i}: the lower bound {lower[i]:g} exceeds the upper bound "
            f"{upper[i]:g}"
        ]

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the box."""
        _clip(x, self.lower, self.upper)

    def on_block(self, rows: slice, scratch: Scratch) -> "BoxOnBlock":
        """The bounds of some components."""
        return BoxOnBlock(self, rows, scratch)

    @cached_property
    def edges(self) -> tuple[Vector | None, Vector | None]:
        """Values (n,) at or beyond which components are active at the lower and upper bounds."""
        lower, upper = self.lower, self.upper
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


def _clip(x: Vector, lower: Vector | None, upper: Vector | None) -> None:
    """Move x to the nearest point of l ≤ x ≤ u, in place."""
    if lower is not None:
        np.maximum(x, lower, out=x)
    if upper is not None:
        np.minimum(x, upper, out=x)


def _edge(bound: Vector | None, scale: Vector | None, sign: float) -> Vector | None:
    if bound is None or scale is None:
        return None
    finite = np.isfinite(bound)
    return bound + sign * ACTIVITY * np.where(finite, scale, 0.0)


class BoxOnBlock:
    """The bounds of one block, with its kernels (protocol `SetOnBlock`).

    Elementwise operations on a block stay in the cache; no kernel allocates.
    """

    def __init__(self, box: Box, rows: slice, scratch: Scratch) -> None:
        def part(vector: Vector | None) -> Vector | None:
            return None if vector is None else vector[rows]

        self.lower, self.upper = part(box.lower), part(box.upper)
        self.lower_edge, self.upper_edge = map(part, box.edges)
        size = rows.stop - rows.start
        self.s, self.t, self.u = (scratch.floats(name, size) for name in "stu")
        self.at_lower, self.at_upper, self.mask, self.side, self.sign = (
            scratch.masks(name, size) for name in ("at_lower", "at_upper", "mask", "side", "sign")
        )

    def split(self, x: Vector, g: Vector, is_free: Mask, free: Vector, chopped: Vector) -> None:
        """Free and chopped gradient of g at x, and the mask of free components."""
        # products with masks: several times faster than masked copies
        active, outward, held = self.at_lower, self.mask, self.at_upper
        active.fill(False)
        outward.fill(False)
        side, sign = self.side, self.sign
        if self.lower_edge is not None:
            np.less_equal(x, self.lower_edge, out=side)
            np.logical_or(active, side, out=active)
            np.greater(g, 0.0, out=sign)
            np.logical_and(side, sign, out=side)
            np.logical_or(outward, side, out=outward)
        if self.upper_edge is not None:
            np.greater_equal(x, self.upper_edge, out=side)
            np.logical_or(active, side, out=active)
            np.less(g, 0.0, out=sign)
            np.logical_and(side, sign, out=side)
            np.logical_or(outward, side, out=outward)
        np.logical_not(active, out=is_free)
        np.multiply(g, is_free, out=free)
        np.logical_not(outward, out=held)
        np.multiply(g, held, out=chopped)  # the projected gradient
        np.subtract(chopped, free, out=chopped)

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the box."""
        _clip(x, self.lower, self.upper)

    @np.errstate(invalid="ignore")  # ∞ - ∞ where there is no bound
    def step_to_boundary(self, x: Vector, p: Vector, alpha: float) -> None:
        """P(x - αp), with components that come within rounding of a bound put on it.

        The distance to the bound after the step is compared with the distance before it, because a
        bound at zero has no scale.
        """
        if self.lower is not None:
            _towards(self.lower, x, out=self.s)
        if self.upper is not None:
            _towards(self.upper, x, out=self.u)
        np.multiply(p, alpha, out=self.t)
        np.subtract(x, self.t, out=x)
        self.project(x)
        if self.lower is not None:
            np.less_equal(x, self.s, out=self.mask)
            if self.mask.any():
                np.copyto(x, self.lower, where=self.mask)
        if self.upper is not None:
            np.greater_equal(x, self.u, out=self.mask)
            if self.mask.any():
                np.copyto(x, self.upper, where=self.mask)

    def reduce(self, x: Vector, free: Vector, alpha: float, out: Vector) -> None:
        """Reduced free gradient for the step length alpha, into out."""
        np.copyto(out, free)
        if self.lower is not None:
            np.subtract(x, self.lower, out=self.t)
            np.divide(self.t, alpha, out=self.t)
            np.minimum(out, self.t, out=out)
        if self.upper is not None:
            np.subtract(x, self.upper, out=self.t)
            np.divide(self.t, alpha, out=self.t)
            np.maximum(out, self.t, out=out)

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def inverse_longest_step(self, x: Vector, p: Vector) -> float:
        """Inverse of the largest length that keeps x - length * p in the box; 0 if it is free.

        At a bound, 0/0 is ignored, and a step away from the bound gives -∞, which never is the
        largest inverse.
        """
        inverse = 0.0
        if self.lower is not None:
            np.subtract(x, self.lower, out=self.t)
            np.divide(p, self.t, out=self.t)
            inverse = max(inverse, float(np.fmax.reduce(self.t, initial=0.0)))
        if self.upper is not None:
            np.subtract(self.upper, x, out=self.t)
            np.divide(p, self.t, out=self.t)
            inverse = max(inverse, -float(np.fmin.reduce(self.t, initial=0.0)))
        return inverse

    def settle(self, x: Vector) -> None:
        """Put active components on their bounds exactly."""
        if self.lower is not None and self.lower_edge is not None:
            np.less_equal(x, self.lower_edge, out=self.mask)
            np.copyto(x, self.lower, where=self.mask)
        if self.upper is not None and self.upper_edge is not None:
            np.greater_equal(x, self.upper_edge, out=self.mask)
            np.copyto(x, self.upper, where=self.mask)


def _towards(bound: Vector, x: Vector, out: Vector) -> None:
    """Put the point ten rounding errors of x - bound away from the bound into out."""
    np.subtract(x, bound, out=out)
    np.multiply(out, ACTIVITY, out=out)
    np.add(out, bound, out=out)
