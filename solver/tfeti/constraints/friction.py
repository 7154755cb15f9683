"""Friction at contact points: tangential rows, and the discs in which their multipliers lie.

A contact point has one normal row and, with friction, as many tangential rows as its node can slide
in directions. With λ_n and λ_t the forces of these rows Coulomb's law asks for

    |λ_t| ≤ μ λ_n,      Tresca's for      |λ_t| ≤ s,

and both for a slip w = 0 where |λ_t| is below its limit, and one along λ_t where it is at it. The
friction force on the body is -λ_t, against the slip (N. Kikuchi, J. T. Oden, *Contact Problems in
Elasticity*, 1988, chapters 10 and 13). Of prescribed slips c the rows see w = B u - c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver.tfeti.constraints.rows import ContactRows, points_of

Array = NDArray[np.float64]

AT_LIMIT = 1e-3
"""Share of the slip limit by which a friction force below it still counts as at the limit: the
limits of Coulomb's law are met to a share of the largest force, not of each."""


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """Tangential rows this rank owns, sorted by node and then by contact.

    Attributes
    ----------
    rows
        Slips, Σ value · ū; `normals` are minus the tangents.
    coefficients : (rows,)
        μ of Coulomb's law; 0 where the slip limit is given.
    limits : (rows,)
        Slip limit of the point, a force; 0 where it is μ λ_n.
    """

    rows: ContactRows
    coefficients: Array
    limits: Array

    def of(self, keep: NDArray[np.bool_]) -> FrictionRows:
        """Some of the rows, (rows,)."""
        return FrictionRows(self.rows.of(keep), self.coefficients[keep], self.limits[keep])

    def at(self, contact: ContactRows) -> FrictionRows:
        """Those of points that have one of some contact rows."""
        return self.of(self.places(contact) >= 0)

    def places(self, contact: ContactRows) -> NDArray[np.int64]:
        """Number of the contact row of the point of each row, -1 where it has none, (rows,)."""
        count = len(contact.nodes)
        keys = [np.stack([part.nodes, part.sources]) for part in (contact, self.rows)]
        every, place = np.unique(np.hstack(keys), axis=1, return_inverse=True)
        place = place.reshape(-1)
        number = np.full(every.shape[1], -1, np.int64)
        number[place[:count]] = np.arange(count)
        return number[place[count:]]


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
    """

    rows: NDArray[np.int64]
    normals: NDArray[np.int64]
    point: NDArray[np.int64]
    first: NDArray[np.int64]
    coefficients: Array
    limits: Array
    spread: Array
    normal_spread: Array

    @classmethod
    def of(
        cls,
        friction: FrictionRows,
        contact: ContactRows,
        tangential: NDArray[np.bool_],
        inequality: NDArray[np.bool_],
    ) -> FrictionPoints:
        """Find the normal row of each tangential one.

        Parameters
        ----------
        tangential, inequality : (dual,)
            Which rows of B are those of `friction` and of `contact`.
        """
        normal = friction.places(contact)
        point = points_of(friction.rows)
        _, first = np.unique(point, return_index=True)
        return cls(
            rows=np.flatnonzero(tangential), normals=np.flatnonzero(inequality)[normal],
            point=point, first=first, coefficients=friction.coefficients[first],
            limits=friction.limits[first], spread=friction.rows.spread,
            normal_spread=contact.spread[normal],
        )  # fmt: skip

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
