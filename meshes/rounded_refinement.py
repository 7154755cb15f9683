"""New nodes of a refined mesh are moved onto the smooth surface that round boundaries stand for.

The midpoint of an edge of flat facets lies h²/8R beside the round surface through the vertices. A
mesh that is refined without moving it converges to the polyhedron. The height of the smooth surface
over each facet is that of `meshes.smooth_surface`, so that the gaps of `round: true` and the
refined mesh have one surface. An edge between smooth facets moves by the mean of their heights
along their normals. At a sharp edge, such as the rim of a bore, the point at both heights is taken:
it stays in the plane of the other facet. Cells that would lose most of their volume keep their
straight edges.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.arrays import Array, Mask
from meshes.cell_shape import at_vertices, corner_jacobians
from meshes.contact_surface import Surface
from meshes.smooth_surface import SMOOTH
from meshes.unstructured import CellMesh, matching_rows

LEAST_JACOBIAN = 0.3
"""Jacobian at a corner of a cell over that with straight edges, below which the nodes of the cell
are not moved."""

SAME_PLACE = 1e-9
"""Distance of two places, over the size of the mesh, below which they are one."""

KNIFE = 0.1
"""Sine of the angle between two facets below which no point is at the heights of both."""


def rounded(fine: CellMesh, coarse: CellMesh, facets: NDArray[np.integer]) -> CellMesh:
    """The refined mesh with new nodes on the smooth surface of some facets.

    Parameters
    ----------
    fine
        `refined` or `bisected` from `coarse`.
    coarse
        A mesh of first order with straight edges; one with curved edges changes nothing.
    facets
        Rows of its ``topology.facets`` on round boundaries.
    """
    if coarse.middles is not None or len(facets) == 0:
        return fine
    places, moves = _moves(coarse, facets)
    size = float(np.ptp(coarse.points, axis=0).max())
    distance, node = cKDTree(fine.points).query(places)
    is_node = distance < SAME_PLACE * size
    step = np.zeros_like(fine.points)
    step[node[is_node]] = moves[is_node]
    before = corner_jacobians(at_vertices(fine.points, fine.cells), fine.cell)
    while True:
        after = corner_jacobians(at_vertices(fine.points + step, fine.cells), fine.cell)
        flat = (after / before < LEAST_JACOBIAN).any(axis=0)
        bad = np.unique(fine.cells[flat])
        if not step[bad].any():
            return replace(fine, points=fine.points + step)
        step[bad] = 0.0


def _moves(mesh: CellMesh, facets: NDArray[np.integer]) -> tuple[Array, Array]:
    """Midpoints of the edges and facets of a round boundary, and their ways to the smooth surface.

    Each of shape (n, dimension).
    """
    d = mesh.dimension
    points = np.pad(mesh.points, ((0, 0), (0, 3 - d)))
    corners, inside = mesh.topology.facets, points[mesh.cells].mean(axis=1)
    inside = inside[mesh.topology.facet_cells]
    skin = Surface.of(d, corners, points[corners], inside)
    place = matching_rows(np.sort(skin.nodes, axis=1), np.sort(corners[facets], axis=1))
    is_round = np.isin(np.arange(len(corners)), place)
    some = replace(
        skin,
        nodes=skin.nodes[is_round],
        points=skin.points[is_round],
        normals=skin.normals[is_round],
    ).smooth()
    v = corners.shape[1]
    bulge = np.zeros((len(corners), v, v))
    bulge[is_round] = some.bulge
    middle = np.full(v, 1.0 / v)
    height = 0.5 * np.einsum("a,fab,b->f", middle, bulge[is_round], middle)
    places = [skin.vertices[is_round].mean(axis=1)]
    moves = [height[:, None] * skin.normals[is_round]]
    if d == 3:
        for values, more in zip((places, moves), _of_edges(skin, bulge, is_round), strict=True):
            values.append(more)
    return np.concatenate(places)[:, :d], np.concatenate(moves)[:, :d]


def _of_edges(skin: Surface, bulge: Array, is_round: Mask) -> tuple[Array, Array]:
    """Midpoints of the edges of round facets, and their ways to the smooth surface: (n, 3) each."""
    v = bulge.shape[1]
    first, second = np.arange(v), np.roll(np.arange(v), -1)
    ends = np.sort(np.stack([skin.nodes[:, first], skin.nodes[:, second]], axis=2), axis=2)
    ends = ends.reshape(-1, 2)
    facet = np.repeat(np.arange(len(bulge)), v)
    order = np.lexsort(ends.T)
    ends, facet, heights = ends[order], facet[order], 0.25 * bulge[:, first, second].ravel()[order]
    begin = np.flatnonzero(np.append(True, (ends[1:] != ends[:-1]).any(axis=1)))
    begin = begin[np.diff(np.append(begin, len(ends))) == 2]
    pair = np.stack([begin, begin + 1], axis=1)
    pair = pair[is_round[facet[pair]].any(axis=1)]
    of_pair, height, smooth = facet[pair], heights[pair], is_round[facet[pair]]
    normals = skin.normals[of_pair]
    cosine = np.einsum("ei,ei->e", normals[:, 0], normals[:, 1])
    mean = smooth / smooth.sum(axis=1, keepdims=True)
    share = mean * height
    sharp = cosine < np.cos(SMOOTH)
    sine_squared = 1.0 - cosine[sharp] ** 2
    at_both = (height[sharp] - cosine[sharp, None] * height[sharp][:, ::-1]) / np.maximum(
        sine_squared, KNIFE**2
    )[:, None]
    share[sharp] = np.where((sine_squared > KNIFE**2)[:, None], at_both, 0.0)
    middles = 0.5 * (skin.vertices[:, first] + skin.vertices[:, second]).reshape(-1, 3)[order]
    return middles[pair[:, 0]], np.einsum("ek,eki->ei", share, normals)
