"""Resultants of contacts and supports: force and moment about a point, mirror images and sums.

A force is reflected as a vector, a moment as an axial vector.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.results.mirror import Image
from meshes.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class Resultant:
    """Force and moment about a point, (3,) each."""

    force: Array
    moment: Array
    point: Array
    weight: float
    """Weight of the point in sums of pieces: the area of the boundary."""

    def image(self, image: Image) -> "Resultant":
        """The resultant of a mirror image."""
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


def summed(
    comm: MPI.Intracomm,
    points: Array,
    on: Mask,
    forces: Array,
    weights: Array,
    moments: Array | None = None,
) -> Resultant:
    """The resultant of forces at the nodes of all ranks (collective).

    Parameters
    ----------
    points, forces : (nodes, 3)
    on : (nodes,)
        Nodes whose mean is the point if there are no weights.
    weights : (nodes,)
        Shares of the area.
    moments : (nodes, 3)
        About each node.
    """
    turned = np.cross(points, forces) + (0.0 if moments is None else moments)
    sums = np.concatenate([
        [weights.sum(), on.sum()], weights @ points, points[on].sum(axis=0),
        forces.sum(axis=0), turned.sum(axis=0),
    ])  # fmt: skip
    area, count, *rest = comm.allreduce(sums)
    weighted, plain, force, moment = np.array(rest).reshape(4, 3)
    weight = area if area > 0.0 else count
    point = (weighted if area > 0.0 else plain) / max(weight, 1e-300)
    return Resultant(force, moment - np.cross(point, force), point, float(weight))
