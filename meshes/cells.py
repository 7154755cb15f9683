"""The protocol of the cells of a body that is cut into subdomains: a lattice, or lists of cells."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask

Choose = Callable[[NDArray[Any], NDArray[Any]], Mask]
"""Mask of wanted pairs of cells, given the labels of the first and of the second cells."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Facets of some cells that lie on the surface of the body."""

    facets: Ints  # (facets, nodes per facet)
    """Nodes of each facet, vertices first."""
    cells: Ints  # (facets,)
    """Cell of each facet."""
    sides: Mapping[str, Mask]
    """Masks (facets,) of the facets on each named boundary."""


class Cells(Protocol):
    """The cells of a body; data are computed for the requested cells only."""

    @property
    def cell(self) -> str:
        """Name of the cell."""

    @property
    def degree(self) -> int:
        """Degree of the displacement, 1 or 2, which decides the nodes of cells."""

    @property
    def nodes(self) -> int:
        """Number of nodes of the body."""

    @property
    def total_cells(self) -> int:
        """Number of cells of the body."""

    def centres(self) -> NDArray[np.float32] | None:
        """Approximate centres of cells, (dimension, cells).

        None if the cells differ much in size.
        """

    def nodes_at(self, rows: NDArray[Any]) -> Ints:
        """Nodes of cells in VTK order, (rows, nodes per cell)."""

    def points_at(self, nodes: Ints) -> Array:
        """Coordinates of nodes, (nodes, dimension)."""

    def tags_at(self, rows: NDArray[Any]) -> NDArray[np.int32]:
        """Numbers of the materials of cells, (rows,)."""

    def neighbours(self, label: NDArray[Any], choose: Choose) -> tuple[NDArray, NDArray]:
        """Pairs of cells that share a facet, chosen by the labels (cells,) of the two."""

    def skin(self, chosen: Mask) -> Skin:
        """Facets on the surface of the chosen cells (cells,), ordered by their cells."""
