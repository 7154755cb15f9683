"""Hints on obstacles farther from a body than its length: often a mistake in units of length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Contact


def far_obstacle_hints(
    bodies: Sequence[Body],
    contacts: Sequence[Contact],
    gaps: NDArray[np.float64],
    sources: NDArray[np.integer],
    comm: MPI.Comm,
) -> list[str]:
    """A sentence for each contact whose obstacle is out of reach.

    Parameters
    ----------
    gaps, sources : (rows,)
        Gaps of this rank's contact rows (lengths), and the contact of each row.
    """
    hints = []
    for number, contact in enumerate(contacts):
        gaps_of_contact = gaps[sources == number]
        smallest = comm.allreduce(float(gaps_of_contact.min(initial=np.inf)), op=MPI.MIN)
        mesh = bodies[contact.body].mesh
        length = float(np.linalg.norm(np.subtract(mesh.upper, mesh.lower)))
        if np.isfinite(smallest) and smallest > length:
            hints.append(
                f"{contact.source}: the obstacle is {smallest:.3g} away from "
                f"{bodies[contact.body].name}, which is {length:.3g} long in all: "
                "are both in the same unit of length?"
            )
    return hints
