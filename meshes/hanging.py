"""Nodes that hang on an edge or face of a cell that does not have them as corners."""

import numpy as np
from mpi4py import MPI

from meshes.arrays import Array, Ints, Mask, distinct_numbers
from meshes.crossing import Boxes, points_in_boxes
from meshes.shares import joined, share
from meshes.unstructured import MeshError

HANGING = 1e-6
"""Distance to a facet, over its size, below which a node of other cells counts as hanging on it."""


def refuse_hanging(points: Array, facets: Ints, comm: MPI.Intracomm) -> None:
    """Refuse nodes that lie on a facet without being one of its corners (collective).

    Parameters
    ----------
    facets : (facets, corners)
        The facets of the surface that may touch others.
    """
    if len(facets) == 0:
        return
    surface = distinct_numbers(facets)
    axis = np.argmax(np.ptp(points[surface], axis=0))
    surface = surface[np.argsort(points[surface, axis])[share(comm, len(surface))]]
    corners = points[facets]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    room = HANGING * radius[:, None]
    boxes = Boxes(corners.min(axis=1) - room, corners.max(axis=1) + room)
    near = [np.zeros((2, 0), np.int64)]
    for node, row in points_in_boxes(points[surface], boxes):
        other = (facets[row] != surface[node, None]).all(axis=1)
        near.append(np.stack([row[other], surface[node[other]]]))
    row, node = np.concatenate(near, axis=1)
    split = ((0, 1),) if facets.shape[1] == 2 else ((0, 1, 2), (0, 2, 3))[: facets.shape[1] - 2]
    on = np.zeros(len(row), bool)
    for part in split:
        on |= _lies_on(points[node], corners[row][:, np.array(part)], radius[row])
    hanging = np.unique(joined(comm, node[on]))
    if len(hanging):
        place = ", ".join(f"{v:g}" for v in points[hanging[0]])
        raise MeshError(
            f"has {len(hanging)} hanging nodes: they lie on an edge or face of a cell "
            f"that does not have them as corners, the first at ({place}); make the mesh conforming "
            "(in Gmsh: BooleanFragments or Coherence before meshing), or make parts that were "
            "meshed apart bodies of their own, whose cells `group` names"
        )


def _lies_on(x: Array, simplex: Array, size: Array) -> Mask:
    """Mask (n,) of points (n, d) on segments or triangles (n, d or less, d)."""
    origin, axes = simplex[:, 0], simplex[:, 1:] - simplex[:, :1]
    gram = axes @ np.swapaxes(axes, 1, 2)
    right = np.einsum("nkd,nd->nk", axes, x - origin)
    sound = np.linalg.det(gram) > 0.0
    weights = np.full(right.shape, np.nan)
    weights[sound] = np.linalg.solve(gram[sound], right[sound][..., None])[..., 0]
    foot = origin + np.einsum("nk,nkd->nd", weights, axes)
    inside = (weights >= -HANGING).all(axis=1) & (weights.sum(axis=1) <= 1.0 + HANGING)
    return np.asarray(inside & (np.linalg.norm(x - foot, axis=1) <= HANGING * size))
