"""The springs of the augmented Lagrangian (`solver.primal.augmented`), of contact and of friction.

They are functions of p = λ + W (C u - c), λ the forces of the last iterate. A contact row has the
energy ½ max(0, p)² / W. With given slip limits s the problem with friction is convex, too: it
minimises J(u) + Σ s |w| over the slips w. A point with friction has the energy

    (½ |p|² - ½ |p - P(p)|²) / W,

P the projection onto the disc of radius s. Its force is P(p): a spring of stiffness W while the
point sticks, |p| ≤ s. A sliding point has the force s d along d = p / |p|, and across d, in a
turned frame, a spring of stiffness W s / |p|.

The limits of Coulomb's law are those of the pressing forces at p (`solver.primal.coupled`), or they
follow the contact forces in each step while L is far from its least value, and then by Anderson's
acceleration (`solver.contact.slip_limits`).
"""

from collections.abc import Callable
from copy import copy
from typing import Self

import numpy as np

from solver.backend import Turn
from solver.contact.friction_points import AT_LIMIT
from solver.contact.law import ContactLaw
from solver.contact.slip_limits import SlipLimits
from solver.primal.friction_springs import FrictionSprings
from solver.primal.merged import MergedSystem
from solver.primal.springs import Coupling
from solver.vectors import Array, Mask


class OneSidedRows:
    """Contact rows without friction; arrays are (rows,), local parts.

    Parameters
    ----------
    stiffness : (rows,)
        W.

    Attributes
    ----------
    W, rows : (rows,)
        Stiffness of the springs, and mask of the rows that have one.
    law
        The law of these rows.
    moves
        Whether the law that they have on one set follows the forces.
    """

    moves = False

    def __init__(self, system: MergedSystem, stiffness: Array, law: ContactLaw) -> None:
        self.system, self.W, self.law = system, stiffness, law
        self.normal = self.rows = system.normal & (stiffness > 0.0)

    def forces(self, p: Array) -> Array:
        """Forces of the springs, (rows,)."""
        return np.where(self.normal, np.maximum(p, 0.0), 0.0)

    def firm(self, p: Array) -> Mask:
        """Contact rows that press, and rows of points that stick, (rows,)."""
        return self.normal & (p > 0.0)

    def springs(self, p: Array) -> tuple[Array, Array, Turn | None]:
        """Forces and stiffness (rows,) at p, in the frames of the turn (collective)."""
        return self.forces(p), np.where(self.firm(p), self.W, 0.0), None

    def along(self, p: Array, rate: Array) -> Callable[[float], tuple[float, float]]:
        """Slope and curvature of the energy of friction at p + t rate, by t (local parts)."""
        return lambda t: (0.0, 0.0)

    def begin(self, forces: Array) -> None:
        """Take the first law from forces (rows,) (collective)."""

    def advance(self, forces: Array, settling: float, accurate: bool) -> None:
        """Take the next law from forces (rows,), if they are accurate or settled (collective).

        `settling` as in `AugmentedOptions`.
        """

    def admissible(self, forces: Array) -> Array:
        """Forces (rows,) that the law itself admits, near those of the springs."""
        return forces


