"""Search for facets and points that lie along the normals of the facets of a surface."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from meshes.arrays import Array, Ints
from meshes.contact_surface import Surface

QUERIES = 50_000
"""Number of balls in one query of the tree."""

LOOSE = 0.5
"""Relative error of distances by which empty balls are found. About the centre of a round surface
all its facets are equally near, and an exact distance is that from each of them."""

SHORT = 2.0
"""Reach over the distance of neighbouring balls up to which one ball covers the whole line: the
same pairs of a hub on a shaft in two thirds of the time."""


def facets_along_normals(
    on: Surface, against: Surface, chosen: Ints, reach: Array | None = None
) -> tuple[Ints, Ints]:
    """Pairs of facets (`chosen` of on, against) whose projections may overlap, sorted.

    The facets lie along the normal of an `on` facet, on both of its sides, at distances up to
    `reach` (facets,) of `chosen`. Without `reach` this is the distance within which a facet lies
    that faces the `on` facet within 60°, if any does.
    """
    if len(chosen) == 0:
        return chosen, chosen
    sizes = against.radii
    level = np.floor(np.log2(sizes / sizes.min() * (1.0 + 1e-9))).astype(int)
    groups = [np.flatnonzero(level == k) for k in np.unique(level)]
    return _along_normals(on, chosen, against.centres, sizes, groups, reach)


def points_along_normals(
    on: Surface, points: Array, chosen: Ints, reach: Array
) -> tuple[Ints, Ints]:
    """Pairs of a facet (`chosen` of on) and a point (points, 3) that may project onto it, sorted.

    The points lie along the normal of the facet, on both of its sides, at distances up to `reach`
    (facets,) of `chosen`.
    """
    if len(chosen) == 0:
        return chosen, chosen
    sizes, every = np.zeros(len(points)), np.arange(len(points))
    return _along_normals(on, chosen, points, sizes, [every], reach)


def _along_normals(
    on: Surface,
    chosen: Ints,
    middles: Array,
    sizes: Array,
    groups: Sequence[Ints],
    reach: Array | None,
) -> tuple[Ints, Ints]:
    """Pairs of some facets and balls near the lines along their normals, sorted.

    Search trees of the middles of the balls are queried at points along the normals. So the work
    grows with the gap over the size of facets, not with its square.

    Parameters
    ----------
    middles, sizes : (balls, 3), (balls,)
        Centres and radii.
    groups
        Balls of like size, each group with a tree of its own.
    """
    centres, radii, normals = on.centres[chosen], on.radii[chosen], on.normals[chosen]
    trees = [cKDTree(middles[group]) for group in groups]
    if reach is None:
        nearest = np.min([tree.query(centres)[0] for tree in trees], axis=0)
        reach = 2.0 * (nearest + radii)
    keys = [np.zeros(0, np.int64)]
    for group, tree in zip(groups, trees, strict=True):
        across = radii + sizes[group].max()
        which, queried, radius = _filled(centres, normals, tree, reach, across)
        for part in _of_like_size(radius):
            balls, largest = cKDTree(queried[part]), radius[part].max()
            hits = balls.sparse_distance_matrix(tree, largest, output_type="ndarray")
            ball = part[hits["i"]]
            within = hits["v"] <= radius[ball]
            keys.append(which[ball[within]] * len(middles) + group[hits["j"][within]])
    i, j = np.divmod(np.unique(np.concatenate(keys)), len(middles))
    across = middles[j] - centres[i]
    across -= np.einsum("ij,ij->i", across, normals[i])[:, None] * normals[i]
    near = np.linalg.norm(across, axis=1) <= (radii[i] + sizes[j]) * (1.0 + 1e-9)
    return chosen[i[near]], j[near]


def _of_like_size(radius: Array) -> list[Ints]:
    """Numbers of balls whose radii differ by less than a factor of two, in parts of `QUERIES`."""
    level = np.floor(np.log2(radius))
    groups = [np.flatnonzero(level == k) for k in np.unique(level)]
    return [part for group in groups
            for part in np.array_split(group, len(group) // QUERIES + 1)]  # fmt: skip


def _filled(
    centres: Array, normals: Array, tree: cKDTree, reach: Array, across: Array
) -> tuple[Ints, Array, Array]:
    """Balls along the normals of facets that may contain some point of a tree.

    Neighbouring balls are `across` (facets,) apart, with a radius of 1.2 times that, from -`reach`
    (facets,) to `reach`. If the centre of a ball is far from all points, the next balls are empty,
    too, and are left out. Lines of short reach have one ball.

    Returns
    -------
    The facet of each ball, its centre and its radius.
    """
    last = np.ceil(2.0 * reach / across).astype(np.int64)
    short = reach <= SHORT * across
    results = [(np.flatnonzero(short), centres[short])]
    facets = np.flatnonzero(~short)
    nth = np.zeros(len(facets), np.int64)
    while len(facets):
        along = nth * across[facets] - reach[facets]
        middles = centres[facets] + along[:, None] * normals[facets]
        away = tree.query(middles, eps=LOOSE)[0] / (1.0 + LOOSE) / across[facets] - 1.2  # in steps
        filled = away <= 1e-9
        results.append((facets[filled], middles[filled]))
        nth += np.maximum(np.ceil(away - 1e-9).astype(np.int64), 1)
        going = nth <= last[facets]
        facets, nth = facets[going], nth[going]
    which, queried = (np.concatenate(part) for part in zip(*results, strict=True))
    return which, queried, np.where(short, np.hypot(reach, across), 1.2 * across)[which]
