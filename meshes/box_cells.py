"""The cells of a box one by one: every brick of the lattice is cut in the same way."""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask
from meshes.box import SIDES, BoxShape, lattice_places
from meshes.cells import Choose, Skin
from meshes.unstructured import CellMesh


class BoxCells:
    """Cells of a box, numbered brick by brick with x fastest."""

    def __init__(self, box: BoxShape) -> None:
        self.box = box
        self.cell, self.degree = box.cell, box.degree
        self.nodes, self.total_cells = box.nodes, box.total_cells

    @cached_property
    def _brick(self) -> CellMesh:
        box = self.box
        upper = tuple(np.array(box.lower) + box.spacing)
        return replace(box, upper=upper, cells=(1,) * box.dimension).cell_mesh()

    @cached_property
    def _places(self) -> Ints:
        """Places of the nodes of a brick on its lattice, (nodes, dimension)."""
        return lattice_places([self.degree + 1] * self.box.dimension)

    @property
    def _each(self) -> int:
        """Number of cells of a brick."""
        return self._brick.total_cells

    @property
    def _grid(self) -> tuple[int, ...]:
        """Bricks along each axis, x last."""
        return self.box.cells[::-1]

    def _first_nodes(self, bricks: NDArray[Any]) -> Ints:
        """The node at the lower corner of bricks."""
        node = np.zeros(bricks.shape, np.int64)
        for cells, stride in zip(self.box.cells[:-1], self.box.strides, strict=False):
            bricks, place = np.divmod(bricks, cells)
            node += place * (self.degree * stride)
        return node + bricks * (self.degree * self.box.strides[-1])

    def centres(self) -> NDArray[np.float32]:
        """Centres of cells, from the lower corner of the box.

        Equal within a plane of the lattice.
        """
        box, d = self.box, self.box.dimension
        inside = self._places[self._brick.cells].mean(axis=1) / self.degree
        result = np.empty((d, *self._grid, self._each), np.float32)
        for axis, (count, spacing) in enumerate(zip(box.cells, box.spacing, strict=True)):
            along = (np.arange(count)[:, None] + inside[:, axis]) * spacing
            shape = [1] * (d + 1)
            shape[d - 1 - axis], shape[d] = along.shape
            result[axis] = along.reshape(shape)
        return result.reshape(d, -1)

    def nodes_at(self, rows: NDArray[Any]) -> Ints:
        """Nodes of cells in VTK order, (rows, nodes per cell)."""
        bricks, which = np.divmod(rows, self._each)
        offsets = self._places[self._brick.cells] @ self.box.strides
        return self._first_nodes(bricks)[:, None] + offsets[which]

    def points_at(self, nodes: Ints) -> Array:
        """Coordinates of nodes, (nodes, dimension)."""
        box = self.box
        ends = np.array([self.degree * n + 1 for n in box.cells])
        place = nodes[:, None] // box.strides % ends
        return place * (box.spacing / self.degree) + np.array(box.lower)

    def tags_at(self, rows: NDArray[Any]) -> NDArray[np.int32]:
        """Numbers of materials: zero, since a box has one material."""
        return np.zeros(len(rows), np.int32)

    def neighbours(self, label: NDArray[Any], choose: Choose) -> tuple[NDArray, NDArray]:
        """Pairs of cells that share a facet, chosen by the labels (cells,) of the two."""
        each, d = self._each, self.box.dimension
        of = np.ascontiguousarray(label.reshape(-1, each).T).reshape(each, *self._grid)
        brick = np.arange(len(label) // each, dtype=np.int32).reshape(self._grid)
        firsts, seconds = [], []
        for one, other, axis in self._within + self._across:
            lower, upper, step = of[one], of[other], 0
            at = brick
            if axis is not None:
                ahead, behind = [slice(None)] * d, [slice(None)] * d
                ahead[d - 1 - axis], behind[d - 1 - axis] = slice(None, -1), slice(1, None)
                lower, upper, at = lower[tuple(ahead)], upper[tuple(behind)], at[tuple(ahead)]
                step = int(np.prod(self.box.cells[:axis]))
            cells = at[choose(lower, upper)]
            firsts.append(cells * each + one)
            seconds.append((cells + step) * each + other)
        return np.concatenate(firsts), np.concatenate(seconds)

    @property
    def _within(self) -> list[tuple[int, int, int | None]]:
        """Cells of a brick that share a facet inside it."""
        return [(int(a), int(b), None) for a, b in self._brick.topology.pairs]

    @property
    def _across(self) -> list[tuple[int, int, int | None]]:
        """Pairs of cells of neighbouring bricks along an axis that share a facet."""
        topology = self._brick.topology
        result: list[tuple[int, int, int | None]] = []
        for axis in range(self.box.dimension):
            in_side = [a for a in range(self.box.dimension) if a != axis]
            cell_of, others = (
                {
                    frozenset(map(tuple, self._places[topology.facets[row]][:, in_side].tolist())):
                    int(topology.facet_cells[row])
                    for row in self._brick.sides[SIDES[2 * axis + end][0]]
                }
                for end in (1, 0)
            )  # fmt: skip
            result += [(cell, others[facet], axis) for facet, cell in cell_of.items()]
        return result

    def skin(self, chosen: Mask) -> Skin:
        """Facets on the surface of the chosen cells (cells,), ordered by their cells."""
        topology, each, d = self._brick.topology, self._each, self.box.dimension
        offsets = self._places[topology.facets] @ self.box.strides
        brick = np.arange(len(chosen) // each).reshape(self._grid)
        keys, facets, cells, sides = [], [], [], []
        for number, (name, axis, end) in enumerate(SIDES[: 2 * d]):
            at = np.take(brick, -end, axis=d - 1 - axis).ravel()
            rows = self._brick.sides[name]
            owner = at[:, None] * each + topology.facet_cells[rows]
            which, nth = np.nonzero(chosen[owner])
            at, rows = at[which], rows[nth]
            cells.append(owner[which, nth])
            keys.append(at * len(topology.facets) + rows)
            facets.append(self._first_nodes(at)[:, None] + offsets[rows])
            sides.append(np.full(len(at), number))
        order = np.argsort(np.concatenate(keys))
        side = np.concatenate(sides)[order]
        return Skin(
            np.concatenate(facets)[order],
            np.concatenate(cells)[order],
            {name: side == number for number, (name, _, _) in enumerate(SIDES[: 2 * d])},
        )


Cells = BoxCells | CellMesh
"""The cells of a body that is cut into subdomains: those of a box, or a list."""
