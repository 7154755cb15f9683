"""Bounds on some components and discs of pairs of others: forces of contact with friction in space.

    l_i ≤ x_i ≤ u_i,      |(x_j, x_k) - c| ≤ r.

The boundary of a disc is curved. At a boundary point with the outer normal n, the chopped gradient
is the part of the gradient whose negative stays in the disc,

    g^c = g - min(g · n, 0) n,

which may be tangent to the boundary: no straight step along it stays in the disc. A solver then
moves towards the projection of a gradient step (Z. Dostál, T. Kozubek, *An optimal algorithm and
superrelaxation for minimization of a quadratic function subject to separable convex constraints
with applications*, Math. Program. 135, 2012). A disc of radius zero is a point: its components are
never free and have no chopped gradient.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.qp.box import Box, BoxOnBlock
from solver.qp.convex_set import Scratch
from solver.vectors import Array, Ints, Mask, Vector

ACTIVITY = 1e-13
"""Distance from the boundary, over the radius, up to which a point counts as a boundary point."""

ROUNDING = 10.0 * np.finfo(np.float64).eps
"""Such a distance over that of the centre from zero, which sets the rounding errors of points.

Without it points on the edges of small discs counted as free, and the normals of these edges had
no correct digits: a cube with μ = 0.1 was not solved in 20,000 multiplications (95 with it).
"""


@dataclass(frozen=True, eq=False)
class BoxAndDiscs:
    """A box, and discs of pairs of components that have no bounds."""

    box: Box
    """Bounds of all components; components of discs have none."""
    first: Ints
    second: Ints
    """The two components of each disc. Shape (discs,)."""
    center: Array  # (2, discs)
    radius: Array  # (discs,)

    @property
    def is_everything(self) -> bool:
        """Whether there are neither bounds nor discs."""
        return self.box.is_everything and not len(self.first)

    @property
    def curved(self) -> bool:
        """Whether a straight step along the boundary may leave the set."""
        return True

    @cached_property
    def rounding(self) -> Array:
        """Rounding errors (discs,) of the place of a point relative to its centre."""
        return ACTIVITY * self.radius + ROUNDING * np.abs(self.center).max(axis=0, initial=0.0)

    @cached_property
    def edge(self) -> Array:
        """Distances (discs,) from the centres from which a point counts as a boundary point."""
        return self.radius - self.rounding

    def blocks(self, size: int) -> Iterator[slice]:
        """All components at once: a disc must not be cut."""
        yield slice(0, size)

    def not_finite(self, offset: int) -> list[str]:
        """Messages on bounds, centres and radii that are not finite."""
        messages = self.box.not_finite(offset)
        bad = ~np.isfinite(self.radius + self.center.sum(axis=0))
        if bad.any():
            at = int(self.first[np.argmax(bad)])
            messages.append(f"component {offset + at}: its disc is not finite")
        return messages

    def empty(self, offset: int) -> list[str]:
        """Messages on crossed bounds and negative radii."""
        messages = self.box.empty(offset)
        if (self.radius < 0.0).any():
            worst = int(np.argmin(self.radius))
            messages.append(
                f"component {offset + int(self.first[worst])}: the radius of its disc is "
                f"{self.radius[worst]:g}"
            )
        return messages

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the set."""
        self.box.project(x)
        self.project_discs(x)

    def project_discs(self, x: Vector, snap: bool = False) -> None:
        """Move pairs outside their discs, with `snap` also those at the edge, to the boundary."""
        away, size = self.from_centers(x)
        moves = size > (self.edge if snap else self.radius)
        scale = np.divide(self.radius, size, out=np.zeros(len(size)), where=size > 0.0)
        for rows, center, part in zip((self.first, self.second), self.center, away, strict=True):
            x[rows[moves]] = (center + scale * part)[moves]

    def from_centers(self, x: Vector) -> tuple[Array, Array]:
        """Pairs relative to their centres, (2, discs), and their lengths, (discs,)."""
        away = np.stack([x[self.first], x[self.second]]) - self.center
        return away, np.hypot(*away)

    def on_block(self, rows: slice, scratch: Scratch) -> "BoxAndDiscsOnBlock":
        """The set of all components, which are one block."""
        return BoxAndDiscsOnBlock(self, rows, scratch)


class BoxAndDiscsOnBlock:
    """The kernels on all components (protocol `SetOnBlock`); those of the discs allocate."""

    def __init__(self, convex_set: BoxAndDiscs, rows: slice, scratch: Scratch) -> None:
        self._set = convex_set
        self._box = BoxOnBlock(convex_set.box, rows, scratch)

    def split(self, x: Vector, g: Vector, is_free: Mask, free: Vector, chopped: Vector) -> None:
        """Free and chopped gradient of g at x, and the mask of free components."""
        self._box.split(x, g, is_free, free, chopped)
        discs = self._set
        away, size = discs.from_centers(x)
        active = size >= discs.edge
        pair = np.stack([g[discs.first], g[discs.second]])
        normal = np.divide(away, size, out=np.zeros_like(away), where=size > 0.0)
        inward = pair - np.minimum((pair * normal).sum(axis=0), 0.0) * normal
        inward[:, discs.radius * np.hypot(*inward) <= discs.rounding * np.hypot(*pair)] = 0.0
        for rows, part in zip((discs.first, discs.second), inward, strict=True):
            is_free[rows] = ~active
            free[rows[active]] = 0.0
            chopped[rows] = np.where(active, part, 0.0)

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the set."""
        self._box.project(x)
        self._set.project_discs(x)

    def step_to_boundary(self, x: Vector, p: Vector, alpha: float) -> None:
        """P(x - αp), with components within rounding errors of the boundary put on it."""
        self._box.step_to_boundary(x, p, alpha)
        self._set.project_discs(x, snap=True)

    def reduce(self, x: Vector, free: Vector, alpha: float, out: Vector) -> None:
        """Reduced free gradient for the step length alpha, into out."""
        self._box.reduce(x, free, alpha, out)
        discs = self._set
        moved = x - alpha * free
        discs.project_discs(moved)
        for rows in (discs.first, discs.second):
            inside = free[rows] != 0.0
            out[rows] = np.where(inside, (x[rows] - moved[rows]) / alpha, 0.0)

    def inverse_longest_step(self, x: Vector, p: Vector) -> float:
        """Inverse of the largest length that keeps x - length * p in the set; 0 if it is free.

        For pairs inside a disc, |d - t p|² = r² has one positive root t.
        """
        inverse = self._box.inverse_longest_step(x, p)
        discs = self._set
        away, size = discs.from_centers(x)
        step = np.stack([p[discs.first], p[discs.second]])
        square = (step**2).sum(axis=0)
        inside = (size < discs.edge) & (square > 0.0)
        if not inside.any():
            return inverse
        along, left = (away * step).sum(axis=0)[inside], (discs.radius - size)[inside]
        left *= (discs.radius + size)[inside]
        root = np.sqrt(along**2 + square[inside] * left)
        # 1 / t = (root - along) / left, without cancellation where along > 0
        best = np.where(along > 0.0, square[inside] / (along + root), (root - along) / left)
        return max(inverse, float(best.max()))

    def settle(self, x: Vector) -> None:
        """Put active components on the boundary exactly."""
        self._box.settle(x)
        self._set.project_discs(x, snap=True)
