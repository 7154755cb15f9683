"""Supports, loads and contacts, each with its key in the file.

Conditions may have a name, by which load cases give them a factor; `scaled` applies the factor.
"""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.expressions import FieldExpression
from contact_app.scene.obstacles import Obstacle


@dataclass(frozen=True)
class Scaled:
    """A condition whose values a load case multiplies by a factor."""

    scales: ClassVar[tuple[str, ...]]
    """Names of the fields that are multiplied."""

    name: str | None = field(default=None, kw_only=True)
    """Name by which load cases and steps refer to it."""

    def scaled(self, factor: float) -> Self:
        """The condition with its values times a factor; free components stay free."""
        return replace(self, **{key: times(getattr(self, key), factor) for key in self.scales})


def times(value: Any, factor: float) -> Any:
    """A number, a vector of them or an expression times a factor; None stays None."""
    if isinstance(value, tuple):
        return tuple(times(part, factor) for part in value)
    if isinstance(value, FieldExpression):
        return value.times(factor)
    return None if value is None else factor * value


@dataclass(frozen=True)
class DisplacementCondition(Scaled):
    """Displacement of a boundary by component, None where free."""

    scales: ClassVar[tuple[str, ...]] = ("values",)

    body: int
    boundary: str
    values: tuple[float | None, ...]
    source: str


@dataclass(frozen=True)
class Traction(Scaled):
    """Force per area on a boundary."""

    scales: ClassVar[tuple[str, ...]] = ("vector",)

    body: int
    boundary: str
    vector: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class Pressure(Scaled):
    """Pressure against the outward normal of a boundary."""

    scales: ClassVar[tuple[str, ...]] = ("value",)

    body: int
    boundary: str
    value: float
    source: str


@dataclass(frozen=True)
class TotalLoad(Scaled):
    """Resultant force and moment of the traction on a boundary."""

    scales: ClassVar[tuple[str, ...]] = ("force", "moment")

    body: int
    boundary: str
    force: tuple[float, ...]  # (dimension,)
    moment: tuple[float, float, float]  # (3,)
    at: tuple[float, float, float] | None  # (3,) or None
    """Point at which both act; the centroid of the boundary if None."""
    source: str


@dataclass(frozen=True)
class BodyForce(Scaled):
    """Force per volume in a body."""

    scales: ClassVar[tuple[str, ...]] = ("vector",)

    body: int
    vector: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class Temperature(Scaled):
    """Rise of the temperature of a body over its stress-free temperature."""

    scales: ClassVar[tuple[str, ...]] = ("rise",)

    body: int
    rise: FieldExpression
    source: str


@dataclass(frozen=True)
class Friction:
    """A law of friction; one of its numbers is None, without friction both."""

    coulomb: float | None = None
    """μ of |λ_t| ≤ μ λ_n."""
    tresca: float | None = None
    """s of |λ_t| ≤ s, force per area, on the whole boundary, open or not."""

    @property
    def coefficient(self) -> float:
        """μ, zero with Tresca's law."""
        return self.coulomb or 0.0

    @property
    def limit(self) -> float:
        """s, zero with Coulomb's law."""
        return self.tresca or 0.0

    @property
    def acts(self) -> bool:
        """Whether there is friction."""
        return self.coefficient > 0.0 or self.limit > 0.0

    @property
    def description(self) -> str:
        """Name and number of the law, for messages."""
        if self.coulomb is not None:
            return f"Coulomb friction of {self.coulomb:g}"
        return f"Tresca friction up to {self.limit:g} per area"


FRICTIONLESS = Friction()


@dataclass(frozen=True)
class Contact:
    """A boundary that may touch an obstacle."""

    body: int
    boundary: str
    obstacle: Obstacle
    """The obstacle; one of a rigid body is placed with it."""
    source: str
    interference: float = 0.0
    """Overlap along the normal (length), added to that of the geometry."""
    law: Friction = FRICTIONLESS
    rigid: int | None = None
    part: int = 0
    """Number of the rigid body of the obstacle, and number of the obstacle within the body; None
    and zero for a plain obstacle. A contact with a rigid body of several obstacles is one record
    for each obstacle, with the same source."""

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
    """A boundary that may touch the boundary of another body."""

    body: int
    boundary: str
    other: int
    other_boundary: str
    source: str
    interference: float = 0.0
    """Overlap along the normal (length), added to that of the geometry."""
    law: Friction = FRICTIONLESS
    round: bool = False
    """Whether flat facets stand for smooth surfaces."""


@dataclass(frozen=True)
class Tie:
    """A boundary that is tied to the boundary of another body."""

    body: int
    boundary: str
    other: int
    other_boundary: str
    source: str


@dataclass(frozen=True)
class RigidTie:
    """A boundary whose nodes move with a rigid body."""

    body: int
    boundary: str
    rigid: int
    source: str


@dataclass(frozen=True)
class ContactName:
    """Names of a contact of the scene file."""

    source: str
    """Its key in the file, ``contacts[0]``."""
    on: str
    against: str
    """The contact boundary, body.boundary; and its partner: another such boundary, the name of a
    rigid body, or the kind of an obstacle."""
