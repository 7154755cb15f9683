"""Hints on obstacles that are probably not meant so: out of reach, or turned round.

An obstacle farther from a body than the body is long is often a mistake in units of length. A
boundary and its obstacle with outward normals of nearly the same direction never touch from
outside: a plane is turned round, or the boundary is that on the far side.
"""

import numpy as np
from mpi4py import MPI

from contact_app.model.geometry import Geometry
from meshes.arrays import Array
from solver.problem.constraints.conditions import ContactRows

SAME_WAY = 0.5
"""Cosine of the angle between the normals of a boundary and of its obstacle, at every facet, from
which on the boundary faces away: sides that touch have normals of opposite directions."""


def obstacle_hints(geometry: Geometry, rows: ContactRows) -> list[str]:
    """Sentences on contacts whose obstacle is out of reach, or turned round (collective)."""
    away = [f"{source}: {facing_away(False)}" for source in turned_round(geometry)]
    return far_obstacle_hints(geometry, rows) + away


def faces_away(boundary: Array, obstacle: Array) -> bool:
    """Whether a boundary is on the far side of its body, or its obstacle is turned round.

    Parameters
    ----------
    boundary, obstacle : (facets, d)
        Outward unit normals of the facets, and of the obstacle there.
    """
    return len(boundary) > 0 and np.einsum("fi,fi->f", boundary, obstacle).min() >= SAME_WAY


def facing_away(pulls: bool) -> str:
    """The sentence on a boundary that faces away.

    Parameters
    ----------
    pulls
        Whether the contact carries a force.
    """
    then = "the obstacle pulls the body" if pulls else "nothing touches"
    return (
        "the boundary faces away from the obstacle: both have outward normals of nearly the same "
        f"direction, and {then}; the normal of a plane points out of the obstacle, towards "
        "the body, and a cavity is `hollow`"
    )


def turned_round(geometry: Geometry) -> list[str]:
    """Contacts whose boundary faces away from all shapes of its obstacle (collective)."""
    away: dict[str, bool] = {}
    for contact in geometry.contacts:
        if away.get(contact.source, True):
            surface = geometry.boundary_surface(contact.body, contact.boundary)
            away[contact.source] = surface is not None and faces_away(
                surface.normals, contact.obstacle.gap_and_normal(surface.centres)[1]
            )
    return [source for source, is_away in away.items() if is_away]


def far_obstacle_hints(geometry: Geometry, rows: ContactRows) -> list[str]:
    """A sentence for each contact whose obstacle is out of reach (collective)."""
    hints = []
    for number, contact in enumerate(geometry.contacts):
        gaps = rows.gaps[rows.sources == number]
        smallest = geometry.comm.allreduce(float(gaps.min(initial=np.inf)), op=MPI.MIN)
        body = geometry.bodies[contact.body]
        length = float(np.linalg.norm(np.subtract(body.mesh.upper, body.mesh.lower)))
        if np.isfinite(smallest) and smallest > length:
            hints.append(
                f"{contact.source}: the obstacle is {smallest:.3g} away from "
                f"{body.name}, which is {length:.3g} long in all: "
                "are both in the same unit of length?"
            )
    return hints
