"""A mesh that is a regular grid, cut into sub-boxes that may be congruent.

If the cells of a mesh are the equal boxes of a lattice, sub-boxes have equal stiffness matrices
unless the form varies. One factor then serves many, and Total FETI costs a fraction of multigrid
(`contact_app.model.decomposition` chooses the split as for scenes). Nodes of a sub-box are in the
order of the lattice, so that equal ones have equal matrices but for rounding. The cells of a
sub-box may belong to several ranks (`subdomains`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.decomposition import choose_split
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.box import BoxShape
from meshes.connected import connected

EQUAL = 1e-9
"""Distance of a node from its place in the lattice, over the spacing, that is round-off."""

ALIKE = 3
"""Sub-boxes that have to share a stiffness on the average; multigrid is cheaper than a factor for
nearly each of them."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A cut of a regular mesh."""

    of_cell: Ints  # (cells,)
    """Sub-box of each cell of this rank."""
    lattice: Ints  # (nodes,)
    """Number of each node of the space in the lattice, x fastest."""
    cells: Ints  # (sub-boxes, d)
    """Cells along each axis of each sub-box of all ranks."""
    degree: int
    """Degree of the space."""
    bodies: Ints  # (sub-boxes,)
    """Body of each sub-box; the cells of one body are equal boxes."""

    @property
    def count(self) -> int:
        """Sub-boxes of all ranks."""
        return len(self.cells)


def grid_of(space: Any) -> Grid | None:
    """The cut of the mesh of a space; None if it is not regular grids to be cut (collective).

    On one rank the mesh may have several bodies, each a regular grid.
    """
    mesh = space.mesh
    if str(mesh.topology.cell_name()) not in ("quadrilateral", "hexahedron"):
        return None
    nodes = dolfinx_compat.dof_nodes(space)[: mesh.topology.index_map(mesh.topology.dim).size_local]
    body = pieces(mesh) if mesh.comm.size == 1 else np.zeros(len(nodes), np.int64)
    grids = []
    for number in range(int(body.max(initial=0)) + 1):
        grid = _of_body(space, nodes, body == number)
        if grid is None:
            return None
        grids.append(grid)
    if len(grids) == 1:
        return grids[0] if grids[0].count >= ALIKE else None
    of_cell, lattice = np.zeros(len(nodes), np.int64), np.zeros(len(grids[0].lattice), np.int64)
    for number, grid in enumerate(grids):
        on = np.unique(nodes[body == number])
        lattice[on] = grid.lattice[on] + lattice.max() + 1
        of_cell[body == number] = grid.of_cell + sum(g.count for g in grids[:number])
    cells = np.concatenate([grid.cells for grid in grids])
    bodies = np.repeat(np.arange(len(grids)), [grid.count for grid in grids])
    separate = sum(len(np.unique(nodes[body == k])) for k in range(len(grids))) == len(lattice)
    if len(cells) < ALIKE * len(grids) or not separate:
        return None
    return Grid(of_cell, lattice, cells, grids[0].degree, bodies)


def _of_body(space: Any, every: NDArray, chosen: Mask) -> Grid | None:
    """The cut of a body by its cells of this rank, with lattice numbers at its nodes (collective).

    Parameters
    ----------
    every : (cells, nodes of a cell)
    """
    comm, d, nodes = space.mesh.comm, space.mesh.topology.dim, every[chosen]
    degree = dolfinx_compat.lagrange_degree(space) or 1
    points = space.tabulate_dof_coordinates()[:, :d]
    on = np.unique(nodes) if comm.size == 1 else np.arange(len(points))
    lower, upper, counts = _extent(comm, points[on], points[nodes[:1]].reshape(-1, d))
    cells, total = comm.allreduce(len(nodes)), space.dofmap.index_map.size_global
    total = len(on) if comm.size == 1 else total
    if counts.prod() != cells or total != (degree * counts + 1).prod():
        return None
    place = (points - lower) / (upper - lower) * (counts * degree)
    lattice = np.rint(place).astype(np.int64)
    regular = np.abs(place - lattice)[on].max(initial=0.0) <= degree * EQUAL
    regular = regular and bool((np.ptp(lattice[nodes], axis=1) == degree).all())
    if not comm.allreduce(regular, op=MPI.LAND):
        return None
    kind = str(space.mesh.topology.cell_name())
    box = BoxShape(tuple(lower), tuple(upper), tuple(map(int, counts)), kind, degree)
    split = choose_split(box)
    if comm.size > 1 and np.prod(split) > 1:
        split = choose_split(box, comm.size)
    if len(split) != d:
        return None
    first = lattice[nodes].min(axis=1) // degree
    sub_box, sides = np.zeros(len(nodes), np.int64), []
    for axis in range(d):
        ends = np.linspace(0, counts[axis], split[axis] + 1).round().astype(np.int64)
        sub_box = sub_box * split[axis] + np.searchsorted(ends, first[:, axis], side="right") - 1
        sides.append(np.diff(ends))
    strides = np.cumprod([1, *(degree * counts[:-1] + 1)])
    along = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, d)
    return Grid(sub_box, lattice @ strides, along, degree, np.zeros(len(along), np.int64))


def _extent(comm: MPI.Intracomm, points: Array, first: Array) -> tuple[Array, Array, NDArray]:
    """Corners (d,) of the box about points, and cells along its axes (d,) (collective).

    Cells are counted by the nodes of a rank's first cell; zero where that is flat along an axis.
    """
    lower = np.min(comm.allgather(points.min(axis=0, initial=np.inf)), axis=0)
    upper = np.max(comm.allgather(points.max(axis=0, initial=-np.inf)), axis=0)
    cell = np.ptp(first, axis=0) if len(first) else np.zeros(points.shape[1])
    spacing = np.max(comm.allgather(cell), axis=0)
    counts = np.rint(np.divide(upper - lower, spacing, where=spacing > 0.0, out=0.0 * spacing))
    return lower, upper, counts.astype(np.int64)


def pieces(mesh: Any) -> Ints:
    """Number of the facet-connected piece of each cell that this rank owns."""
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d, d - 1)
    owned = mesh.topology.index_map(d).size_local
    facets, offsets = dolfinx_compat.adjacency(mesh.topology.connectivity(d, d - 1))
    facets = facets[: offsets[owned]]
    cells = np.repeat(np.arange(owned), np.diff(offsets[: owned + 1]))
    count = owned + int(facets.max(initial=-1)) + 1
    label = connected((cells, owned + facets), count)[:owned]
    return np.unique(label, return_inverse=True)[1].reshape(-1).astype(np.int64)
