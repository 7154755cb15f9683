"""Finer meshes of bodies from files: edges are halved, and round contacts stay round.

`round: true` of a contact takes its boundaries for smooth surfaces through the vertices. Midpoints
of their straight edges are no vertices of these surfaces, so they are moved there
(`meshes.rounded_refinement`); all other boundaries stay the polygons and polyhedra of the file.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.bodies import Body
from meshes.bisect import bisected
from meshes.refine import refined
from meshes.rounded_refinement import rounded
from meshes.unstructured import CellMesh


def halved(
    body: Body, round_boundaries: Iterable[str], marked: NDArray[np.int64] | None = None
) -> Body:
    """The body with the edges of its mesh halved.

    Parameters
    ----------
    round_boundaries
        Names of its boundaries in contacts with `round: true`.
    marked : (n,)
        Cells whose edges are halved, with further edges of their neighbours; None for all cells.
    """
    mesh = body.mesh
    assert isinstance(mesh, CellMesh)
    rows = [facets_on(mesh, body, name) for name in round_boundaries]
    finer = refined(mesh) if marked is None else bisected(mesh, marked)
    facets = np.unique(np.concatenate([np.zeros(0, np.int64), *rows]))
    return replace(body, mesh=rounded(finer, mesh, facets))


def facets_on(mesh: CellMesh, body: Body, boundary: str) -> NDArray[np.int64]:
    """Rows of ``mesh.topology.facets`` with all vertices on a boundary; none if it is unknown.

    Parameters
    ----------
    mesh
        That of the body, or the one from which it was refined.
    """
    if boundary not in body.boundaries:
        return np.asarray(mesh.sides.get(boundary, ()), np.int64)
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dimension)))
    inside = body.boundaries[boundary](points)[mesh.topology.facets].all(axis=1)
    for name in set(body.cuts) & set(mesh.sides):
        inside[mesh.sides[name]] = False
    return np.flatnonzero(inside)
