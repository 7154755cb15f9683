"""The parts of two surfaces that face each other.

Two parts may lie apart (a gap) or behind each other (an overlap of the bodies). Between a facet and
a facet of the other side behind it both bodies are solid where the bodies overlap. So neither
surface may be crossed in between: a facet of the own surface there is the far side of the own body,
and a facet of the other surface is the near side of the other body. Nor may another part of the
other surface be much nearer: beside the edge of a box that overlaps another one by little, the far
side of the other box lies deep behind the side of the first one.
"""

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from meshes.arrays import Array, Ints
from meshes.contact_surface import Surface
from meshes.facet_overlaps import Overlaps, smallest
from meshes.facet_search import facets_along_normals
from meshes.shares import share

FACING = 0.5
"""Facets face each other if their normals are within 60° of opposite."""

SHALLOW = 0.1
"""Depth of an overlap, over the radius of a facet, up to which nothing lies in between.

Round bodies that touch overlap by some hundredths where their facets are flat.
"""

AT_ITS_END = 1.0 - 1e-6
"""Share of its depth at which a surface still lies within an overlap.

The far sides of two equal boxes, one on the other, lie in one plane.
"""

OBLIQUE = 1.0 / FACING
"""Largest depth along a normal, over the distance from the nearest facet, of facets that face."""

ROUND_OFF = 1e-6
"""Distance, over the radius of a facet, at which two facets lie in one plane."""


class SurfacesApartError(ValueError):
    """The two sides cannot be in contact; the message says why."""


def overlaps(
    on: Surface, against: Surface, tilted: bool = False, comm: MPI.Intracomm = MPI.COMM_SELF
) -> Overlaps:
    """Integrals over the parts of two surfaces that face each other (collective).

    Parameters
    ----------
    tilted
        Whether to compute `Overlaps.tilt`.
    comm
        Ranks that have both surfaces and share the work.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    may_face = facets_that_may_face(on, against)
    i, j = facets_along_normals(on, against, may_face[share(comm, len(may_face))])
    facing = _cosine(on, against, i, j) >= FACING
    pairs = Overlaps.of(on, against, i[facing], j[facing], tilted)
    pairs = _real(on, against, pairs, i[~facing], j[~facing])
    pairs = pairs.nearest_layer(on, against).gathered(comm)
    if len(pairs.i) == 0:
        i, j = facets_along_normals(on, against, share(comm, len(on.nodes)))
        same_way = _cosine(on, against, i, j) < 0.0
        turned = Overlaps.of(on, against, i[same_way], j[same_way]).gathered(comm)
        if len(turned.i):
            raise SurfacesApartError(
                "the two sides face the same way: their outward normals must point at each other"
            )
        raise SurfacesApartError(
            "the two sides never meet: no facet of the first projects, along its normal, onto a "
            "facet of the second that faces it"
        )
    return pairs


def facets_that_may_face(on: Surface, against: Surface) -> Ints:
    """Facets of `on` that some facet of the other side may face, from the cone of its normals.

    Half of a ball does not face a groove; the search would go through the ball for each facet.
    """
    middle = against.normals.sum(axis=0)
    middle /= max(float(np.linalg.norm(middle)), ROUND_OFF)
    along, opposite = against.normals @ middle, -(on.normals @ middle)
    widest = np.arccos(np.clip(along.min(), -1.0, 1.0)) + np.arccos(FACING) + ROUND_OFF
    return np.flatnonzero(np.arccos(np.clip(opposite, -1.0, 1.0)) <= widest)


def _cosine(on: Surface, against: Surface, i: Ints, j: Ints) -> Array:
    """Cosine of the angle from opposite normals of pairs of facets, (pairs,)."""
    return np.asarray(-np.einsum("ij,ij->i", on.normals[i], against.normals[j]))


def _real(on: Surface, against: Surface, pairs: Overlaps, i: Ints, j: Ints) -> Overlaps:
    """The pairs without those between which one of the surfaces lies (module docstring).

    Parameters
    ----------
    i, j : (pairs,)
        The pairs of facets along the normals that do not face each other, sorted.
    """
    depth = -pairs.distance
    deep = depth > SHALLOW * on.radii[pairs.i]
    if not deep.any():
        return pairs
    rows = np.unique(pairs.i[deep])
    reach = np.zeros(len(on.nodes))
    np.maximum.at(reach, pairs.i[deep], depth[deep])
    least = np.zeros(len(on.nodes))
    least[rows] = cKDTree(against.centres).query(on.centres[rows])[0] + on.radii[rows]
    own_i, own_k = facets_along_normals(on, on, rows, reach[rows])
    nearest = np.minimum(
        _nearest_behind(on, on, own_i, own_k, exits=True),
        _nearest_behind(on, against, i, j, exits=False),
    )
    nearest = np.minimum(nearest, OBLIQUE * least)
    return pairs.some(~deep | (AT_ITS_END * nearest[pairs.i] > depth))


def _nearest_behind(on: Surface, other: Surface, i: Ints, j: Ints, exits: bool) -> Array:
    """Depth behind each facet of `on` at which the other surface is crossed, (facets,); or inf.

    Parameters
    ----------
    i, j : (pairs,)
        Facets along the normals, sorted by i.
    exits
        Whether the crossed facets point against the normal of the `on` facet (inwards from it, one
        leaves a body there) or along it (one enters a body there, also at depth 0).
    """
    along = np.einsum("ij,ij->i", on.normals[i], other.normals[j])
    ahead = along < 0.0 if exits else along > 0.0
    crossed = Overlaps.of(on, other, i[ahead], j[ahead])
    depth = -crossed.distance
    before = depth > 0.0 if exits else depth > -ROUND_OFF * on.radii[crossed.i]
    return smallest(crossed.i[before], depth[before], len(on.nodes))
