"""Load vectors: tractions, pressures and body forces of a scene on its subdomains."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import boundary_facets, refuse_without_facet
from contact_app.model.geometry import Geometry
from contact_app.model.total_loads import LinearTraction
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyForce, Pressure, Temperature, TotalLoad, Traction
from contact_app.scene.scene import Scene
from meshes import Subdomain
from meshes.arrays import Array

FacetLoad = Traction | Pressure


@dataclass(frozen=True)
class Loads:
    """The loads of a scene, and whether it is plane."""

    on_facets: tuple[FacetLoad, ...]
    forces: tuple[BodyForce, ...]
    """Loads with a given density, on facets of boundaries and on bodies."""
    totals: tuple[TotalLoad, ...]
    """Forces and moments on boundaries."""
    temperatures: tuple[Temperature, ...]
    """Rises of temperature of bodies."""
    plane: str | None
    """None in space."""

    @classmethod
    def of(cls, scene: Scene) -> "Loads":
        """The loads of a scene."""
        return cls(
            (*scene.tractions, *scene.pressures), scene.forces, scene.total_loads,
            scene.temperatures, scene.plane,
        )  # fmt: skip


def load_vectors(
    geometry: Geometry,
    loads: Loads,
    elements: dict[int, Element],
    linear: Sequence[LinearTraction] = (),
) -> list[Array | None]:
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
    bodies = geometry.bodies
    has_facets = np.zeros(len(loads.on_facets), bool)
    cache: dict[Hashable, Array] = {}
    vectors = []
    for s in geometry.partition.subdomains:
        for i, load in enumerate(loads.on_facets):
            has_facets[i] |= bool(len(_facets(bodies[s.body], s, load)))
        element = elements[id(s.reference)]
        vectors.append(subdomain_load(bodies[s.body], s, element, loads, linear, cache))
    has_facets = geometry.comm.allreduce(has_facets.astype(int)) > 0
    for load, some in zip(loads.on_facets, has_facets, strict=True):
        if not some:
            refuse_without_facet(geometry.at(load.source), bodies[load.body], load.boundary)
    return vectors


def subdomain_load(
    body: Body,
    s: Subdomain,
    element: Element,
    loads: Loads,
    linear: Sequence[LinearTraction] = (),
    cache: dict[Hashable, Array] | None = None,
) -> Array | None:
    """Load vector of a subdomain; None without loads.

    Parameters
    ----------
    cache
        Known loads of congruent subdomains; new ones are added.
    """
    cache, parts = {} if cache is None else cache, []

    def reused(key: Hashable, make: Callable[[], Array]) -> Array:
        if key not in cache:
            cache[key] = make()
        return cache[key]

    for i, load in enumerate(loads.on_facets):
        rows = _facets(body, s, load)
        if len(rows):
            key: Hashable = (id(s.reference), i, rows.tobytes())
            parts.append(reused(key, partial(_on_facets, element, rows, load)))
    for traction in linear:
        if traction.body == s.body:
            rows = boundary_facets(s, body, traction.boundary)
            if len(rows):
                values = traction.at(s.points(), element.dimension)
                parts.append(element.linear_traction(rows, values))
    for i, force in enumerate(loads.forces):
        if force.body == s.body:
            key = (id(s.reference), "force", i)
            parts.append(reused(key, partial(element.body_force, np.array(force.vector))))
    return np.sum(parts, axis=0) if parts else None


def _facets(body: Body, s: Subdomain, load: FacetLoad) -> NDArray[np.int32]:
    """Facets of a subdomain of a body on which a load acts."""
    if load.body != s.body:
        return np.zeros(0, np.int32)
    return boundary_facets(s, body, load.boundary)


def _on_facets(element: Element, rows: NDArray[np.int32], load: FacetLoad) -> Array:
    if isinstance(load, Traction):
        return element.traction(rows, np.array(load.vector))
    return element.pressure(rows, load.value)
