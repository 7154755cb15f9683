"""A mesh that is a regular grid, cut into sub-boxes that may be congruent.

If the cells of a mesh are the equal boxes of a lattice, sub-boxes have equal stiffness matrices
unless the form varies. One factor then serves many, and Total FETI costs a fraction of multigrid
(`contact_app.model.decomposition` chooses the split as for scenes). Nodes of a sub-box are in the
order of the lattice, so that equal ones have equal matrices but for rounding. The cells of a
sub-box may belong to several ranks (`subdomains`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.decomposition import choose_split
from meshes import dolfinx_compat
from meshes.box import BoxShape

Array = NDArray[np.float64]

EQUAL = 1e-9
"""Distance of a node from its place in the lattice, over the spacing, that is round-off."""

ALIKE = 3
"""Sub-boxes that have to share a stiffness on the average; multigrid is cheaper than a factor for
nearly each of them."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A cut of a regular mesh.

    Attributes
    ----------
    of_cell : (cells,)
        Sub-box of each cell of this rank.
    lattice : (nodes,)
        Number of each node of the space in the lattice, x fastest.
    cells : (sub-boxes, d)
        Cells along each axis of each sub-box of all ranks.
    degree
        Of the space.
    """

    of_cell: NDArray[np.int64]
    lattice: NDArray[np.int64]
    cells: NDArray[np.int64]
    degree: int

    @property
    def count(self) -> int:
        """Sub-boxes of all ranks."""
        return len(self.cells)


def grid_of(space: Any) -> Grid | None:
    """The cut of the mesh of a space; None if it is not a regular grid to be cut (collective)."""
    mesh, d = space.mesh, space.mesh.topology.dim
    kind = str(mesh.topology.cell_name())
    if kind not in ("quadrilateral", "hexahedron"):
        return None
    degree = dolfinx_compat.lagrange_degree(space) or 1
    points = space.tabulate_dof_coordinates()[:, :d]
    nodes = dolfinx_compat.dof_nodes(space)[: mesh.topology.index_map(d).size_local]
    lower, upper, counts = _extent(mesh.comm, points, nodes)
    cells = mesh.topology.index_map(d).size_global
    if counts.prod() != cells or space.dofmap.index_map.size_global != (degree * counts + 1).prod():
        return None
    place = (points - lower) / (upper - lower) * (counts * degree)
    lattice = np.rint(place).astype(np.int64)
    regular = np.abs(place - lattice).max(initial=0.0) <= degree * EQUAL
    regular = regular and bool((np.ptp(lattice[nodes], axis=1) == degree).all())
    if not mesh.comm.allreduce(regular, op=MPI.LAND):
        return None
    box = BoxShape(tuple(lower), tuple(upper), tuple(map(int, counts)), kind, degree)
    split = choose_split(box)
    if np.prod(split) > 1:
        split = choose_split(box, mesh.comm.size)
    if len(split) != d or np.prod(split) < ALIKE:
        return None
    first = lattice[nodes].min(axis=1) // degree
    sub_box, sides = np.zeros(len(nodes), np.int64), []
    for axis in range(d):
        ends = np.linspace(0, counts[axis], split[axis] + 1).round().astype(np.int64)
        sub_box = sub_box * split[axis] + np.searchsorted(ends, first[:, axis], side="right") - 1
        sides.append(np.diff(ends))
    strides = np.cumprod([1, *(degree * counts[:-1] + 1)])
    along = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, d)
    return Grid(sub_box, lattice @ strides, along, degree)


def _extent(comm: MPI.Intracomm, points: Array, nodes: NDArray) -> tuple[Array, Array, NDArray]:
    """Corners (d,) of the box about a mesh, and cells along its axes (d,) (collective).

    Cells are counted by the first cell of a rank; zero where that is flat along an axis.
    """
    lower = np.min(comm.allgather(points.min(axis=0, initial=np.inf)), axis=0)
    upper = np.max(comm.allgather(points.max(axis=0, initial=-np.inf)), axis=0)
    cell = np.ptp(points[nodes[0]], axis=0) if len(nodes) else np.zeros(points.shape[1])
    spacing = np.max(comm.allgather(cell), axis=0)
    counts = np.rint(np.divide(upper - lower, spacing, where=spacing > 0.0, out=0.0 * spacing))
    return lower, upper, counts.astype(np.int64)
