"""Hints on obstacles farther from a body than its length: often a mistake in units of length."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from contact_app.model.geometry import Geometry
from solver.tfeti.constraints.conditions import ContactRows


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
