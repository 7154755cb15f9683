"""Uniform refinement of round bodies: new nodes on a circle or a ball lie on it.

A mesh file holds the corners of its cells, not the true shape. If a part of the surface lies on a
circle or a ball, its corners determine the circle or ball.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from meshes.arrays import Array, Ints
from meshes.quadratic import EDGES, middles_of, straight_middles
from meshes.refine import refined
from meshes.unstructured import CellMesh, MeshError

ON = 1e-6
"""Largest distance of a corner from its circle or ball, relative to the radius."""

Round = tuple[str, Array, float]


def refined_round(
    mesh: CellMesh, times: int, sides: Sequence[str], curved: bool = False
) -> CellMesh:
    """Halve all edges some times, and move new nodes of the sides onto circle or ball.

    Parameters
    ----------
    mesh
        Mesh with straight edges.
    sides
        Parts of the surface, each on one circle or ball.
    curved
        Whether cells get round edges on these sides, for displacements of degree 2.

    Raises
    ------
    MeshError
        A side is no part of a circle or ball.
    """
    rounds = [(name, *_fitted(mesh, name)) for name in sides]
    mesh = replace(mesh, middles=None)
    for _ in range(times):
        mesh = refined(mesh)
        points = mesh.points.copy()
        for name, centre, radius in rounds:
            on = np.unique(mesh.topology.facets[mesh.sides[name]])
            points[on] = _onto(points[on], centre, radius)
        mesh = replace(mesh, points=points, coarse=None)
    return replace(mesh, middles=_round_middles(mesh, rounds)) if curved else mesh


def _fitted(mesh: CellMesh, name: str) -> tuple[Array, float]:
    """Centre and radius of the circle or ball that the corners of a side lie on."""
    corners = mesh.points[np.unique(mesh.topology.facets[mesh.sides[name]])]
    matrix = np.column_stack([2.0 * corners, np.ones(len(corners))])
    fit, _, rank, _ = np.linalg.lstsq(matrix, (corners**2).sum(axis=1), rcond=None)
    centre = fit[:-1]
    radius = float(np.sqrt(max(fit[-1] + centre @ centre, 0.0)))
    away = np.abs(np.linalg.norm(corners - centre, axis=1) - radius)
    if rank < matrix.shape[1] or away.max() > ON * radius:
        raise MeshError(f"the side {name!r} is no part of a circle or ball")
    return centre, radius


def _onto(points: Array, centre: Array, radius: float) -> Array:
    """Points (n, d) moved to the circle or ball, along its radius."""
    out = points - centre
    return np.asarray(centre + radius * out / np.linalg.norm(out, axis=1, keepdims=True))


def _round_middles(mesh: CellMesh, rounds: Sequence[Round]) -> Array:
    """Coordinates of the additional nodes of degree 2, (cells, additional nodes, d)."""
    x = mesh.points[mesh.cells]
    edges = np.array(EDGES[mesh.cell])
    flat = straight_middles(x, mesh.cell)[:, : len(edges)].reshape(-1, mesh.dimension)
    ends = np.sort(mesh.cells[:, edges].reshape(-1, 2), axis=1)
    for name, centre, radius in rounds:
        on = np.concatenate(list(_facet_edges(mesh, name)))
        at = np.isin(_number(ends, len(mesh.points)), _number(on, len(mesh.points)))
        flat[at] = _onto(flat[at], centre, radius)
    middles = flat.reshape(len(x), len(edges), -1)
    return middles_of(np.concatenate([x, middles], axis=1), mesh.cell)


def _facet_edges(mesh: CellMesh, name: str) -> Iterator[Ints]:
    """Ends of the edges of the facets of a side, (edges, 2), the smaller number first."""
    facets = mesh.topology.facets[mesh.sides[name]]
    count = facets.shape[1]
    for i in range(count if count > 2 else 1):
        yield np.sort(facets[:, [i, (i + 1) % count]], axis=1)


def _number(pairs: Ints, nodes: int) -> Ints:
    """One number for each pair of nodes."""
    return np.asarray(pairs[:, 0] * nodes + pairs[:, 1])
