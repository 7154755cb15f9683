"""Rigid bodies: obstacles that move as one, by six numbers in space and three in the plane.

A rigid body has no mesh and no material. Its unknowns are the displacement t of its reference
point c and a rotation vector θ about it, so that a point x of it moves by t + θ × (x - c). Each
component is held at a value or free; force and moment act at the reference point.

The placement of a body (`Placement`) rotates and moves its obstacles exactly, without
linearisation. From there on contact is linear in the further motion of the body. A body is placed
by its prescribed components, and by the displacement of an answer (`contact_app.run.placing`); free
rotations are assumed to be small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.conditions import Scaled
from contact_app.scene.obstacles import Obstacle, Vector

TURNS = {2: 1, 3: 3}
"""Number of components of a rotation, by dimension."""

NOWHERE: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RigidBody:
    """A rigid body."""

    name: str
    obstacles: tuple[Obstacle, ...]
    """Its shapes, in their places of the file."""
    center: Vector
    """Reference point: the centre or point of the first shape."""


@dataclass(frozen=True)
class RigidMotion(Scaled):
    """Prescribed motion of a rigid body by component; None for free components."""

    scales: ClassVar[tuple[str, ...]] = ("displacement", "rotation")

    body: int
    """Number of the rigid body."""
    displacement: tuple[float | None, ...]  # (dimension,)
    rotation: tuple[float | None, ...]  # (1,) in the plane, (3,) in space
    """In radians."""
    source: str

    @property
    def values(self) -> tuple[float | None, ...]:
        """Components of the displacement, then of the rotation."""
        return (*self.displacement, *self.rotation)


@dataclass(frozen=True)
class RigidLoad(Scaled):
    """Force and moment on a rigid body."""

    scales: ClassVar[tuple[str, ...]] = ("force", "moment")

    body: int
    """Number of the rigid body."""
    force: Vector
    moment: Vector
    """Force and moment at the reference point; three components each, also in the plane."""
    source: str


@dataclass(frozen=True)
class Placement:
    """Placement of a rigid body, relative to its place in the scene file."""

    displacement: Vector = NOWHERE
    """Displacement of the reference point."""
    rotation: Vector = NOWHERE
    """Rotation vector in radians."""

    @classmethod
    def of(cls, values: NDArray[np.float64], dimension: int) -> "Placement":
        """A placement from components, displacement then rotation; in the plane about z."""
        t, turn = values[:dimension], values[dimension:]
        turn = turn if dimension == 3 else np.array([0.0, 0.0, turn[0]])
        return cls(_vector(np.append(t, np.zeros(3 - dimension))), _vector(turn))

    def components(self, dimension: int) -> NDArray[np.float64]:
        """Components of the displacement, then of the rotation."""
        turn = self.rotation if dimension == 3 else self.rotation[2:]
        return np.array([*self.displacement[:dimension], *turn])

    def obstacle(self, obstacle: Obstacle, center: Vector) -> Obstacle:
        """The placed obstacle of a body with this reference point."""
        if self == Placement():
            return obstacle
        from scipy.spatial.transform import Rotation  # scenes without rigid bodies do not need it

        turn = Rotation.from_rotvec(np.array(self.rotation)).as_matrix()
        return obstacle.moved(turn, np.array(center), np.array(self.displacement))


@dataclass(frozen=True)
class RigidBodies:
    """The rigid bodies of a scene."""

    dimension: int
    """2 or 3."""
    bodies: tuple[RigidBody, ...]
    motions: tuple[RigidMotion, ...]
    loads: tuple[RigidLoad, ...]
    """Their prescribed motions and their loads."""
    placements: tuple[Placement, ...] = ()
    """The placement of each body; empty before they are placed."""

    def held(self, body: int) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Mask of the held components of a body, displacement then rotation, and their values."""
        return held_components(self.motions, body, self.dimension)

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Numbers of the bodies with a free component; the others act as obstacles."""
        return tuple(k for k in range(len(self.bodies)) if not self.held(k)[0].all())


def held_components(
    motions: Sequence[RigidMotion], body: int, dimension: int
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Mask of the held components of a rigid body, and their values; zero for free components."""
    count = dimension + TURNS[dimension]
    held, values = np.zeros(count, bool), np.zeros(count)
    for motion in motions:
        if motion.body != body:
            continue
        for k, value in enumerate(motion.values):
            if value is not None:
                held[k], values[k] = True, value
    return held, values


def idle_loads(
    loads: Sequence[RigidLoad], motions: Sequence[RigidMotion], dimension: int
) -> list[RigidLoad]:
    """The loads that act along held components alone, so that reactions take them."""
    idle = []
    for load in loads:
        values = np.array([*load.force[:dimension], *load.moment[-TURNS[dimension] :]])
        held = held_components(motions, load.body, dimension)[0]
        if values.any() and not values[~held].any():
            idle.append(load)
    return idle


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
