"""Contact points with friction: forces, slips and slip limits from multipliers and residuals.

With λ_n and λ_t the forces of the normal and the tangential rows of a point Coulomb's law asks for
|λ_t| ≤ μ λ_n, Tresca's for |λ_t| ≤ s, and both for a slip w = 0 where |λ_t| is below its limit and
one along λ_t where it is at it. The friction force on the body is -λ_t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_LIMIT = 1e-3
"""Share of the slip limit by which a friction force below it still counts as at the limit: the
limits of Coulomb's law are met to a share of the largest force, not of each."""


@dataclass(frozen=True, eq=False)
class FrictionPoints:
    """Contact points with friction, by the rows of a problem; this rank's.

    Attributes
    ----------
    rows, normals : (k,)
        Row of B of each tangential row, and that of its point's normal.
    point : (k,)
        Number of the point of each.
    first : (points,)
        One of the tangential rows of each point.
    coefficients, limits : (points,)
        μ, and the slip limit that is given; one of them is 0.
    spread, normal_spread : (k,), (k,)
        Force over multiplier, and slip over residual by its inverse.
    shared, beside : (pairs,), (pairs,)
        Points whose node has other contact rows, and the rows of B of these.
    places, sources : (points, 3), (points,)
        Where each point is, and the number of its contact.
    tangents : (k, dimension)
        Direction of each tangential row.
    """

    rows: NDArray[np.int64]
    normals: NDArray[np.int64]
    point: NDArray[np.int64]
    first: NDArray[np.int64]
    coefficients: Array
    limits: Array
    spread: Array
    normal_spread: Array
    shared: NDArray[np.int64]
    beside: NDArray[np.int64]
    places: Array
    sources: NDArray[np.int64]
    tangents: Array

    @property
    def planar(self) -> NDArray[np.int64]:
        """Points that have two tangential rows, in space; those of a point are neighbours."""
        return np.flatnonzero(np.bincount(self.point, minlength=len(self.first)) == 2)

    def sizes(self, values: Array) -> Array:
        """Lengths of tangential vectors (k,), (points,)."""
        return np.sqrt(np.bincount(self.point, values**2, len(self.first)))

    def dots(self, one: Array, other: Array) -> Array:
        """Inner products of tangential vectors (k,), (points,)."""
        return np.bincount(self.point, one * other, len(self.first)).astype(np.float64)

    def forces(self, multiplier: Array) -> Array:
        """λ_t of multipliers (dual,), (k,)."""
        return np.asarray(multiplier[self.rows] * self.spread)

    def pressing(self, multiplier: Array) -> Array:
        """λ_n, zero where it is tensile, (points,)."""
        own = multiplier[self.normals[self.first]] * self.normal_spread[self.first]
        return np.maximum(own, 0.0)

    def slip_limits(self, multiplier: Array) -> Array:
        """The largest friction forces that multipliers (dual,) allow, (points,)."""
        return self.coefficients * self.pressing(multiplier) + self.limits

    def slips(self, residual: Array) -> Array:
        """w of residuals B u - c (dual,), (k,)."""
        return np.asarray(residual[self.rows] / self.spread)

    def normal_residuals(self, residual: Array) -> Array:
        """Penetrations, of residuals B u - c (dual,): (points,)."""
        return np.asarray(residual[self.normals[self.first]] / self.normal_spread[self.first])

    def sliding(self, multiplier: Array) -> NDArray[np.bool_]:
        """Tangential rows (dual,) of points whose friction force is at its limit, or nearly so."""
        size, limit = self.sizes(self.forces(multiplier)), self.slip_limits(multiplier)
        result = np.zeros(len(multiplier), bool)
        result[self.rows] = (size >= (1.0 - AT_LIMIT) * limit)[self.point]
        return result

    def work_lost(self, multiplier: Array, residual: Array) -> tuple[NDArray[np.int64], Array]:
        """s |w| - λ_t · w of each point, zero or more, and one of its rows of B: (points,) each."""
        slips, forces = self.slips(residual), self.forces(multiplier)
        limit = self.slip_limits(multiplier)
        lost = limit * self.sizes(slips) - self.dots(slips, forces)
        return self.rows[self.first], np.maximum(lost, 0.0)
