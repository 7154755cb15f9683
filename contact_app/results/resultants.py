"""Force and moment about a point, of contacts and supports: their images and their sums.

A force turns with a mirror; a moment, an axial vector, turns and changes its sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.results.mirror import Image

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Resultant:
    """Force and moment about a point, (3,) each.

    Attributes
    ----------
    weight
        Of the point among those of other pieces: the area of the boundary.
    """

    force: Array
    moment: Array
    point: Array
    weight: float

    def image(self, image: Image) -> Resultant:
        """The same of an image."""
        turned, axial = (image.field("displacement", v[None])[0] for v in (self.force, self.moment))
        sign = -1.0 if len(image.mirrors) % 2 else 1.0
        return Resultant(turned, sign * axial, image.points(self.point[None])[0], self.weight)


def joined(pieces: Sequence[Resultant], dimension: int) -> dict[str, Any]:
    """`force`, `moment` and `point` of the sum of pieces; in the plane the moment is a number."""
    weight = np.array([piece.weight for piece in pieces])
    if not weight.any():
        weight = np.ones(len(pieces))
    point = weight @ np.array([piece.point for piece in pieces]) / weight.sum()
    force = np.sum([piece.force for piece in pieces], axis=0)
    moment = np.sum(
        [piece.moment + np.cross(piece.point - point, piece.force) for piece in pieces], axis=0
    )
    return {
        "force": [float(v) for v in force],
        "moment": float(moment[2]) if dimension == 2 else [float(v) for v in moment],
        "point": [float(v) for v in point],
    }
