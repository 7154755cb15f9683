"""Rigid obstacles: signed distance of points to an obstacle, and its normal.

The normal is a unit vector that points out of the obstacle; the gap is the signed distance along
it, negative inside. A body does not penetrate where -nᵀ u ≤ gap, both taken at the undeformed
point (small displacements). In the plane z is zero and a sphere is a circle.

A new obstacle is a class here with a line in `SHAPES`, and its keys in `schema.bodies`, with the
names of the class's fields.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError

Array = NDArray[np.float64]

Vector = tuple[float, float, float]


class Obstacle(Protocol):
    """A rigid obstacle without a mesh."""

    places: ClassVar[tuple[str, ...]] = ("point",)
    directions: ClassVar[tuple[str, ...]] = ()
    """Names of fields that are points, and of those that are directions (of any non-zero
    length)."""
    not_in_plane: ClassVar[str] = ""
    """Message why the obstacle does not exist in 2D; empty if it does."""

    @property
    def curvature_radius(self) -> float | None:
        """Smallest radius of curvature; None for flat obstacles."""
        return getattr(self, "radius", None)

    def gap_and_normal(self, points: Array) -> tuple[Array, Array]:
        """Gap (n,) and outward unit normal (n, 3) at points (n, 3)."""

    def may_overlap(self, lower: Array, upper: Array) -> bool:
        """Whether the obstacle may overlap a box (3,), (3,); False only if it surely does not."""

    def moved(self, turn: Array, about: Array, by: Array) -> "Obstacle":
        """The obstacle, rotated by a matrix (3, 3) about a point (3,), then moved by (3,)."""
        points, directions = (
            {name: np.array(getattr(self, name)) for name in names}
            for names in (self.places, self.directions)
        )
        vectors = {name: about + turn @ (point - about) + by for name, point in points.items()}
        vectors |= {name: turn @ direction for name, direction in directions.items()}
        values: dict[str, Any] = {name: tuple(map(float, v)) for name, v in vectors.items()}
        return replace(self, **values)  # type: ignore[type-var]

    def describe(self, dimension: int = 3) -> str:
        """A phrase for the report of `check`."""


@dataclass(frozen=True)
class Plane(Obstacle):
    """Half space below a plane."""

    directions: ClassVar[tuple[str, ...]] = ("normal",)

    point: Vector
    """Any point of the plane."""
    normal: Vector
    """Direction out of the obstacle, of any length but zero."""

    def gap_and_normal(self, points: Array) -> tuple[Array, Array]:
        """Gap (n,) and normal (n, 3)."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (points - np.array(self.point)) @ normal, np.tile(normal, (len(points), 1))

    def may_overlap(self, lower: Array, upper: Array) -> bool:
        """Whether a corner of the box lies below the plane."""
        return bool((self.gap_and_normal(_corners(lower, upper))[0] < 0.0).any())

    def describe(self, dimension: int = 3) -> str:
        """A phrase for the report of `check`."""
        point, normal = self.point[:dimension], self.normal[:dimension]
        return f"plane through {_text(point)} with normal {_text(normal)}"


@dataclass(frozen=True)
class Sphere(Obstacle):
    """Ball, or with `hollow` everything outside a spherical cavity; a circle in the plane."""

    places: ClassVar[tuple[str, ...]] = ("center",)

    center: Vector
    radius: float
    hollow: bool = False

    def gap_and_normal(self, points: Array) -> tuple[Array, Array]:
        """Gap (n,) and normal (n, 3).

        Raises
        ------
        ConfigurationError
            A point is at the centre, where no direction is normal.
        """
        return _round(points - np.array(self.center), self, "centre of the sphere")

    def may_overlap(self, lower: Array, upper: Array) -> bool:
        """Test the farthest corner from the centre of a cavity, or the nearest point to a ball.

        At this point of the box the gap is smallest.
        """
        center = np.array(self.center)
        if self.hollow:
            farthest = np.linalg.norm(_corners(lower, upper) - center, axis=1).max()
            return bool(farthest > self.radius)
        return bool(np.linalg.norm(np.clip(center, lower, upper) - center) < self.radius)

    def describe(self, dimension: int = 3) -> str:
        """A phrase for the report of `check`."""
        solid, cavity = (
            ("sphere", "spherical cavity") if dimension == 3 else ("circle", "round cavity")
        )
        kind = cavity if self.hollow else solid
        return f"{kind} about {_text(self.center[:dimension])} of radius {self.radius:g}"


@dataclass(frozen=True)
class Cylinder(Obstacle):
    """Infinite round bar along an axis, or with `hollow` everything outside a bore."""

    directions: ClassVar[tuple[str, ...]] = ("axis",)
    not_in_plane: ClassVar[str] = "has an axis, which needs 3D; in 2D use sphere, a circle there"

    point: Vector
    axis: Vector
    radius: float
    hollow: bool = False

    def gap_and_normal(self, points: Array) -> tuple[Array, Array]:
        """Gap (n,) and normal (n, 3).

        Raises
        ------
        ConfigurationError
            A point is on the axis, where no direction is normal.
        """
        return _round(self._away(points), self, "axis of the cylinder")

    def may_overlap(self, lower: Array, upper: Array) -> bool:
        """Test the farthest corner from the axis of a bore; for a bar return True."""
        if not self.hollow:
            return True
        away = self._away(_corners(lower, upper))
        return bool(np.linalg.norm(away, axis=1).max() > self.radius)

    def _away(self, points: Array) -> Array:
        """Vectors from the axis to points, across it (n, 3)."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        away = points - np.array(self.point)
        return away - np.outer(away @ axis, axis)

    def describe(self, dimension: int = 3) -> str:
        """A phrase for the report of `check`."""
        kind = "bore" if self.hollow else "cylinder"
        return (
            f"{kind} along {_text(self.axis)} through {_text(self.point)} of radius {self.radius:g}"
        )


SHAPES: dict[str, Any] = {"plane": Plane, "sphere": Sphere, "cylinder": Cylinder}
"""Class of each obstacle by its key in the configuration."""


def kind_of(obstacle: Obstacle) -> str:
    """Key of an obstacle in the configuration: plane, sphere, cylinder."""
    return next(kind for kind, shape in SHAPES.items() if isinstance(obstacle, shape))


def _corners(lower: Array, upper: Array) -> Array:
    """Corners of a box (8, 3)."""
    return np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T


def _round(away: Array, shape: Sphere | Cylinder, middle: str) -> tuple[Array, Array]:
    """Gap and normal from vectors away from the middle of a round obstacle."""
    distance = np.linalg.norm(away, axis=1)
    if (distance <= 1e-12 * shape.radius).any():
        raise ConfigurationError(
            f"a contact node lies on the {middle}, where the obstacle has no normal; "
            "move the obstacle or make the contact boundary smaller"
        )
    sign = -1.0 if shape.hollow else 1.0
    return sign * (distance - shape.radius), sign * away / distance[:, None]


def _text(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in vector) + ")"
