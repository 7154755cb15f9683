"""A mesh that is a regular grid, cut into sub-boxes that may be congruent.

Where the cells of a mesh are the equal boxes of a lattice, sub-boxes of it have equal stiffness
matrices unless the form varies. One factor then serves many, and Total FETI costs a fraction of
multigrid (`contact_app.model.decomposition` chooses the split as for scenes). Nodes of a part are
in the order of the lattice, so that equal parts have equal matrices but for rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.decomposition import choose_split
from meshes import dolfinx_compat
from meshes.box import BoxShape

EQUAL = 1e-9
"""Distance of a node from its place in the lattice, over the spacing, that is round-off."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A cut of a regular mesh.

    Attributes
    ----------
    of_cell : (cells,)
        Sub-box of each cell.
    order : (nodes,)
        Place of each node of the space in the lattice, x fastest.
    """

    of_cell: NDArray[np.int64]
    order: NDArray[np.int64]


def grid_of(space: Any) -> Grid | None:
    """The cut of the mesh of a space on one rank; None where it is no regular grid of several."""
    mesh = space.mesh
    kind = str(mesh.topology.cell_name())
    if mesh.comm.size > 1 or kind not in ("quadrilateral", "hexahedron"):
        return None
    d, degree = mesh.topology.dim, dolfinx_compat.lagrange_degree(space) or 1
    points = space.tabulate_dof_coordinates()[:, :d]
    lower, upper = points.min(axis=0), points.max(axis=0)
    nodes = dolfinx_compat.dof_nodes(space)[: mesh.topology.index_map(d).size_local]
    spacing = np.ptp(points[nodes[0]], axis=0)
    counts = np.rint((upper - lower) / np.where(spacing > 0.0, spacing, 1.0)).astype(np.int64)
    if spacing.min() <= 0.0 or counts.prod() != len(nodes):
        return None
    spacing = (upper - lower) / counts
    place = (points - lower) / spacing * degree
    lattice = np.rint(place).astype(np.int64)
    if (
        np.abs(place - lattice).max() > degree * EQUAL
        or len(points) != (degree * counts + 1).prod()
    ):
        return None
    if (np.ptp(lattice[nodes], axis=1) != degree).any():
        return None
    box = BoxShape(tuple(lower), tuple(upper), tuple(map(int, counts)), kind, degree)
    split = choose_split(box)
    if len(split) != d or np.prod(split) == 1:
        return None
    first = lattice[nodes].min(axis=1) // degree
    sub_box = np.zeros(len(nodes), np.int64)
    for axis in range(d):
        ends = np.linspace(0, counts[axis], split[axis] + 1).round().astype(np.int64)
        sub_box = sub_box * split[axis] + np.searchsorted(ends, first[:, axis], side="right") - 1
    order = np.empty(len(points), np.int64)
    order[np.lexsort(lattice.T)] = np.arange(len(points))
    return Grid(sub_box, order)
