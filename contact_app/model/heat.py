"""Heat: temperatures at the nodes of subdomains, and the loads by which they expand bodies.

A body with the temperature T above its stress-free temperature has σ = C (ε(u) - α T I), so that

    a(u, v) = l(v) + ∫ β T div v dx,    β = (3 λ + 2 μ) α    (E α/(1 - ν) in plane stress).

The load is in equilibrium with itself. Stresses use T interpolated between the nodes of the
displacement, which is exact for polynomials of its degree.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from contact_app.errors import ConfigurationError
from contact_app.model.assembly import Element
from contact_app.model.geometry import Geometry
from contact_app.scene.conditions import Temperature
from meshes.arrays import Array


def node_temperatures(
    geometry: Geometry, temperatures: Sequence[Temperature]
) -> list[Array | None]:
    """Temperature at the nodes (nodes,) of each subdomain of this rank; None without heat.

    Raises
    ------
    ConfigurationError
        An expression has no value at a node; raised on the rank of the node.
    """
    rises = _rises_of_bodies(geometry, temperatures)
    return [
        _temperature(geometry, rises[s.body], s.points()) if rises[s.body] else None
        for s in geometry.partition.subdomains
    ]


def _rises_of_bodies(
    geometry: Geometry, temperatures: Sequence[Temperature]
) -> list[list[Temperature]]:
    """The rises of each body."""
    count = range(len(geometry.bodies))
    return [[item for item in temperatures if item.body == body] for body in count]


def _temperature(geometry: Geometry, rises: Sequence[Temperature], points: Array) -> Array:
    """Sum of the rises of a body at points (n, 3), (n,)."""
    total = np.zeros(len(points))
    for item in rises:
        rise = item.rise(points)
        wrong = ~np.isfinite(rise)
        if wrong.any():
            place = ", ".join(f"{x:g}" for x in points[np.argmax(wrong)][: geometry.dimension])
            raise ConfigurationError(
                f"{geometry.at(item.source)}.temperature: `{item.rise.text}` has no finite value "
                f"at ({place}), a point of {geometry.bodies[item.body].name}"
            )
        total += rise
    return total


def thermal_loads(
    geometry: Geometry,
    elements: dict[int, Element],
    plane: str | None,
    temperatures: Sequence[Temperature],
) -> list[Array | None]:
    """Load vector (unknowns,) of the heat of each subdomain of this rank, None without heat.

    Raises
    ------
    ConfigurationError
        As in `node_temperatures`, for points between nodes.
    """
    uniform: dict[tuple[int, int], Array] = {}
    loads: list[Array | None] = []
    rises_of_bodies = _rises_of_bodies(geometry, temperatures)
    for s in geometry.partition.subdomains:
        rises = rises_of_bodies[s.body]
        if not rises:
            loads.append(None)
            continue
        element, materials = elements[id(s.reference)], geometry.bodies[s.body].materials
        even = all(item.rise.constant for item in rises)
        key = (id(s.reference), s.body)
        if not even or key not in uniform:
            load = element.thermal_load(
                materials, plane, partial(_moved, geometry, rises, s.translation)
            )
            uniform[key] = load
        loads.append(uniform[key])
    return loads


def _moved(
    geometry: Geometry, rises: Sequence[Temperature], translation: Array, points: Array
) -> Array:
    return _temperature(geometry, rises, points + translation)
