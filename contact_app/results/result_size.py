"""How much room ``solution.h5`` takes."""

from __future__ import annotations

from contact_app.results.xdmf import CELL_TYPES, cell_type_name, grid_bytes
from contact_app.scene.scene import Scene

COMPONENTS = {"displacement": 3, "contact_pressure": 1, "gap": 1}
"""Components that are written of each field at nodes."""

CELL_COMPONENTS = {"stress": 9, "von_mises": 1, "body": 1, "material": 1}
"""The same of fields in cells."""


def result_bytes(scene: Scene, nodes: int, cells: int, alone: int | None = None) -> int:
    """Size of ``solution.h5``, a little too large where bodies have different cells.

    Parameters
    ----------
    nodes, cells
        Of all bodies, mirror images included.
    alone
        Contacts with a pressure field of their own; all where there are several, unless given.
    """
    wanted = scene.output.fields
    at_nodes = sum(count for name, count in COMPONENTS.items() if name in wanted)
    if alone is None:
        alone = len(scene.touching) if len(scene.touching) > 1 else 0
    at_nodes += alone if "contact_pressure" in wanted else 0
    at_cells = sum(count for name, count in CELL_COMPONENTS.items() if name in wanted)
    kinds = (CELL_TYPES[cell_type_name(b.mesh.cell, b.degree)] for b in scene.bodies)
    return grid_bytes(nodes, cells, max(kind.vertices for kind in kinds), at_nodes, at_cells)
