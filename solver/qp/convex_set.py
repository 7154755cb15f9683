"""Separable convex sets: products of small closed convex sets of few components each.

A solver uses such a set only through the kernels below, block by block. A set is a box
(`solver.qp.box`), or a box with discs of friction (`solver.qp.discs`). All methods need the
splitting of the gradient g at a feasible point x (paper, section 2; Z. Dostál, T. Kozubek, *An
optimal algorithm and superrelaxation for minimization of a quadratic function subject to separable
convex constraints with applications*, Math. Program. 135, 2012). A factor of the product is active
if x lies on its boundary, and free otherwise. With this,

* free gradient g^f: g on free components, 0 on active ones;
* chopped gradient g^c: on active components the part of g along which the cost falls inside the
  set;
* projected gradient g^P = g^f + g^c: zero exactly at the solution;
* reduced free gradient g^r = (x - P(x - α g^f)) / α: a step α along it stays in the set.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from solver.vectors import Mask, Vector


class Scratch:
    """Work arrays that the blocks of an iterate share."""

    FLOATS = ("t", "s", "u", "trial")
    MASKS = ("at_lower", "at_upper", "mask", "side", "sign")

    def __init__(self, size: int) -> None:
        self._floats = {name: np.empty(size) for name in self.FLOATS}
        self._masks = {name: np.empty(size, dtype=bool) for name in self.MASKS}

    def floats(self, name: str, size: int) -> Vector:
        """The work vector (size,) of that name."""
        return self._floats[name][:size]

    def masks(self, name: str, size: int) -> Mask:
        """The work mask (size,) of that name."""
        return self._masks[name][:size]


class SetOnBlock(Protocol):
    """The set on one block of components; x, g, p, … are the parts of the vectors in the block."""

    def split(self, x: Vector, g: Vector, is_free: Mask, free: Vector, chopped: Vector) -> None:
        """Put the mask of free components, g^f and g^c at x into the last three."""

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the set."""

    def step_to_boundary(self, x: Vector, p: Vector, alpha: float) -> None:
        """Move x to P(x - αp); components within rounding errors of the boundary are put on it."""

    def reduce(self, x: Vector, free: Vector, alpha: float, out: Vector) -> None:
        """Put g^r for the step length α into out."""

    def inverse_longest_step(self, x: Vector, p: Vector) -> float:
        """Inverse of the largest length that keeps x - length · p in the set; 0 if there is none.

        Only steps that leave the set count: away from the boundary it is 0.
        """

    def settle(self, x: Vector) -> None:
        """Put active components on the boundary exactly."""


class SeparableSet(Protocol):
    """A product of convex sets; this rank's components."""

    @property
    def is_everything(self) -> bool:
        """Whether no component is constrained."""

    @property
    def curved(self) -> bool:
        """Whether a straight step along the boundary may leave the set."""

    def blocks(self, size: int) -> Iterator[slice]:
        """Slices of components that are processed together; no slice cuts a factor."""

    def not_finite(self, offset: int) -> list[str]:
        """Messages on data that are not finite, by component.

        This rank's first component is `offset`.
        """

    def empty(self, offset: int) -> list[str]:
        """Messages on empty factors, by component."""

    def project(self, x: Vector) -> None:
        """Move x to the nearest point of the set."""

    def on_block(self, rows: slice, scratch: Scratch) -> SetOnBlock:
        """The set on some components, with work space for its kernels."""
