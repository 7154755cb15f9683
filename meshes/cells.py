"""Facets on the surface of cells, and the choice of pairs of cells."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from meshes.arrays import Ints, Mask

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
