"""Named inner surfaces: facets between cells of a body that divide it into two sides.

Cells that share a facet outside of the surface lie on one side; across the surface the side
changes. If that gives each cell one side, the surface is stored as the cells of one of them, which
refinement and cuts of a mesh keep as they keep groups of cells. A surface that ends inside the body
has no sides.
"""

import numpy as np

from meshes.arrays import Ints, Mask
from meshes.connected import connected
from meshes.unstructured import FACETS, CellMesh, Topology, row_places


def sides_of_facets(facets: Ints, cells: Ints, cell: str, topology: Topology) -> Mask | None:
    """Mask (cells,) of the cells on one side of some facets; None if they have no two sides.

    Parameters
    ----------
    facets : (facets, vertices)
        Ascending vertices of each facet; each must be between two cells.
    """
    if not len(facets):
        return None
    rows = row_places(np.sort(pair_vertices(cells, cell, topology), axis=1), facets)
    if (rows < 0).any():
        return None
    across = np.zeros(len(topology.pairs), bool)
    across[rows] = True
    return sides_across(topology, across, len(cells))


def sides_across(topology: Topology, across: Mask, count: int) -> Mask | None:
    """Mask (count,) of the cells on one side of a surface; None if it has no two sides.

    Parameters
    ----------
    across : (pairs,)
        Mask of the pairs of neighbours between which the surface lies.
    """
    part = connected(topology.pairs[~across].T, count)
    one, other = part[topology.pairs[across]].T
    parts = int(part.max()) + 1
    # each part twice, as if on either side: a part that hangs together with itself has no side
    ends = np.concatenate([one, one + parts]), np.concatenate([other + parts, other])
    first, second = connected(ends, 2 * parts).reshape(2, parts)
    if (first == second).any():
        return None
    return np.asarray((first < second)[part])


def pair_vertices(cells: Ints, cell: str, topology: Topology) -> Ints:
    """Vertices of the facet between each pair of neighbours, (pairs, vertices)."""
    table = np.array(FACETS[cell])[topology.pair_facets[:, 0]]
    return np.take_along_axis(cells[topology.pairs[:, 0]], table, axis=1)


def sides_where(mesh: CellMesh, on: Mask) -> Mask | None:
    """Mask (cells,) of the cells on one side of the inner facets all of whose vertices are `on`.

    None if these facets have no two sides.

    Parameters
    ----------
    on : (nodes,)
    """
    across = on[pair_vertices(mesh.cells, mesh.cell, mesh.topology)].all(axis=1)
    return sides_across(mesh.topology, across, mesh.total_cells) if across.any() else None
