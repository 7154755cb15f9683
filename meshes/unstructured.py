"""Meshes given cell by cell: arrays of points, cells and named groups, and their topology.

A facet that one cell has is on the surface; two cells that have a facet in common are neighbours.
Both follow from sorting the facets of all cells by their nodes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask, in_order
from meshes.cell_shape import cell_sizes
from meshes.cells import Choose, Skin
from meshes.quadratic import VERTICES, facet_table, with_middles


class MeshError(ValueError):
    """A mesh that cannot be used; the message says why and how to correct it."""


def first_of(points: Array, cells: Ints, bad: Mask, fault: str, number: Ints) -> str:
    """Message with the number of `bad` cells (cells,) and the first one.

    Its number in the file and its centre.
    """
    first = np.flatnonzero(bad)[0]
    at = ", ".join(f"{v:g}" for v in points[cells[first]].mean(axis=0))
    name = f"cell {number[first] + 1} of the file, at ({at})"
    return f"has {int(bad.sum())} {fault}; the first is {name}"


FACETS = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": (
        (0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ),
}  # fmt: skip
"""Vertices of each facet of a cell, vertices of the cell in VTK order."""

EVEN = 3.0
"""Largest ratio of large to small cells (95th and 5th percentile of lengths) of even meshes."""


def matching_rows(table: Ints, sought: Ints) -> Ints:
    """Row of `table` that equals each row of `sought`; each must exist, rows are sorted."""
    return row_places(table, sought)


def row_places(table: Ints, sought: Ints) -> Ints:
    """Row of `table` that equals each row of `sought`, -1 if no row does; rows are sorted."""
    keys = _row_keys(np.concatenate([table, sought]))
    present, requested = keys[: len(table)], keys[len(table) :]
    order = np.argsort(present)
    at = order[np.minimum(np.searchsorted(present, requested, sorter=order), len(present) - 1)]
    return np.asarray(np.where(present[at] == requested, at, -1))


def _row_keys(rows: Ints) -> Ints:
    """One number per row of non-negative integers; equal rows have equal numbers, order is kept."""
    base = int(rows.max(initial=0)) + 1
    keys = np.zeros(len(rows), np.int64)
    span = 1
    for column in rows.T:
        if span > np.iinfo(np.int64).max // base:  # what was packed so far is counted instead
            distinct, keys = np.unique(keys, return_inverse=True)
            span = len(distinct)
        keys = keys * base + column
        span *= base
    return keys


@dataclass(frozen=True, eq=False)
class Topology:
    """The neighbourhood of the cells of a mesh."""

    facets: Ints  # (facets, nodes per facet)
    """Nodes of the facets on the surface, vertices first."""
    facet_cells: Ints  # (facets,)
    """Cell of each facet."""
    facet_numbers: Ints  # (facets,)
    """Local number of each facet in its cell."""
    pairs: Ints  # (pairs, 2)
    """Cells that share a facet."""
    pair_facets: NDArray[np.int8]  # (pairs, 2)
    """Local number of the common facet in each of the two cells."""
    crowded: int
    """Facets that more than two cells have: none in a mesh that fills space once."""

    @classmethod
    def of(cls, cells: Ints, cell: str) -> "Topology":
        """Topology of cells (cells, nodes) in VTK order, of first or second order."""
        table = np.array(FACETS[cell])
        # half as wide: allocating memory takes most of the time at 10⁶ facets
        facets = cells.astype(np.int32)[:, table].reshape(-1, table.shape[1])
        owner = np.repeat(np.arange(len(cells), dtype=np.int32), len(table))
        keys = _row_keys(in_order(facets))
        order = np.argsort(keys, kind="stable")
        start = np.flatnonzero(np.diff(keys[order], prepend=-1))
        count = np.diff(np.append(start, len(keys)))
        single, double = order[start[count == 1]], start[count == 2]
        single.sort()
        twice = np.stack([order[double], order[double + 1]], axis=1)
        on_surface = facets[single].astype(np.int64)
        if cells.shape[1] > VERTICES[cell]:
            nodes = facet_table(FACETS[cell], cell)[single % len(table)]
            on_surface = cells[owner[single][:, None], nodes]
        return cls(
            facets=on_surface,
            facet_cells=owner[single].astype(np.int64),
            facet_numbers=single % len(table),
            pairs=owner[twice].astype(np.int64),
            pair_facets=(twice % len(table)).astype(np.int8),
            crowded=int((count > 2).sum()),
        )


@dataclass(frozen=True, eq=False)
class CellMesh:
    """A mesh of one body, cell by cell."""

    cell: str
    """``triangle``, ``quadrilateral``, ``tetrahedron`` or ``hexahedron``."""
    points: Array  # (nodes, dimension)
    """Coordinates, in the unit of length of the scene."""
    cells: Ints  # (cells, nodes per cell)
    """Nodes of each cell in VTK order, vertices first."""
    topology: Topology
    """Surface and neighbourhood of the cells."""
    sides: Mapping[str, NDArray[np.int32]]
    """Rows of ``topology.facets`` on each named boundary."""
    groups: Mapping[str, Ints]
    """Ascending cells of each named group."""
    tags: NDArray[np.int32]  # (cells,)
    """Number of each cell's material among the materials of the body."""
    name: str = "mesh"
    """Source of the mesh, for reports."""
    notes: tuple[str, ...] = field(default=())
    """Notes on repaired or dropped data of the file, one sentence each."""
    degree: int = 1
    """1, or 2 if cells have nodes on their edges and faces and in their middle, too."""
    middles: Array | None = None  # (cells, further nodes, dimension)
    """For a mesh of degree 1 with curved edges: coordinates of the nodes of degree 2 besides the
    vertices, in VTK order. None for straight edges."""
    coarse: "CellMesh | None" = None
    """The mesh that was refined to this one: its vertices are on the true shape. None for a mesh
    that was not refined."""
    inner: Mapping[str, Ints] = field(default_factory=dict)
    """Ascending cells on one side of each named inner surface, which divides the mesh."""

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return self.points.shape[1]

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.points)

    @property
    def total_cells(self) -> int:
        """Number of cells."""
        return len(self.cells)

    @cached_property
    def size(self) -> float:
        """Area or volume of the cells with straight edges."""
        return float(cell_sizes(self.points, self.cells, self.cell).sum())

    @cached_property
    def lower(self) -> tuple[float, ...]:
        """Smallest coordinates of any node."""
        return tuple(float(v) for v in self._places.min(axis=0))

    @cached_property
    def upper(self) -> tuple[float, ...]:
        """Largest coordinates of any node."""
        return tuple(float(v) for v in self._places.max(axis=0))

    @property
    def _places(self) -> Array:
        """Coordinates of nodes, including nodes on curved edges."""
        if self.middles is None:
            return self.points
        return np.concatenate([self.points, self.middles.reshape(-1, self.dimension)])

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the boundaries defined in the mesh."""
        return tuple(self.sides)

    @property
    def congruent(self) -> bool:
        """Whether its parts are congruent: no."""
        return False

    def tagged(self, groups: Sequence[str]) -> "CellMesh":
        """The mesh with each cell tagged by the number of its group among these.

        Raises
        ------
        MeshError
            There is no such group, or a cell is in two of them or in none.
        """
        tags = np.full(self.total_cells, -1, np.int32)
        names = ", ".join(self.groups) or "none"
        for number, name in enumerate(groups):
            rows = self.groups.get(name)
            if rows is None or len(rows) == 0:
                raise MeshError(
                    f"names the group {name!r}; {self.name} has no such cells in this body "
                    f"(groups of cells: {names})"
                )
            assigned = tags[rows] >= 0
            if assigned.any():
                other = groups[tags[rows[np.argmax(assigned)]]]
                raise MeshError(
                    f"gives {int(assigned.sum())} cells two materials: they are in the groups "
                    f"{other!r} and {name!r}"
                )
            tags[rows] = number
        bare = int((tags < 0).sum())
        if bare:
            raise MeshError(
                f"leaves {bare} of {self.total_cells} cells without a material (groups of cells in "
                f"{self.name}: {names})"
            )
        return replace(self, tags=tags)

    @property
    def fingerprint(self) -> str:
        """A hash of its nodes, cells, materials and boundaries."""
        arrays: list[NDArray[Any]] = [self.points, self.cells, self.tags, *self.sides.values()]
        arrays += [] if self.middles is None else [self.middles]
        return sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Message why the body of this name cannot be cut into so many parts; empty if it can."""
        if math.prod(parts) > self.total_cells:
            return f"asks for {math.prod(parts)} parts, where {name} has {self.total_cells} cells"
        return ""

    @cached_property
    def _quadratic(self) -> "CellMesh":
        """The mesh with the nodes of degree 2."""
        points, cells = with_middles(self.points, self.cells, self.cell)
        if self.middles is not None:
            points[cells[:, VERTICES[self.cell] :]] = self.middles
        topology = Topology.of(cells, self.cell)  # facets in the same order
        return replace(self, points=points, cells=cells, topology=topology, degree=2, middles=None)

    def centres(self) -> NDArray[np.float32] | None:
        """Approximate centres of cells from the lower corner.

        None if the cells differ much in size.
        """
        corners = self.cells[:, : VERTICES[self.cell]].T
        centres = np.empty((self.dimension, self.total_cells), np.float32)
        size = np.zeros(self.total_cells, np.float32)
        for axis, (x, lower) in enumerate(zip(self.points.T, self.lower, strict=True)):
            x = (x - lower).astype(np.float32)
            least, most, total = (x[corners[0]] for _ in range(3))
            for corner in corners[1:]:
                value = x[corner]
                np.minimum(least, value, out=least)
                np.maximum(most, value, out=most)
                total += value
            np.divide(total, len(corners), out=centres[axis])
            np.maximum(size, most - least, out=size)
        small, large = np.quantile(size, (0.05, 0.95))
        return centres if large <= EVEN * small else None

    def nodes_at(self, rows: NDArray[Any]) -> Ints:
        """Nodes of cells in VTK order, (rows, nodes per cell)."""
        return self.cells[rows]

    def points_at(self, nodes: Ints) -> Array:
        """Coordinates of nodes, (nodes, dimension)."""
        return self.points[nodes]

    def tags_at(self, rows: NDArray[Any]) -> NDArray[np.int32]:
        """Numbers of the materials of cells, (rows,)."""
        return self.tags[rows]

    def neighbours(self, label: NDArray[Any], choose: Choose) -> tuple[NDArray, NDArray]:
        """Pairs of cells that share a facet, chosen by the labels (cells,) of the two."""
        a, b = self.topology.pairs.T
        chosen = np.flatnonzero(choose(label[a], label[b]))
        return a[chosen], b[chosen]

    def skin(self, chosen: Mask) -> Skin:
        """Facets on the surface of the chosen cells (cells,), ordered by their cells."""
        rows = np.flatnonzero(chosen[self.topology.facet_cells])
        sides = {}
        for name, on in self.sides.items():
            member = np.zeros(len(self.topology.facets), bool)
            member[on] = True
            sides[name] = member[rows]
        return Skin(self.topology.facets[rows], self.topology.facet_cells[rows], sides)

    def shape(self, degree: int) -> "CellMesh":
        """The cells to cut into subdomains: the mesh itself, with the nodes of a degree."""
        return self if degree == self.degree else self._quadratic

    def nodes_of(self, degree: int) -> int:
        """Number of nodes of a displacement of a degree."""
        return self.shape(degree).nodes

    def describe(self) -> str:
        """A phrase for reports."""
        curved = "" if self.middles is None else " with curved edges"
        return f"{self.name} of {self.total_cells:,} cells ({self.cell}){curved}"
