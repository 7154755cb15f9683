"""Supports, loads and contacts, each with its key in the file.

Conditions may have a name, by which load cases give them a factor; `scaled` applies the factor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.expressions import FieldExpression
from contact_app.scene.obstacles import Obstacle


@dataclass(frozen=True)
class DisplacementCondition:
    """Displacement of a boundary by component, None where free."""

    body: int
    boundary: str
    values: tuple[float | None, ...]
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> DisplacementCondition:
        """The condition with its values times a factor; free components stay free."""
        values = tuple(None if v is None else factor * v for v in self.values)
        return replace(self, values=values)


@dataclass(frozen=True)
class Traction:
    """Force per area on a boundary."""

    body: int
    boundary: str
    vector: tuple[float, ...]
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> Traction:
        """The traction times a factor."""
        return replace(self, vector=tuple(factor * v for v in self.vector))


@dataclass(frozen=True)
class Pressure:
    """Pressure against the outward normal of a boundary."""

    body: int
    boundary: str
    value: float
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> Pressure:
        """The pressure times a factor."""
        return replace(self, value=factor * self.value)


@dataclass(frozen=True)
class TotalLoad:
    """Resultant force and moment of the traction on a boundary.

    Attributes
    ----------
    force : (dimension,)
    moment : (3,)
    at : (3,) or None
        Point at which both act; the centroid of the boundary if None.
    """

    body: int
    boundary: str
    force: tuple[float, ...]
    moment: tuple[float, float, float]
    at: tuple[float, float, float] | None
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> TotalLoad:
        """The force and moment times a factor."""
        x, y, z = self.moment
        force = tuple(factor * v for v in self.force)
        return replace(self, force=force, moment=(factor * x, factor * y, factor * z))


@dataclass(frozen=True)
class BodyForce:
    """Force per volume in a body."""

    body: int
    vector: tuple[float, ...]
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> BodyForce:
        """The force times a factor."""
        return replace(self, vector=tuple(factor * v for v in self.vector))


@dataclass(frozen=True)
class Temperature:
    """Rise of the temperature of a body over its stress-free temperature."""

    body: int
    rise: FieldExpression
    source: str
    name: str | None = None

    def scaled(self, factor: float) -> Temperature:
        """The rise times a factor."""
        return replace(self, rise=self.rise.times(factor))


@dataclass(frozen=True)
class Friction:
    """A law of friction; one of its numbers is None.

    Attributes
    ----------
    coulomb
        μ of |λ_t| ≤ μ λ_n.
    tresca
        s of |λ_t| ≤ s, force per area, on the whole boundary, open or not.
    """

    coulomb: float | None = None
    tresca: float | None = None


@dataclass(frozen=True)
class Contact:
    """A boundary that may touch an obstacle.

    Attributes
    ----------
    obstacle
        The obstacle; one of a rigid body is placed with it.
    interference
        Overlap along the normal (length), added to that of the geometry.
    rigid, part
        Number of the rigid body of the obstacle, and number of the obstacle within the body; None
        and zero for a plain obstacle. A contact with a rigid body of several obstacles is one
        record for each obstacle, with the same source.
    friction
        None where the boundary slides freely.
    """

    body: int
    boundary: str
    obstacle: Obstacle
    source: str
    interference: float = 0.0
    friction: Friction | None = None
    rigid: int | None = None
    part: int = 0

    def gap_and_normal(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gap (n,), less the interference, and normal (n, 3) of the obstacle at points (n, 3).

        Raises
        ------
        ConfigurationError
            The obstacle has no normal at a point.
        """
        gap, normal = self.obstacle.gap_and_normal(points)
        return gap - self.interference, normal


@dataclass(frozen=True)
class BodyContact:
    """A boundary that may touch the boundary of another body.

    Attributes
    ----------
    interference
        Overlap along the normal (length), added to that of the geometry.
    friction
        None where the boundaries slide freely.
    round
        Whether flat facets stand for smooth surfaces.
    """

    body: int
    boundary: str
    other: int
    other_boundary: str
    source: str
    interference: float = 0.0
    friction: Friction | None = None
    round: bool = False


@dataclass(frozen=True)
class Tie:
    """A boundary that is tied to the boundary of another body."""

    body: int
    boundary: str
    other: int
    other_boundary: str
    source: str


@dataclass(frozen=True)
class ContactName:
    """Names of a contact of the scene file.

    Attributes
    ----------
    source
        Its key in the file, ``contacts[0]``.
    on, against
        The contact boundary, body.boundary; and its partner: another such boundary, the name of a
        rigid body, or the kind of an obstacle.
    """

    source: str
    on: str
    against: str
