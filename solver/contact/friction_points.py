"""Contact points with friction: forces, slips and slip limits from multipliers and residuals.

Let λ_n and λ_t be the forces of the normal and the tangential rows of a point. Coulomb's law
requires |λ_t| ≤ μ λ_n, Tresca's |λ_t| ≤ s. Both require a slip w = 0 where |λ_t| is below its
limit, and a slip along λ_t where |λ_t| is at its limit. The friction force on the body is -λ_t.
"""

from dataclasses import dataclass

import numpy as np

from solver.vectors import Array, Ints, Mask

AT_LIMIT = 1e-3
"""Share of the slip limit by which a friction force below it still counts as at the limit.

The limits of Coulomb's law are met to a share of the largest force, not of each force.
"""


@dataclass(frozen=True, eq=False)
class FrictionPoints:
    """This rank's contact points with friction, by the rows of a problem."""

    rows: Ints
    normals: Ints
    """Row of B of each tangential component, and the row of B of its point's normal. Shape (k,)."""
    point: Ints  # (k,)
    """Number of the point of each tangential component."""
    first: Ints  # (points,)
    """One of the tangential rows of each point."""
    coefficients: Array
    limits: Array
    """Coefficient μ and given slip limit (force) of each point; one of the two is 0. Shape
    (points,)."""
    spread: Array
    normal_spread: Array
    """Force over multiplier; its inverse is slip over residual. Shapes (k,), (k,)."""
    shared: Ints
    other_rows: Ints
    """Points whose node has other contact rows, and those rows of B, or that are held so that they
    cannot stick, and their normal rows. Shapes (pairs,), (pairs,)."""
    places: Array
    sources: Ints
    """Coordinates of each point, and the number of its contact. Shapes (points, 3), (points,)."""
    tangents: Array  # (k, dimension)
    """Direction of each tangential row."""
    acts: bool = True
    """Whether a contact of any rank has friction."""

    @property
    def planar(self) -> Ints:
        """Points with two tangential rows (in space); the two rows of a point are neighbours."""
        return np.flatnonzero(np.bincount(self.point, minlength=len(self.first)) == 2)

    def sizes(self, values: Array) -> Array:
        """Lengths (points,) of tangential vectors (k,)."""
        return np.sqrt(np.bincount(self.point, values**2, len(self.first)))

    def dots(self, one: Array, other: Array) -> Array:
        """Inner products (points,) of tangential vectors (k,)."""
        return np.bincount(self.point, one * other, len(self.first)).astype(np.float64)

    def mean(self, values: Array) -> Array:
        """Means (points,) of values of tangential rows (k,)."""
        count = len(self.first)
        return np.asarray(np.bincount(self.point, values, count) / np.bincount(self.point))

    def forces(self, multiplier: Array) -> Array:
        """Friction forces λ_t (k,) from multipliers (dual,)."""
        return np.asarray(multiplier[self.rows] * self.spread)

    def normal_forces(self, multiplier: Array) -> Array:
        """Normal forces λ_n (points,), negative where tensile, from multipliers (dual,)."""
        return np.asarray(multiplier[self.normals[self.first]] * self.normal_spread[self.first])

    def pressing(self, multiplier: Array) -> Array:
        """Normal forces λ_n (points,), zero where tensile, from multipliers (dual,)."""
        return np.maximum(self.normal_forces(multiplier), 0.0)

    def slip_limits(self, multiplier: Array) -> Array:
        """The largest friction forces that multipliers (dual,) allow, (points,)."""
        return self.coefficients * self.pressing(multiplier) + self.limits

    def slips(self, residual: Array) -> Array:
        """Slips w (k,) from residuals B u - c (dual,)."""
        return np.asarray(residual[self.rows] / self.spread)

    def normal_residuals(self, residual: Array) -> Array:
        """Penetrations (points,) from residuals B u - c (dual,)."""
        return np.asarray(residual[self.normals[self.first]] / self.normal_spread[self.first])

    def sliding(self, multiplier: Array) -> Mask:
        """Tangential rows (dual,) of points whose friction force is (nearly) at its limit."""
        size, limit = self.sizes(self.forces(multiplier)), self.slip_limits(multiplier)
        result = np.zeros(len(multiplier), bool)
        result[self.rows] = (size >= (1.0 - AT_LIMIT) * limit)[self.point]
        return result

    def work_lost(self, multiplier: Array, residual: Array) -> tuple[Ints, Array]:
        """s' |w| - λ_t · w of each point, zero or more, and one of its rows of B: (points,) each.

        s' is the limit of the answer: s, or |λ_t| where the friction force exceeds s.
        """
        slips, forces = self.slips(residual), self.forces(multiplier)
        limit = np.maximum(self.slip_limits(multiplier), self.sizes(forces))
        lost = limit * self.sizes(slips) - self.dots(slips, forces)
        return self.rows[self.first], np.maximum(lost, 0.0)
