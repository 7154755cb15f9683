"""Load vectors: tractions, pressures and body forces of a scene on its subdomains."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import boundary_facets, refuse_without_facet
from contact_app.model.total_loads import LinearTraction
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Pressure, Traction
from contact_app.scene.scene import Scene
from meshes import Partition, Subdomain

FacetLoad = Traction | Pressure


def load_vectors(
    scene: Scene,
    partition: Partition,
    elements: dict[int, Element],
    linear: Sequence[LinearTraction] = (),
) -> list[NDArray[np.float64] | None]:
    """Load vector of each subdomain of this rank; None without loads (collective).

    Parameters
    ----------
    linear
        The tractions of total forces and moments.

    Raises
    ------
    ConfigurationError
        A load has no facet.
    """
    facet_loads: tuple[FacetLoad, ...] = (*scene.tractions, *scene.pressures)
    has_facets = np.zeros(len(facet_loads), bool)
    cache: dict[Hashable, NDArray[np.float64]] = {}
    loads = []
    for s in partition.subdomains:
        for i, load in enumerate(facet_loads):
            has_facets[i] |= bool(len(_facets(scene.bodies, s, load)))
        loads.append(subdomain_load(scene, s, elements[id(s.reference)], linear, cache))
    has_facets = partition.comm.allreduce(has_facets.astype(int)) > 0
    for load, some in zip(facet_loads, has_facets, strict=True):
        if not some:
            refuse_without_facet(scene.at(load.source), scene.bodies[load.body], load.boundary)
    return loads


def subdomain_load(
    scene: Scene,
    s: Subdomain,
    element: Element,
    linear: Sequence[LinearTraction] = (),
    cache: dict[Hashable, NDArray[np.float64]] | None = None,
) -> NDArray[np.float64] | None:
    """Load vector of a subdomain; None without loads.

    Parameters
    ----------
    cache
        Known loads of congruent subdomains; new ones are added.
    """
    cache, parts = {} if cache is None else cache, []

    def reused(key: Hashable, make: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        if key not in cache:
            cache[key] = make()
        return cache[key]

    facet_loads: tuple[FacetLoad, ...] = (*scene.tractions, *scene.pressures)
    for i, load in enumerate(facet_loads):
        rows = _facets(scene.bodies, s, load)
        if len(rows):
            key: Hashable = (id(s.reference), i, rows.tobytes())
            parts.append(reused(key, partial(_on_facets, element, rows, load)))
    for traction in linear:
        if traction.body == s.body:
            rows = boundary_facets(s, scene.bodies[s.body], traction.boundary)
            if len(rows):
                values = traction.at(s.points(), element.dimension)
                parts.append(element.linear_traction(rows, values))
    for i, force in enumerate(scene.forces):
        if force.body == s.body:
            key = (id(s.reference), "force", i)
            parts.append(reused(key, partial(element.body_force, np.array(force.vector))))
    return np.sum(parts, axis=0) if parts else None


def _facets(bodies: Sequence[Body], s: Subdomain, load: FacetLoad) -> NDArray[np.int32]:
    """Facets of a subdomain on which a load acts."""
    if load.body != s.body:
        return np.zeros(0, np.int32)
    return boundary_facets(s, bodies[s.body], load.boundary)


def _on_facets(element: Element, rows: NDArray[np.int32], load: FacetLoad) -> NDArray[np.float64]:
    if isinstance(load, Traction):
        return element.traction(rows, np.array(load.vector))
    return element.pressure(rows, load.value)
