"""Boxes whose cells differ in size along each axis: the product of one grid per axis.

Graded cells make unequal subdomains. So graded boxes are stored cell by cell, as meshes from files,
and cut by graph partitioning.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from meshes.arrays import Array
from meshes.box import BoxShape, lattice_places
from meshes.unstructured import CellMesh


def graded_box(cell: str, coordinates: Sequence[Array]) -> CellMesh:
    """A box of equal cells whose grid lines are moved; nodes are numbered with x fastest.

    Parameters
    ----------
    cell
        Cell type; triangles and tetrahedra share the diagonals that ascend along all axes.
    coordinates
        Ascending grid coordinates along each axis.
    """
    counts = tuple(len(lines) - 1 for lines in coordinates)
    even = BoxShape((0.0,) * len(counts), (1.0,) * len(counts), counts, cell).cell_mesh()
    place = lattice_places([n + 1 for n in counts])
    points = np.stack([lines[p] for lines, p in zip(coordinates, place.T, strict=True)], axis=1)
    return replace(even, points=points, name="a graded box")
