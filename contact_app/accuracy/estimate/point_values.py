"""Interpolation of nodal values of one mesh at any point, for instance at nodes of the next mesh.

Each point is sent to the ranks that hold a subdomain of its body near it, located there, and its
value is interpolated in the cell that contains it or lies nearest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.model import Model
from meshes import Reference
from meshes.point_location import locate

Array = NDArray[np.float64]

AROUND = 0.05
"""Distance from a subdomain, relative to its size, up to which it gives values at outside
points."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """The subdomains of one class.

    Attributes
    ----------
    bodies : (members,)
    translations : (members, 3)
    values : (nodes, members, width)
    """

    reference: Reference
    bodies: NDArray[np.int64]
    translations: Array
    values: Array

    @property
    def boxes(self) -> Array:
        """The box of each member: lower and upper corner, (members, 2, 3)."""
        points = self.reference.points
        corners = np.stack([points.min(axis=0), points.max(axis=0)])
        around = AROUND * np.linalg.norm(corners[1] - corners[0])
        corners = corners + around * np.array([[-1.0], [1.0]])
        return np.asarray(corners + self.translations[:, None])


class PointValues:
    """Interpolates nodal values; construction and calls are collective.

    Stores only the meshes and values of a model.

    Parameters
    ----------
    values : one (nodes, members, width) array per class
    """

    def __init__(self, model: Model, values: Sequence[Array]) -> None:
        self._comm, self._dimension = model.comm, model.scene.dimension
        self._width = self._comm.allreduce(
            max((part.shape[2] for part in values), default=0), op=MPI.MAX
        )
        self._pieces = []
        for number, part in enumerate(values):
            places = np.flatnonzero(model.place[:, 0] == number)
            places = places[np.argsort(model.place[places, 1])]
            members = [model.partition.subdomains[i] for i in places]
            self._pieces.append(
                _Piece(
                    members[0].reference,
                    np.array([s.body for s in members]),
                    np.array([s.translation for s in members]),
                    part,
                )
            )
        bodies = len(model.scene.bodies)
        self._boxes = self._comm.allgather(_around(self._pieces, bodies))

    def at(self, points: Array, bodies: NDArray[np.int64]) -> Array:
        """Values at points (n, 3) of bodies (n,): (n, width); 0 far from the mesh."""
        requests = [
            np.flatnonzero(_inside(boxes[bodies], points)) if len(points) else bodies
            for boxes in self._boxes
        ]
        questions = self._comm.alltoall([(points[rows], bodies[rows]) for rows in requests])
        answers = self._comm.alltoall([self._local_values(*question) for question in questions])
        nearest, result = np.full(len(points), np.inf), np.zeros((len(points), self._width))
        for rows, (values, distance) in zip(requests, answers, strict=True):
            better = distance < nearest[rows]
            result[rows[better]], nearest[rows[better]] = values[better], distance[better]
        return result

    def _local_values(self, points: Array, bodies: NDArray[np.int64]) -> tuple[Array, Array]:
        """Values of this rank at points, and the distance of the points from its mesh."""
        nearest, result = np.full(len(points), np.inf), np.zeros((len(points), self._width))
        order = np.argsort(points[:, 0], kind="stable")
        along = points[order, 0]
        for piece in self._pieces:
            requests = []
            for body, box in zip(piece.bodies, piece.boxes, strict=True):
                begin = np.searchsorted(along, box[0, 0])
                near = order[begin : np.searchsorted(along, box[1, 0], side="right")]
                requests.append(near[(bodies[near] == body) & _inside(box, points[near])])
            member = np.repeat(np.arange(len(requests)), [len(rows) for rows in requests])
            row = np.concatenate(requests)
            if len(row) == 0:
                continue
            values, distance = _interpolated(
                piece, points[row] - piece.translations[member], member, self._dimension
            )
            first = np.full(len(points), np.inf)
            np.minimum.at(first, row, distance)
            best = (distance <= first[row]) & (distance < nearest[row])
            result[row[best]] = values[best]
            nearest = np.minimum(nearest, first)
        return result, nearest


def _around(pieces: Sequence[_Piece], bodies: int) -> Array:
    """Bounding box of this rank's part of each body, (bodies, 2, 3); empty without a part."""
    result = np.full((bodies, 2, 3), np.inf) * np.array([[1.0], [-1.0]])
    for piece in pieces:
        np.minimum.at(result[:, 0], piece.bodies, piece.boxes[:, 0])
        np.maximum.at(result[:, 1], piece.bodies, piece.boxes[:, 1])
    return result


def _inside(boxes: Array, points: Array) -> NDArray[np.bool_]:
    """Whether each of points (n, 3) lies in each of boxes (…, 2, 3)."""
    inside = (points >= boxes[..., 0, :]) & (points <= boxes[..., 1, :])
    return np.asarray(inside.all(axis=-1))


def _interpolated(
    piece: _Piece, points: Array, member: NDArray[np.int64], dimension: int
) -> tuple[Array, Array]:
    """Values at points of the reference's frame, and their distance from its mesh."""
    places = locate(piece.reference, points, dimension)
    values = np.einsum("pn,pns->ps", places.shares, piece.values[places.nodes, member[:, None]])
    return values, places.distance
