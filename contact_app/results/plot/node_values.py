"""Values at nodes for pictures: smooth if stresses at nodes were written.

Where materials of one body meet, a node has a stress for each. Pictures then have a copy of all
nodes for each material: copy k of node i is node k n + i of n, and the cells and sides of material
k go with copy k.
"""

import numpy as np

from contact_app.results.plot.stored import Stored
from meshes.arrays import Array, Ints

UNIFORM = 1e-4
"""Relative variation below which a field counts as constant."""

OF_MATERIAL = "_material_"
"""Prefix of a material's number in the name of its field."""


def smooth_name(stored: Stored, name: str) -> str:
    """The field at nodes of a stress in cells, if the result holds it; else the name itself."""
    return f"nodal_{name}" if f"nodal_{name}" in stored.point_data else name


def copies(stored: Stored) -> int:
    """Number of copies of all nodes: one for each material with a separate field, at least 1."""
    numbers = [
        int(name.rpartition(OF_MATERIAL)[2]) for name in stored.point_data if OF_MATERIAL in name
    ]
    return 1 + max(numbers, default=0) if "material" in stored.cell_data else 1


def shifts(stored: Stored, rows: Ints) -> Ints:
    """The offset that is added to nodes of sides that belong to cells, (sides,)."""
    if copies(stored) == 1:
        return np.zeros(len(rows), np.int64)
    return len(stored.points) * stored.cell_data["material"][rows].astype(np.int64)


def node_values(stored: Stored, name: str) -> Array:
    """A field at all copies of nodes, (copies · nodes, …)."""
    fields = (
        stored.point_data.get(f"{name}{OF_MATERIAL}{k}", stored.point_data[name])
        for k in range(copies(stored))
    )
    return np.concatenate(list(fields))


def limits(values: Array) -> tuple[float, float]:
    """Range of the colours; for a constant field from 0, so that round-off is not shown."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if high - low > UNIFORM * max(abs(low), abs(high)):
        return low, high
    return min(low, 0.0), max(high, 0.0) or 1.0
