"""One block of an iterate's vectors: operations on it stay in the cache and allocate no memory."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from solver.qp.convex_set import Scratch, SeparableSet
from solver.vectors import Mask, Vector


class Block:
    """Views of the vectors, and the feasible set on these components.

    Parameters
    ----------
    feasible
        The set on these components; None where no component is constrained: then the free gradient
        is the gradient itself.
    """

    x: Vector
    g: Vector
    p: Vector
    Ap: Vector
    b: Vector
    z: Vector
    free: Vector
    chopped: Vector
    is_free: Mask

    def __init__(
        self,
        rows: slice,
        vectors: Mapping[str, Any],
        feasible: SeparableSet | None,
        scratch: Scratch,
    ) -> None:
        for name, vector in vectors.items():
            setattr(self, name, vector[rows])
        size = rows.stop - rows.start
        self.t, self.s = scratch.floats("t", size), scratch.floats("s", size)
        self.trial, self.mask = scratch.floats("trial", size), scratch.masks("mask", size)
        self.feasible = None if feasible is None else feasible.on_block(rows, scratch)

    def split(self) -> None:
        """Free and chopped gradient of g at x, and the mask of free components."""
        if self.feasible is not None:
            self.feasible.split(self.x, self.g, self.is_free, self.free, self.chopped)

    def project(self) -> None:
        """Move x to the nearest feasible point."""
        if self.feasible is not None:
            self.feasible.project(self.x)

    def project_into(self, alpha: float, out: Vector) -> None:
        """P(x - αp) into out."""
        np.multiply(self.p, alpha, out=out)
        np.subtract(self.x, out, out=out)
        if self.feasible is not None:
            self.feasible.project(out)

    def step(self, alpha: float) -> None:
        """P(x - αp)."""
        np.multiply(self.p, alpha, out=self.t)
        np.subtract(self.x, self.t, out=self.x)
        self.project()

    def step_to_boundary(self, alpha: float) -> None:
        """P(x - αp), with components that come within rounding of the boundary put on it."""
        if self.feasible is None:
            self.step(alpha)
        else:
            self.feasible.step_to_boundary(self.x, self.p, alpha)

    def reduced(self, alpha: float, out: Vector) -> None:
        """Reduced free gradient for the step length alpha, into out."""
        if self.feasible is None:
            np.copyto(out, self.free)
        else:
            self.feasible.reduce(self.x, self.free, alpha, out)

    def inverse_longest_step(self) -> float:
        """Inverse of the largest length that keeps x - length * p feasible; 0 if all do."""
        return 0.0 if self.feasible is None else self.feasible.inverse_longest_step(self.x, self.p)

    def settle(self) -> None:
        """Put active components on the boundary exactly."""
        if self.feasible is not None:
            self.feasible.settle(self.x)
