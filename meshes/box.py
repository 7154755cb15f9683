"""Boxes: lattices of equal cells, split regularly into congruent sub-boxes.

The nodes of a box are a lattice, so the number of a node in the undecomposed mesh follows from its
place, and no mesh of the whole box is built. A split into nx × ny × nz sub-boxes has at most 2^d
different shapes (sizes differ by one cell where the cells do not divide evenly), hence at most 2^d
references.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from numpy.typing import NDArray

from meshes.arrays import Array, Ints
from meshes.subdomains import Reference, Subdomain
from meshes.unstructured import CellMesh, Topology

SIDES = (("x-", 0, 0), ("x+", 0, 1), ("y-", 1, 0), ("y+", 1, 1), ("z-", 2, 0), ("z+", 2, 1))
"""Name, axis and end of each side of a box."""

CELLS_PER_CUBE = {"triangle": 2, "quadrilateral": 1, "tetrahedron": 6, "hexahedron": 1}


@dataclass(frozen=True)
class BoxShape:
    """A box of equal cells."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    """Opposite corners, in the unit of length of the scene."""
    cells: tuple[int, ...]
    """Cells along each axis (cubes, each cut into six, for tetrahedra; squares cut in two for
    triangles)."""
    cell: str
    """``hexahedron``, ``tetrahedron``, ``quadrilateral`` or ``triangle``."""
    degree: int = 1
    """Degree of the displacement. The nodes of degree 2 form a lattice twice as fine: vertices have
    even indices, and the middles of edges, faces and cells at least one odd index. If a cube is cut
    into tetrahedra, each such middle lies on an edge."""

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.cells)

    @cached_property
    def strides(self) -> Ints:
        """Difference in node number between neighbours along each axis; x runs fastest."""
        return np.cumprod([1, *(self.degree * n + 1 for n in self.cells[:-1])], dtype=np.int64)

    @property
    def nodes(self) -> int:
        """Number of nodes of the lattice."""
        return int(np.prod([self.degree * n + 1 for n in self.cells], dtype=np.int64))

    @property
    def total_cells(self) -> int:
        """Number of cells of the mesh."""
        return int(np.prod(self.cells, dtype=np.int64)) * CELLS_PER_CUBE[self.cell]

    @property
    def spacing(self) -> Array:
        """Edge lengths of one cell."""
        return (np.array(self.upper) - np.array(self.lower)) / np.array(self.cells)

    def mesh(self) -> Any:
        """The dolfinx mesh of the whole box, its lower corner at the origin, on this process."""
        cell_type = getattr(dmesh.CellType, self.cell)
        lengths = self.spacing * self.cells
        if self.dimension == 3:
            corners = [np.zeros(3), lengths]
            return dmesh.create_box(MPI.COMM_SELF, corners, list(self.cells), cell_type)
        corners = [np.zeros(2), lengths]
        return dmesh.create_rectangle(MPI.COMM_SELF, corners, list(self.cells), cell_type)

    def cell_mesh(self) -> CellMesh:
        """The whole box cell by cell, its nodes numbered by their place in the lattice.

        dolfinx divides all bricks of the lattice in the same way: one is divided and repeated.
        """
        upper = np.array(self.lower) + self.spacing
        brick = replace(self, upper=tuple(upper), cells=(1,) * self.dimension)
        reference = Reference.of(brick.mesh(), self.cell, self.degree)
        offsets = brick.lattice(reference.points)[reference.cells] @ self.strides
        bricks = lattice_places(self.cells) @ (self.degree * self.strides)
        cells = (bricks[:, None, None] + offsets).reshape(-1, offsets.shape[1])
        place = lattice_places([self.degree * n + 1 for n in self.cells])
        points = place * (self.spacing / self.degree) + np.array(self.lower)
        topology = Topology.of(cells, self.cell)
        return CellMesh(
            cell=self.cell,
            points=points,
            cells=cells,
            topology=topology,
            sides=sides_of(self, place, topology.facets),
            groups={},
            tags=np.zeros(len(cells), np.int32),
            degree=self.degree,
        )

    def lattice(self, points: Array) -> Ints:
        """Lattice indices (n, dimension) of points (n, 3) measured from the lower corner."""
        places = points[:, : self.dimension] * (self.degree / self.spacing)
        return np.rint(places).astype(np.int64)


def lattice_places(counts: Sequence[int]) -> Ints:
    """All places of a lattice, (n, dimension), the first axis fastest."""
    axes = np.indices(tuple(counts)[::-1]).reshape(len(counts), -1)
    return axes[::-1].T.astype(np.int64)


def sides_of(box: BoxShape, lattice: Ints, facets: NDArray[Any]) -> dict[str, NDArray[np.int32]]:
    """Rows of `facets` (nodes each) on each side of a box, given the lattice index of nodes."""
    sides = {}
    for name, axis, end in SIDES[: 2 * box.dimension]:
        on_side = lattice[:, axis] == end * box.degree * box.cells[axis]
        sides[name] = np.flatnonzero(on_side[facets].all(axis=1)).astype(np.int32)
    return sides


def split_points(cells: int, parts: int) -> Ints:
    """Cut points of `cells` cells in `parts` runs whose lengths differ by at most one cell."""
    return np.arange(parts + 1, dtype=np.int64) * cells // parts


def split_regularly(
    box: BoxShape,
    parts: tuple[int, ...],
    body: int,
    first_number: int,
    first_node: int,
    numbers: range,
    references: dict[Any, tuple[Reference, dict[str, NDArray[np.int32]], Ints]],
) -> list[Subdomain]:
    """The sub-boxes of a regular split that have the given numbers.

    Parameters
    ----------
    parts
        Sub-boxes along each axis.
    first_number
        Number of this body's first subdomain; sub-boxes are numbered with x fastest.
    numbers
        Numbers of the wanted subdomains (of this rank).
    references
        Shapes already meshed, by key; new ones are added, so that bodies share them.
    """
    cuts = [split_points(n, p) for n, p in zip(box.cells, parts, strict=True)]
    subdomains = []
    for number in numbers:
        place = np.unravel_index(number - first_number, parts, order="F")
        begin = np.array([c[i] for c, i in zip(cuts, place, strict=True)])
        size = tuple(int(c[i + 1] - c[i]) for c, i in zip(cuts, place, strict=True))
        key = (box.cell, box.degree, size, tuple(box.spacing))
        if key not in references:
            references[key] = _reference(box, size)
        reference, sides, lattice = references[key]
        translation = np.zeros(3)
        translation[: box.dimension] = np.array(box.lower) + begin * box.spacing
        at_end = {
            name: begin[axis] + end * size[axis] == end * box.cells[axis]
            for name, axis, end in SIDES[: 2 * box.dimension]
        }
        boundaries = {name: rows for name, rows in sides.items() if at_end[name]}
        exterior = np.concatenate([np.zeros(0, np.int32), *boundaries.values()])
        subdomains.append(
            Subdomain(
                number=number,
                body=body,
                reference=reference,
                translation=translation,
                nodes=first_node + (lattice + box.degree * begin) @ box.strides,
                exterior=exterior,
                boundaries=boundaries,
            )
        )
    return subdomains


def _reference(
    box: BoxShape, size: tuple[int, ...]
) -> tuple[Reference, dict[str, NDArray[np.int32]], Ints]:
    """Mesh a sub-box of `size` cells; with its sides and the lattice indices of its nodes."""
    lower, upper = (0.0,) * box.dimension, tuple(box.spacing * size)
    block = BoxShape(lower, upper, size, box.cell, box.degree)
    reference = Reference.of(block.mesh(), box.cell, box.degree)
    lattice = block.lattice(reference.points)
    return reference, sides_of(block, lattice, reference.facets), lattice
