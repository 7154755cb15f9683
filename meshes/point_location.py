"""Location of points in a mesh: cell nodes, shape functions, distance from the mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array
from meshes.quadratic import VERTICES
from meshes.subdomains import Reference, vtk_order, vtk_places, vtk_shapes


@dataclass(frozen=True, eq=False)
class Located:
    """Location of points in their cells, or at the nearest place of the nearest cell."""

    nodes: NDArray[np.int32]
    shares: Array
    """Nodes of the cell, and the values of their shape functions at the point. Shape (points, nodes
    per cell)."""
    distance: Array  # (points,)
    """Distance from the mesh; rounding errors if a cell contains the point."""


def locate_in(
    reference: Reference, cells: NDArray[np.integer], points: Array, dimension: int
) -> Located:
    """Find points (n, 3), in the frame of the reference, in given cells (n,).

    Distances near curved edges are right to some per cent.
    """
    order = 2 if reference.curved else 1
    nodes, targets = reference.cells[cells], points[:, :dimension]
    simplex = VERTICES[reference.cell] == dimension + 1
    corners = reference.points[nodes[:, : len(vtk_order(reference.cell, order))], :dimension]
    place = vtk_places(reference.cell, order, corners, targets)
    place = np.clip(place, 0.0, 1.0)
    if simplex:
        place /= np.maximum(place.sum(axis=1, keepdims=True), 1.0)
    at = np.einsum("pn,pni->pi", vtk_shapes(reference.cell, order, place)[0], corners)
    shares = vtk_shapes(reference.cell, reference.degree, place)[0]
    return Located(nodes, shares, np.linalg.norm(targets - at, axis=1))