class FrictionRows(OneSidedRows):
    """Contact rows and the tangential rows of points with friction."""

    def __init__(self, system: MergedSystem, stiffness: Array, law: ContactLaw) -> None:
        super().__init__(system, stiffness, law)
        springs = FrictionSprings.of(system, stiffness)
        self._points = system.problem.friction
        self._tangential, self._point = springs.rows, springs.point
        self._normals = springs.normals[self._points.first]
        self._coefficients, self._fixed_limits = springs.coefficients, springs.limits
        count = np.bincount(self._point, minlength=len(self._points.first))
        mean = np.bincount(self._point, springs.sticking, len(count)) / np.maximum(count, 1)
        self._W = mean  # of both rows of a point
        self.W = stiffness.copy()
        self.W[self._tangential] = mean[self._point]
        self.rows = self.normal.copy()
        self.rows[self._tangential] = self.W[self._tangential] > 0.0
        self.begin(np.zeros_like(stiffness))

    @property
    def moves(self) -> bool:  # type: ignore[override]
        """Whether limits follow contact forces: Coulomb's law (collective)."""
        return self._limits.depend_on_forces

    def begin(self, forces: Array) -> None:
        """Take the limits of these contact forces."""
        on_all_rows = self.system.on_all_rows
        limits = SlipLimits(self._points, self.system.comm, on_all_rows(forces), lasting=True)
        self._change(limits)

    def advance(self, forces: Array, settling: float, accurate: bool) -> None:
        """Take the next limits of Anderson's acceleration."""
        limits, multiplier = self._limits, self.system.on_all_rows(forces)
        if self.moves and (limits.settles(multiplier, settling) or accurate):
            limits.advance(multiplier)
            self._change(limits)

    def _change(self, limits: SlipLimits) -> None:
        points = self._points
        self._limits, self._largest = limits, limits.values / points.spread[points.first]
        self.law = self.law.with_limits(limits.values)

    def at(self, p: Array) -> Self:
        """The rows with the slip limits of the pressing forces at p."""
        result = copy(self)
        result._largest = self._fixed_limits + self._coefficients * np.maximum(
            p[self._normals], 0.0
        )
        return result

    def stiffened(self, factor: float) -> Self:
        """The rows with stiffer springs."""
        result = copy(self)
        result.W, result._W = factor * self.W, factor * self._W
        return result

    def turned_back(self, p: Array, after: Array) -> Mask:
        """Tangential rows whose friction points against that before, (rows,)."""
        result, rows = np.zeros(len(p), bool), self._tangential
        result[rows] = (self._points.dots(p[rows], after[rows]) < 0.0)[self._point]
        return result

    def coupling(self, p: Array) -> Coupling:
        """Changes of friction at sliding points by the jumps of their contact rows.

        In space they belong to the frames of `springs`.
        """
        points, first = self._points, self._tangential[self._points.first]
        slides = points.sizes(p[self._tangential]) > self._largest
        some = np.flatnonzero(slides & (self._coefficients > 0.0) & (p[self._normals] > 0.0))
        sign = np.where(p[first] < 0.0, -1.0, 1.0)
        sign[points.planar] = 1.0
        normals = self._normals[some]
        factors = sign[some] * self._coefficients[some] * self.W[normals]
        return Coupling(first[some], normals, factors)

    def forces(self, p: Array) -> Array:
        """Forces of the springs, in contact rows and in tangential rows."""
        result, friction = super().forces(p), p[self._tangential]
        result[self._tangential] = self._shares(self._points.sizes(friction)) * friction
        return result

    def firm(self, p: Array) -> Mask:
        """Contact rows that press, and rows of points that stick."""
        firm, size = super().firm(p), self._points.sizes(p[self._tangential])
        firm[self._tangential] = (size <= self._largest)[self._point]
        return firm

    def _shares(self, size: Array) -> Array:
        """|P(p)| / |p| of each component, (k,), by |p| (points,)."""
        slides = size > self._largest
        return np.divide(self._largest, size, out=np.ones(len(size)), where=slides)[self._point]

    def springs(self, p: Array) -> tuple[Array, Array, Turn | None]:
        """Forces and stiffness; frames of sliding points in space are turned along p."""
        points, rows, largest = self._points, self._tangential, self._largest
        forces, stiffness, _ = super().springs(p)
        forces, friction = self.forces(p), p[rows]
        size = points.sizes(friction)
        planar = points.planar
        slides = (size > largest)[planar]
        if not self.system.comm.allreduce(int(slides.sum())):
            return forces, stiffness, None
        first = points.first[planar]
        one, other = first[slides], first[slides] + 1
        cosine, sine = np.ones(len(planar)), np.zeros(len(planar))
        cosine[slides] = friction[one] / size[planar][slides]
        sine[slides] = friction[other] / size[planar][slides]
        forces[rows[one]], forces[rows[other]] = largest[planar][slides], 0.0
        stiffness[rows[other]] = self._shares(size)[other] * self.W[rows[other]]
        return forces, stiffness, Turn(points.rows[first], points.rows[first + 1], cosine, sine)

    def along(self, p: Array, rate: Array) -> Callable[[float], tuple[float, float]]:
        """Slope and curvature of the energy of friction at p + t rate, by t (local parts)."""
        points, start, rate = self._points, p[self._tangential], rate[self._tangential]
        square = points.dots(rate, rate)
        soft = np.divide(1.0, self._W, out=np.zeros_like(self._W), where=self._W > 0.0)

        def derivatives(t: float) -> tuple[float, float]:
            moved = start + t * rate
            size = points.sizes(moved)
            share, slope = self._shares(size)[points.first], points.dots(moved, rate)
            radial = np.divide(slope, size, out=np.zeros(len(size)), where=size > self._largest)
            return float(soft @ (share * slope)), float(soft @ (share * (square - radial**2)))

        return derivatives

    def admissible(self, forces: Array) -> Array:
        """Forces with friction at Coulomb's limit where it is at that of the present law."""
        points, multiplier = self._points, self.system.on_all_rows(forces)
        limit = points.slip_limits(multiplier) / points.spread[points.first]
        size = points.sizes(forces[self._tangential])
        slides = (size >= (1.0 - AT_LIMIT) * self._largest) | (size > limit)
        share = np.divide(limit, size, out=np.ones(len(size)), where=slides & (size > 0.0))
        result = forces.copy()
        result[self._tangential] *= share[self._point]
        return result


def rows_of(system: MergedSystem, stiffness: Array, law: ContactLaw) -> OneSidedRows:
    """The rows of a system under a law, with springs of a stiffness (rows,)."""
    made = FrictionRows if system.problem.friction.acts else OneSidedRows
    return made(system, stiffness, law)
