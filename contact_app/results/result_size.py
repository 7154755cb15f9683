"""The size of the files of fields."""

from __future__ import annotations

from collections.abc import Sequence

from contact_app.results.fields import (
    CELL_FIELDS,
    FRICTION_FIELDS,
    NODAL_FIELDS,
    POINT_FIELDS,
)
from contact_app.results.xdmf import CELL_TYPES, cell_type_name, grid_bytes
from contact_app.scene.bodies import Body
from contact_app.scene.scene import OutputOptions, Scene

COMPONENTS = {
    "displacement": 3, "friction_traction": 3, "slip": 3, "stress": 9, "nodal_stress": 9,
}  # fmt: skip
"""Number of written components of fields that are not scalars."""


def components(name: str) -> int:
    """Number of written components of a field."""
    for base in NODAL_FIELDS:
        name = base if name.startswith(base) else name
    return COMPONENTS.get(name, 1)


def wanted_fields(scene: Scene) -> list[str]:
    """The requested fields that a scene can have."""
    left_out = () if scene.has_friction else FRICTION_FIELDS
    return [name for name in scene.output.fields if name not in left_out]


def file_names(output: OutputOptions, name: str = "solution") -> list[str]:
    """The requested files of fields."""
    return [f"{name}.{suffix}" for suffix in ("xdmf", "vtu") if getattr(output, suffix)]


def result_bytes(scene: Scene, nodes: int, cells: int, alone: int | None = None) -> int:
    """Size of ``solution.h5``, a little too large where bodies have different cells.

    Parameters
    ----------
    nodes, cells
        Of all bodies, mirror images included.
    alone
        Contacts with a pressure field of their own; all where there are several, unless given.
    """
    return grid_bytes(nodes, cells, _vertices(scene.bodies), *_components(scene, alone))


def vtu_bytes(nodes: int, cells: int, vertices: int, at_nodes: int, at_cells: int) -> int:
    """Size of ``solution.vtu``, about; parameters as of `xdmf.grid_bytes`."""
    return 4096 + nodes * 8 * (3 + at_nodes) + cells * (8 * at_cells + 4 * vertices + 9)


def all_bytes(scene: Scene, nodes: int, cells: int) -> int:
    """Size of all files of fields."""
    room = _vertices(scene.bodies), *_components(scene, None)
    sizes = {"xdmf": grid_bytes, "vtu": vtu_bytes}
    return sum(
        size(nodes, cells, *room) for name, size in sizes.items() if getattr(scene.output, name)
    )


def _vertices(bodies: Sequence[Body]) -> int:
    return max(CELL_TYPES[cell_type_name(b.mesh.cell, b.degree)].vertices for b in bodies)


def _components(scene: Scene, alone: int | None) -> tuple[int, int]:
    """Components of all fields at nodes and in cells."""
    wanted = wanted_fields(scene)
    at_nodes = sum(components(name) for name in wanted if name in POINT_FIELDS)
    materials = max(len(body.materials) for body in scene.bodies)
    sides = 1 if materials == 1 else 1 + materials
    at_nodes += sides * sum(components(name) for name in wanted if name in NODAL_FIELDS)
    if alone is None:
        alone = len(scene.touching) if len(scene.touching) > 1 else 0
    at_nodes += alone if "contact_pressure" in wanted else 0
    return at_nodes, sum(components(name) for name in wanted if name in CELL_FIELDS)
