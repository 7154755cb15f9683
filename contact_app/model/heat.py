"""Heat: temperatures at the nodes of subdomains, and the loads by which they expand bodies.

A body with the temperature T above its stress-free temperature has σ = C (ε(u) - α T I), so that

    a(u, v) = l(v) + ∫ β T div v dx,    β = (3 λ + 2 μ) α    (E α/(1 - ν) in plane stress).

The load is in equilibrium with itself. Stresses use T interpolated between the nodes of the
displacement, which is exact for polynomials of its degree.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError
from contact_app.model.assembly import Element
from contact_app.scene.scene import Scene
from meshes import Partition

Array = NDArray[np.float64]


def node_temperatures(scene: Scene, partition: Partition) -> list[Array | None]:
    """Temperature at the nodes (nodes,) of each subdomain of this rank; None without heat.

    Raises
    ------
    ConfigurationError
        An expression has no value at a node; raised on the rank of the node.
    """
    heated = {item.body for item in scene.temperatures}
    return [
        _temperature(scene, s.body, s.points()) if s.body in heated else None
        for s in partition.subdomains
    ]


def _temperature(scene: Scene, body: int, points: Array) -> Array:
    """Sum of the rises of a body at points (n, 3), (n,)."""
    total = np.zeros(len(points))
    for item in scene.temperatures:
        if item.body != body:
            continue
        rise = item.rise(points)
        wrong = ~np.isfinite(rise)
        if wrong.any():
            place = ", ".join(f"{x:g}" for x in points[np.argmax(wrong)][: scene.dimension])
            raise ConfigurationError(
                f"{scene.at(item.source)}.temperature: `{item.rise.text}` has no finite value "
                f"at ({place}), a point of {scene.bodies[body].name}"
            )
        total += rise
    return total


def thermal_loads(
    scene: Scene,
    partition: Partition,
    elements: dict[int, Element],
    temperatures: Sequence[Array | None],
) -> list[Array | None]:
    """Load vector (unknowns,) of the heat of each subdomain of this rank, None without heat.

    Raises
    ------
    ConfigurationError
        As in `node_temperatures`, for points between nodes.
    """
    uniform: dict[tuple[int, int], Array] = {}
    loads: list[Array | None] = []
    for s, temperature in zip(partition.subdomains, temperatures, strict=True):
        if temperature is None:
            loads.append(None)
            continue
        element, materials = elements[id(s.reference)], scene.bodies[s.body].materials
        even = all(item.rise.constant for item in scene.temperatures if item.body == s.body)
        key = (id(s.reference), s.body)
        if not even or key not in uniform:
            load = element.thermal_load(
                materials, scene.plane, partial(_moved, scene, s.body, s.translation)
            )
            uniform[key] = load
        loads.append(uniform[key])
    return loads


def _moved(scene: Scene, body: int, translation: Array, points: Array) -> Array:
    return _temperature(scene, body, points + translation)
