"""What a body has to tell of its cells to be cut into subdomains: a lattice, or lists of cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Choose = Callable[[NDArray[Any], NDArray[Any]], NDArray[np.bool_]]
"""Which pairs of cells are meant, by the labels of the first ones and of the others."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Facets of some cells that lie on the surface of the body.

    Attributes
    ----------
    facets : (facets, nodes a facet)
        Their nodes, vertices first.
    cells : (facets,)
        The cell each of them belongs to.
    sides
        Which of them are on a part of the surface, (facets,), by its name.
    """

    facets: NDArray[np.int64]
    cells: NDArray[np.int64]
    sides: Mapping[str, NDArray[np.bool_]]


class Cells(Protocol):
    """The cells of a body, asked for those that are wanted only."""

    @property
    def cell(self) -> str:
        """Name of the cell."""

    @property
    def degree(self) -> int:
        """1 or 2: which nodes cells have."""

    @property
    def nodes(self) -> int:
        """Nodes of the body."""

    @property
    def total_cells(self) -> int:
        """Cells of the body."""

    def centres(self) -> NDArray[np.float32] | None:
        """About where cells are, (dimension, cells); None if they are not of much the same size."""

    def nodes_at(self, rows: NDArray[Any]) -> NDArray[np.int64]:
        """Nodes of cells in VTK order, (rows, nodes a cell)."""

    def points_at(self, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Coordinates of nodes, (nodes, dimension)."""

    def tags_at(self, rows: NDArray[Any]) -> NDArray[np.int32]:
        """Numbers of the materials of cells, (rows,)."""

    def neighbours(self, label: NDArray[Any], choose: Choose) -> tuple[NDArray, NDArray]:
        """Pairs of cells that share a facet, chosen by the labels (cells,) of the two."""

    def skin(self, chosen: NDArray[np.bool_]) -> Skin:
        """Facets on the surface of the chosen cells (cells,), ordered by their cells."""
