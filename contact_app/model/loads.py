"""Load vectors: tractions, pressures and body forces of a scene on its subdomains."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import boundary_facets, refuse_without_facet
from contact_app.model.total_loads import LinearTraction, load_of
from contact_app.scene.conditions import Pressure, Traction
from contact_app.scene.scene import Scene
from meshes import Partition


def load_vectors(
    scene: Scene,
    partition: Partition,
    elements: dict[int, Element],
    linear: Sequence[LinearTraction] = (),
) -> list[NDArray[np.float64] | None]:
    """Load vector of each subdomain of this rank, None where nothing acts.

    Parameters
    ----------
    linear
        The tractions of total forces and moments.
    """
    facet_loads: tuple[Traction | Pressure, ...] = (*scene.tractions, *scene.pressures)
    found = np.zeros(len(facet_loads), bool)
    cache: dict[Hashable, NDArray[np.float64]] = {}
    loads: list[NDArray[np.float64] | None] = []
    for s in partition.subdomains:
        element = elements[id(s.reference)]
        parts = []
        for i, load in enumerate(facet_loads):
            if load.body != s.body:
                continue
            rows = boundary_facets(s, scene.bodies[s.body], load.boundary)
            if len(rows) == 0:
                continue
            found[i] = True
            key: Hashable = (id(s.reference), i, rows.tobytes())
            if key not in cache:
                if i < len(scene.tractions):
                    cache[key] = element.traction(rows, np.array(scene.tractions[i].vector))
                else:
                    pressure = scene.pressures[i - len(scene.tractions)].value
                    cache[key] = element.pressure(rows, pressure)
            parts.append(cache[key])
        for traction in linear:
            if traction.body == s.body:
                rows = boundary_facets(s, scene.bodies[s.body], traction.boundary)
                if len(rows):
                    parts.append(load_of(element, rows, s.points(), traction))
        for i, force in enumerate(scene.forces):
            if force.body == s.body:
                key = (id(s.reference), "force", i)
                if key not in cache:
                    cache[key] = element.body_force(np.array(force.vector))
                parts.append(cache[key])
        loads.append(np.sum(parts, axis=0) if parts else None)
    found = partition.comm.allreduce(found.astype(int)) > 0
    for load, some in zip(facet_loads, found, strict=True):
        if not some:
            refuse_without_facet(scene, load)
    return loads
