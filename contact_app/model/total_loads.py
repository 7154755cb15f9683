"""Total force and moment on a boundary as a traction with this resultant.

On a boundary of area A and centroid c the traction is linear in the position,

    t(x) = F / A + θ × (x - c),   J θ = M_c,   J = ∫ |r|² I - r rᵀ ds,  r = x - c,

with the moment M_c = M + (p - c) × F of a force F and a moment M at a point p. Its resultant is F
and M_c for any shape of boundary, and it is the traction of least ∫ |t|² ds with that resultant:
the boundary stays free to deform (a distributing coupling). In the plane, moments and θ are their
component out of the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import facets_of, refuse_without_facet
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import TotalLoad
from contact_app.scene.scene import Scene
from meshes import Partition

Array = NDArray[np.float64]

THIN = 1e-12
"""Smallest eigenvalue of J over the largest at which a boundary takes a moment about every axis."""


@dataclass(frozen=True, eq=False)
class LinearTraction:
    """t(x) = uniform + turn × (x - centre) on a boundary; all three are (3,).

    Attributes
    ----------
    area
        Area of the boundary; in 2D its length.
    """

    body: int
    boundary: str
    source: str
    uniform: Array
    turn: Array
    centre: Array
    area: float

    def at(self, points: Array, dimension: int) -> Array:
        """Tractions (…, dimension) at points (…, 3)."""
        turned = np.cross(np.broadcast_to(self.turn, points.shape), points - self.centre)
        return np.asarray((self.uniform + turned)[..., :dimension])


def linear_tractions(
    scene: Scene, partition: Partition, elements: dict[int, Element]
) -> tuple[LinearTraction, ...]:
    """The traction of each total force and moment of a scene (collective).

    Raises
    ------
    ConfigurationError
        No facet lies on the boundary.
    """
    return tuple(_traction(scene, partition, elements, load) for load in scene.total_loads)


def _traction(
    scene: Scene, partition: Partition, elements: dict[int, Element], load: TotalLoad
) -> LinearTraction:
    """The linear traction with the force and moment of a load about the boundary's centroid."""
    area, centre, second = moments_of_boundary(
        scene.bodies, partition, elements, load.body, load.boundary
    )
    if area == 0.0:
        refuse_without_facet(scene.at(load.source), scene.bodies[load.body], load.boundary)
    force = np.array([*load.force, *(0.0,) * (3 - len(load.force))])
    arm = np.zeros(3) if load.at is None else np.array(load.at) - centre
    moment = np.array(load.moment) + np.cross(arm, force)
    J = np.trace(second) * np.eye(3) - second
    turn = np.zeros(3)
    if moment.any():
        sizes, axes = np.linalg.eigh(J)
        works = sizes > THIN * sizes.max()
        turn = axes[:, works] @ ((axes[:, works].T @ moment) / sizes[works])
    return LinearTraction(load.body, load.boundary, load.source, force / area, turn, centre, area)


def moments_of_boundary(
    bodies: Sequence[Body],
    partition: Partition,
    elements: dict[int, Element],
    body: int,
    boundary: str,
) -> tuple[float, Array, Array]:
    """Area, centroid (3,) and ∫ r rᵀ ds (3, 3) about it; zeros without a facet (collective)."""
    mesh, d = bodies[body].mesh, partition.dimension
    middle = np.zeros(3)  # origin near the boundary: sums lose no digits
    middle[:d] = 0.5 * (np.array(mesh.lower) + np.array(mesh.upper))
    sums = np.zeros(13)
    for s, rows in zip(
        partition.subdomains, facets_of(bodies, partition, body, boundary), strict=True
    ):
        if len(rows):
            points = s.points() - middle
            sums += _moments(elements[id(s.reference)], rows, points, d)
    partition.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    area, first, second = sums[0], sums[1:4], sums[4:].reshape(3, 3)
    if area == 0.0:
        return 0.0, middle, second
    away = first / area
    return float(area), middle + away, second - area * np.outer(away, away)


def _moments(element: Element, rows: NDArray[np.int32], points: Array, d: int) -> Array:
    """∫ ds, ∫ x ds and ∫ x xᵀ ds over facets, with nodes at points (nodes, 3)."""
    one = element.linear_traction(rows, np.ones((len(points), d))).reshape(-1, d)[:, 0]
    weighted = np.zeros((len(points), 3))
    weighted[:, :d] = element.linear_traction(rows, points[:, :d]).reshape(-1, d)
    return np.concatenate([[one.sum()], one @ points, (weighted.T @ points).ravel()])
