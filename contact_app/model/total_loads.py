"""Total force and moment on a boundary as a traction with this resultant.

On a boundary of area A and centroid c the traction is linear in the position,

    t(x) = F / A + θ × (x - c),   J θ = M_c,   J = ∫ |r|² I - r rᵀ ds,  r = x - c,

with the moment M_c = M + (p - c) × F of a force F and a moment M at a point p. Its resultant is F
and M_c for any shape of boundary, and it is the traction of least ∫ |t|² ds with that resultant:
the boundary stays free to deform (a distributing coupling). In the plane, moments and θ are their
component out of the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import refuse_without_facet
from contact_app.model.equilibrium import body_frame
from contact_app.model.geometry import Geometry
from contact_app.scene.conditions import TotalLoad
from meshes.arrays import Array

THIN = 1e-12
"""Smallest eigenvalue of J over the largest at which a boundary takes a moment about every axis."""


@dataclass(frozen=True, eq=False)
class LinearTraction:
    """t(x) = uniform + turn × (x - centre) on a boundary; all three are (3,)."""

    body: int
    boundary: str
    source: str
    uniform: Array
    turn: Array
    centre: Array
    area: float
    """Area of the boundary; in 2D its length."""

    def at(self, points: Array, dimension: int) -> Array:
        """Tractions (…, dimension) at points (…, 3)."""
        turned = np.cross(np.broadcast_to(self.turn, points.shape), points - self.centre)
        return np.asarray((self.uniform + turned)[..., :dimension])


def linear_tractions(
    geometry: Geometry, elements: dict[int, Element], loads: Sequence[TotalLoad]
) -> tuple[LinearTraction, ...]:
    """The traction of each total force and moment (collective).

    Raises
    ------
    ConfigurationError
        No facet lies on the boundary.
    """
    return tuple(_traction(geometry, elements, load) for load in loads)


def _traction(geometry: Geometry, elements: dict[int, Element], load: TotalLoad) -> LinearTraction:
    """The linear traction with the force and moment of a load about the boundary's centroid."""
    area, centre, second = _moments_of_boundary(geometry, elements, load)
    if area == 0.0:
        refuse_without_facet(geometry.at(load.source), geometry.bodies[load.body], load.boundary)
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


def _moments_of_boundary(
    geometry: Geometry, elements: dict[int, Element], load: TotalLoad
) -> tuple[float, Array, Array]:
    """Area, centroid (3,) and ∫ r rᵀ ds (3, 3) about it; zeros without a facet (collective)."""
    d, sums = geometry.dimension, np.zeros(13)
    middle = body_frame(geometry.bodies[load.body])[0]  # near the boundary: sums lose no digits
    chosen = geometry.facets_of(load.body, load.boundary)
    for s, rows in zip(geometry.partition.subdomains, chosen, strict=True):
        if len(rows):
            points = s.points() - middle
            sums += _moments(elements[id(s.reference)], rows, points, d)
    geometry.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
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
