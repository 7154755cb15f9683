"""The size of the files of fields."""

from collections.abc import Sequence

from contact_app.results.fields import CELL_FIELDS, FRICTION_FIELDS, NODAL_FIELDS, POINT_FIELDS
from contact_app.results.xdmf import CELL_TYPES, cell_type_name, grid_bytes
from contact_app.scene.bodies import Body
from contact_app.scene.scene import OutputOptions

COMPONENTS = {
    "displacement": 3, "friction_traction": 3, "slip": 3, "stress": 9, "nodal_stress": 9,
}  # fmt: skip
"""Number of written components of fields that are not scalars."""


def components(name: str) -> int:
    """Number of written components of a field."""
    for base in NODAL_FIELDS:
        name = base if name.startswith(base) else name
    return COMPONENTS.get(name, 1)


def wanted_fields(output: OutputOptions, has_friction: bool) -> list[str]:
    """The requested fields that a scene can have."""
    left_out = () if has_friction else FRICTION_FIELDS
    return [name for name in output.fields if name not in left_out]


def file_names(output: OutputOptions, name: str = "solution") -> list[str]:
    """The requested files of fields."""
    return [f"{name}.{suffix}" for suffix in ("xdmf", "vtu") if getattr(output, suffix)]


def result_bytes(
    bodies: Sequence[Body], wanted: Sequence[str], alone: int, nodes: int, cells: int
) -> dict[str, int]:
    """Sizes of ``solution.h5`` and ``solution.vtu``, by the key of the output.

    They are a little too large where bodies have different cells.

    Parameters
    ----------
    wanted
        The written fields.
    alone
        Number of contacts with a pressure field of their own.
    nodes, cells
        Of all bodies, mirror images included.
    """
    vertices = max(CELL_TYPES[cell_type_name(b.mesh.cell, b.degree)].vertices for b in bodies)
    at_nodes = sum(components(name) for name in wanted if name in POINT_FIELDS)
    materials = max(len(body.materials) for body in bodies)
    sides = 1 if materials == 1 else 1 + materials
    at_nodes += sides * sum(components(name) for name in wanted if name in NODAL_FIELDS)
    at_nodes += alone if "contact_pressure" in wanted else 0
    at_cells = sum(components(name) for name in wanted if name in CELL_FIELDS)
    size = grid_bytes(nodes, cells, vertices, at_nodes, at_cells)
    return {"xdmf": size, "vtu": size * 4 // 3}  # in base64 four characters for three bytes
