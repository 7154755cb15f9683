"""The loaded area of a traction or pressure, compared with the area of its boundary.

A load acts on facets all of whose nodes are on the boundary. If an expression defines the boundary,
facets that straddle its edge carry no load, so the total force depends on the mesh.
"""

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.boundaries import boundary_facets, surface_facets
from contact_app.model.facets import moments, shapes_on_lattice
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Pressure, Traction
from meshes import Partition, Subdomain
from meshes.arrays import Array


def loaded_facets(
    bodies: Sequence[Body], partition: Partition, load: Traction | Pressure
) -> tuple[int, float]:
    """Number of facets that carry a load, and their area (collective)."""
    body = bodies[load.body]
    x = _points(partition, load, lambda s: boundary_facets(s, body, load.boundary))
    area = float(moments(x, partition.dimension).sum()) if len(x) else 0.0
    return partition.comm.allreduce(len(x)), partition.comm.allreduce(area)


def straddled_area(
    bodies: Sequence[Body], partition: Partition, load: Traction | Pressure
) -> float:
    """Area in which the boundary's expression holds on facets without the load (collective).

    Zero if the mesh defines the boundary. The area is sampled, with an error of some per cent of a
    facet.
    """
    body, total = bodies[load.body], 0.0
    expression = body.boundaries.get(load.boundary)
    if expression is None:
        return 0.0
    x = _points(partition, load, lambda s: surface_facets(s, body))
    if len(x):
        x = x[~expression(x.reshape(-1, 3)).reshape(x.shape[:2]).all(axis=1)]
        shapes = shapes_on_lattice(partition.dimension, x.shape[1], inside=True)
        inside = expression((shapes @ x).reshape(-1, 3))
        shares = inside.reshape(len(x), len(shapes)).mean(axis=1)
        areas = moments(x[shares > 0.0], partition.dimension).sum(axis=(1, 2))
        total = float(areas @ shares[shares > 0.0])
    return float(partition.comm.allreduce(total, op=MPI.SUM))


def _points(
    partition: Partition,
    load: Traction | Pressure,
    facets_of: Callable[[Subdomain], NDArray[np.int32]],
) -> Array:
    """Nodes of some facets of the loaded body's subdomains on this rank, (facets, nodes, 3).

    Areas and expressions are evaluated once on all of them: with 216 subdomains a call for each
    took a tenth of the CPU time of a solve.
    """
    parts = [
        s.points()[s.reference.facets[rows]]
        for s in partition.subdomains
        if s.body == load.body and len(rows := facets_of(s))
    ]
    return np.concatenate(parts) if parts else np.empty((0, 0, 3))
