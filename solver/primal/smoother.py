"""Chebyshev's iteration within the displacements that leave the active rows alone.

Jacobi's correction D⁻¹ r moves active rows. If the projector Π undid that only at the end of a
V-cycle, the residual that the coarse levels receive would contain forces of motions that are not
there. So each step is projected, x ← x + ω Π D⁻¹ (r - K x). Π is orthogonal in the norm of D, so
that Π D⁻¹ = Π D⁻¹ Πᵀ is symmetric, and its eigenvalues with K are not larger than those of D⁻¹ K.
The polynomials are those of Saad, Iterative Methods for Sparse Linear Systems, 2003, algorithm
12.1.
"""

import numpy as np
from petsc4py import PETSc

from solver.primal.hierarchy import Hierarchy
from solver.primal.products import multiply
from solver.primal.projector import Projector
from solver.vectors import Array


class Smoother:
    """The smoother of the finest level.

    Parameters
    ----------
    K
        Stiffness, for products.
    flexibility : (unknowns,)
        D⁻¹.
    hierarchy
        Has the estimate of the largest eigenvalue of D⁻¹ K, and the options.
    """

    def __init__(self, K: PETSc.Mat, flexibility: Array, hierarchy: Hierarchy) -> None:
        self._K, self._flexibility, self._steps = K, flexibility, hierarchy.options.smoothing
        lower, upper = hierarchy.largest * np.array(hierarchy.options.interval)
        self._middle, self._half = 0.5 * float(upper + lower), 0.5 * float(upper - lower)

    def begin(self, residual: Array, projector: Projector) -> Array:
        """x from zero, for a residual Πᵀ r (collective).

        The first step needs no projection, unless some rows have a compliance: Π Π is not Π then.
        """
        x = self._flexibility * residual / self._middle
        if projector.compliance is not None:
            x = projector.apply(x)
        self._go_on(residual, x, x.copy(), projector)
        return x

    def apply(self, residual: Array, x: Array, projector: Projector) -> None:
        """Improve x in place (collective)."""
        left = residual - multiply(self._K, x)
        step = projector.apply(self._flexibility * left) / self._middle
        x += step
        self._go_on(residual, x, step, projector)

    def _go_on(self, residual: Array, x: Array, step: Array, projector: Projector) -> None:
        """The steps after the first one, in place."""
        last = ratio = self._half / self._middle
        for _ in range(1, self._steps):
            left = residual - multiply(self._K, x)
            factor = 1.0 / (2.0 / ratio - last)
            step *= factor * last
            step += 2.0 * factor / self._half * projector.apply(self._flexibility * left)
            last = factor
            x += step
