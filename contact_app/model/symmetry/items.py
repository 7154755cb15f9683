"""Comparison of conditions and contacts with their mirror images, by descriptions."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_app.model.symmetry.bodies import ROUNDED
from contact_app.model.symmetry.boundaries import BoundaryPart, Key
from contact_app.scene.conditions import (
    BodyContact,
    BodyForce,
    Contact,
    DisplacementCondition,
    Pressure,
    Traction,
)
from contact_app.scene.obstacles import Cylinder, Obstacle, Plane, Sphere
from contact_app.scene.scene import Mirror
from meshes.arrays import Array

Item = DisplacementCondition | Traction | Pressure | BodyForce | Contact | BodyContact
Description = tuple[Key, Array]


@dataclass(frozen=True, eq=False)
class Descriptions:
    """Describe items so that equal items have equal descriptions."""

    size: float
    """A length of the scene."""
    number: list[int]
    """Number of the solved body for each body, as in `Half`."""
    part: Callable[[int, str], BoundaryPart]
    """Function that returns the parts of a boundary of a body."""
    factors: Callable[[Item], tuple[float, ...]]
    """Function that returns the factors of an item in each load case; none for contacts."""

    def __call__(self, item: Item, mirror: Mirror | None = None) -> Description:
        """Description of an item or its mirror image: words, and numbers of order one.

        The words include its factors in the load cases: a scene is symmetric if each case is.
        """
        words, numbers = self._described(item, mirror)
        return (*words, self.factors(item)), numbers

    def _described(self, item: Item, mirror: Mirror | None) -> Description:
        """Words and scaled numbers that are equal for an item and its mirror image."""
        kind = type(item).__name__
        if isinstance(item, BodyForce):
            return (kind, self._body(item.body, mirror)), _scaled(_reflected(item.vector, mirror))
        where: Key = (kind, *self._boundary(item.body, item.boundary, mirror))
        if isinstance(item, DisplacementCondition):
            free = tuple(v is None for v in item.values)
            values = _reflected([v or 0.0 for v in item.values], mirror)
            return (*where, free), _scaled(values)
        if isinstance(item, Traction):
            return where, _scaled(_reflected(item.vector, mirror))
        if isinstance(item, Pressure):
            return where, _scaled(np.array([item.value]))
        if isinstance(item, BodyContact):
            other = self._boundary(item.other, item.other_boundary, mirror)
            return (*where, *other, item.round), _scaled(np.array([item.interference]))
        words, numbers = _described_obstacle(item.obstacle, self.size, mirror)
        return (*where, *words), np.append(numbers, _scaled(np.array([item.interference])))

    def _boundary(self, body: int, boundary: str, mirror: Mirror | None) -> Key:
        return (self.number[body], self.part(body, boundary).key(image=mirror is not None))

    def _body(self, body: int, mirror: Mirror | None) -> int:
        """The number of a body, or of its mirror image."""
        if mirror is None or self.number.count(self.number[body]) == 1:
            return body
        return next(k for k, n in enumerate(self.number) if n == self.number[body] and k != body)


def _reflected(vector: Iterable[float], mirror: Mirror | None) -> Array:
    """A vector, or its mirror image."""
    image = np.array(list(vector), float)
    if mirror is not None:
        image[mirror.axis] *= -1.0
    return image


def _scaled(vector: Array) -> Array:
    """Size and direction: numbers that are compared relative to the size."""
    size = float(np.abs(vector).max(initial=0.0))
    return np.array([np.log(size) if size else -np.inf, *(vector / (size or 1.0))])


def _described_obstacle(
    obstacle: Obstacle, size: float, mirror: Mirror | None
) -> tuple[tuple[Any, ...], Array]:
    """Kind and numbers that are equal for equal obstacles, lengths over a size of the scene."""

    def point(values: Iterable[float]) -> Array:
        here = np.array(list(values), float)
        return here if mirror is None else mirror.image(here)

    if isinstance(obstacle, Plane):
        normal = _reflected(obstacle.normal, mirror)
        normal /= np.linalg.norm(normal)
        return ("plane",), np.append(normal, point(obstacle.point) @ normal / size)
    if isinstance(obstacle, Sphere):
        words = ("sphere", obstacle.hollow)
        return words, np.append(point(obstacle.center), obstacle.radius) / size
    assert isinstance(obstacle, Cylinder), f"no mirror image of {obstacle} is known"
    along = _reflected(obstacle.axis, mirror)
    along /= np.linalg.norm(along) * np.sign(along[np.argmax(np.abs(along) > ROUNDED)])
    foot = point(obstacle.point)
    foot -= (foot @ along) * along
    return ("cylinder", obstacle.hollow), np.array([*along, *foot / size, obstacle.radius / size])


def are_alike(a: Description, b: Description) -> bool:
    """Whether two descriptions are equal up to round-off."""
    return a[0] == b[0] and np.allclose(a[1], b[1], rtol=ROUNDED, atol=ROUNDED)
