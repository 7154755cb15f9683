"""The integrals of a mortar method over the overlaps of pairs of facets.

Facets are treated as flat (see `meshes.mortar`): facets of the other side are projected along the
normal of each `on` facet, intersected with it, and the overlap is integrated by Gauss points.
"""

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from meshes.contact_surface import Surface, is_curved
from meshes.quadratic import FACETS
from meshes.shares import joined
from meshes.subdomains import vtk_places, vtk_shapes

COVERED_ONCE = 1.0 + 1e-3
"""Area of all overlaps of a facet, over its own, above which it meets several layers."""

SLIVER = 1e-13
"""Overlaps smaller than this, relative to the facets, are round-off."""

UPRIGHT = 1e-12
"""Deviation of the corners of rectangles, over their sides, that counts as round-off."""

TOUCHING = 1e-12
"""Gap, over the size of a facet, that is round-off: nothing is tilted where the sides touch."""

FITTING = 0.2
"""Curvature of a gap, over the sum of those of both sides, up to which one fits into the other.

Curvatures across facets of a fifteenth of a circle are off by up to a tenth: a hub on a shaft, with
an interference of a sixteenth of h²/8R, had a peak 15 % too high."""

EQUAL = 1e-12
"""Difference of two places, over the size of a facet, that counts as round-off."""

PAIRS = 50_000
"""Number of pairs of facets intersected at once; a pair takes some kilobytes."""


@dataclass(frozen=True, eq=False)
class Overlaps:
    """Integrals over the overlap of each pair of facets."""

    i: Ints
    j: Ints
    """Facets of the two sides. Shape (pairs,)."""
    area: Array  # (pairs,)
    """Area of each overlap."""
    mass: Array  # (pairs, v, n)
    """∫ φ_k N_l, with the shape functions φ of the v vertices and N of all nodes of the facet."""
    shared: Array  # (pairs, v, m)
    """∫ φ_k N'_l, with N' of the nodes of the facet on the other side."""
    weight: Array  # (pairs, v)
    """∫ φ_k."""
    gap: Array  # (pairs, v)
    """∫ φ_k g, with the gap g."""
    tilt: Array  # (pairs, v, d - 1, n)
    """∫ φ_k g ∂_a N_l along the axes of the `on` facet; without axes if not requested."""

    @classmethod
    def of(
        cls, on: Surface, against: Surface, i: Ints, j: Ints, tilted: bool = False
    ) -> "Overlaps":
        """The overlaps among pairs of facets (n,), (n,), sorted by i; pairs apart are left out.

        On grids the integrals are computed once for all pairs of one offset.
        """
        repeated = _repeated(on, against, i, j)
        first, kind = (slice(None), None) if repeated is None else repeated
        parts = np.array_split(np.arange(len(i[first])), len(i[first]) // PAIRS + 1)
        groups = [cls._some(on, against, i[first][part], j[first][part], tilted) for part in parts]
        joined = zip(*(part.__dict__.values() for part in groups), strict=True)
        distinct = cls(*(np.concatenate(values) for values in joined))
        if kind is None:
            return distinct
        count = len(against.nodes)
        meet = np.isin((i * count + j)[first], distinct.i * count + distinct.j)
        every = np.flatnonzero(meet[kind])
        return replace(distinct.some((np.cumsum(meet) - 1)[kind[every]]), i=i[every], j=j[every])

    @classmethod
    def _some(cls, on: Surface, against: Surface, i: Ints, j: Ints, tilted: bool) -> "Overlaps":
        """Project, intersect, integrate."""
        axes = np.ascontiguousarray(on.frames.transpose(0, 2, 1))
        here = (on.points - on.centres[:, None]) @ axes
        other_side = (against.points[j] - on.centres[i][:, None]) @ axes[i]
        lower, upper = (bound[i] for bound in _bounds(here))
        other_lower, other_upper = _bounds(other_side)
        separate = (upper < other_lower) | (other_upper < lower)
        near = ~separate[:, :-1].any(axis=1)  # by their boxes in the plane
        i, j, other_side = i[near], j[near], other_side[near]
        here = here[i]
        v, w = on.vertices.shape[1], against.vertices.shape[1]
        flat, other = here[:, :v, :-1], other_side[:, :w, :-1]
        linear = (here.shape[1], other_side.shape[1]) == (v, w) and on.bulge is None
        curved = is_curved(here, v) or is_curved(other_side, w)
        cut = _segments if on.dimension == 2 else _polygons
        if on.bulge is None and _upright(flat) and _upright(other):
            cut = _rectangles
        pair, x, weights = cut(flat, other, linear, curved)
        plane = here[pair, :, :-1]
        phi, own_shapes, slopes = on_facets(plane, x, is_curved(here, v))
        facet = other_side[pair, :, :-1]
        vertex_shapes, node_shapes, _ = on_facets(facet, x, is_curved(other_side, w))
        gap = np.einsum("qv,qv->q", node_shapes, other_side[pair, :, -1])
        gap -= np.einsum("qv,qv->q", own_shapes, here[pair, :, -1])
        gap -= against.height(j[pair], vertex_shapes) + _own_height(on, against, i, j, pair, phi)
        tilts = tilted and bool((np.abs(gap) > TOUCHING * on.radii[i[pair]]).any())
        if tilts:
            slopes = np.linalg.solve(slopes @ plane, slopes)
        distinct, start = np.unique(pair, return_index=True)

        def integrate(values: Array) -> Array:
            weighted = values * weights.reshape(-1, *(1,) * (values.ndim - 1))
            return np.add.reduceat(weighted, start) if len(start) else weighted[:0]

        tilt = np.zeros((len(distinct), v, slopes.shape[1] if tilted else 0, slopes.shape[2]))
        if tilts:
            tilt = integrate(phi[:, :, None, None] * (gap[:, None, None] * slopes)[:, None])
        return cls(
            i=i[distinct],
            j=j[distinct],
            area=integrate(np.ones(len(weights))),
            mass=integrate(phi[:, :, None] * own_shapes[:, None, :]),
            shared=integrate(phi[:, :, None] * node_shapes[:, None, :]),
            weight=integrate(phi),
            gap=integrate(phi * gap[:, None]),
            tilt=tilt,
        )

    def gathered(self, comm: MPI.Intracomm) -> "Overlaps":
        """The overlaps of all ranks, in the order of ranks (collective)."""
        return Overlaps(**{name: joined(comm, values) for name, values in self.__dict__.items()})

    @property
    def distance(self) -> Array:
        """Mean gap of each pair, negative where the bodies overlap, (pairs,)."""
        return self.gap.sum(axis=1) / self.area

    def nearest_layer(self, on: Surface, against: Surface) -> "Overlaps":
        """The overlaps with the nearest layer where `on` facets meet several layers.

        Layers farther than the nearest one by four radii of the facet are left out. Where two
        layers are nearer to each other than that, the facets of a layer are those connected by
        common nodes among the facets that overlap the `on` facet.
        """
        distance = np.abs(self.distance)
        nearest = smallest(self.i, distance, len(on.nodes))
        near = self.some(distance <= nearest[self.i] + 4.0 * on.radii[self.i])
        several = near.on_several_layers(on)
        if not several.any():
            return near
        layer = near._layers(against, several)
        of_layer = smallest(layer, np.abs(near.distance), layer.max() + 1)
        return near.some(~several[near.i] | (of_layer[layer] <= nearest[near.i]))

    def on_several_layers(self, on: Surface) -> Mask:
        """Mask of the `on` facets that meet several layers, (facets,)."""
        covered = np.bincount(self.i, self.area, minlength=len(on.nodes))
        return np.asarray(covered > COVERED_ONCE * on.areas)

    def _layers(self, against: Surface, several: Mask) -> Ints:
        """Number of the layer of each overlap on the facets `several` (facets,), (pairs,).

        Overlaps on other facets have the number 0.
        """
        pairs = np.flatnonzero(several[self.i])
        nodes = against.nodes[self.j[pairs]]
        at = self.i[pairs, None] * (against.nodes.max() + 1) + nodes
        distinct, number = np.unique(at, return_inverse=True)
        ends = np.repeat(np.arange(len(pairs)), nodes.shape[1]), len(pairs) + number.ravel()
        layer = np.zeros(len(self.i), np.int64)
        layer[pairs] = 1 + connected(ends, len(pairs) + len(distinct))[: len(pairs)]
        return layer

    def some(self, chosen: Mask | Ints) -> "Overlaps":
        """The overlaps that a mask (pairs,), or numbers, choose."""
        return Overlaps(**{name: values[chosen] for name, values in self.__dict__.items()})


def _repeated(on: Surface, against: Surface, i: Ints, j: Ints) -> tuple[Ints, Ints] | None:
    """One pair of each offset between surfaces of equal facets, and the offset's number, (n,).

    None where facets differ, or most offsets.
    """
    for side in (on, against):
        shapes = side.points - side.centres[:, None]
        if side.bulge is not None or (np.abs(shapes - shapes[0]) > EQUAL * side.radii[0]).any():
            return None
    offset = np.rint((against.centres[j] - on.centres[i]) / (EQUAL * on.radii[0]))
    order = np.lexsort(offset.T)
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(offset[order], axis=0) != 0.0).any(axis=1)
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(new) - 1
    return None if 2 * new.sum() > len(new) else (order[new], number)


def _own_height(
    on: Surface, against: Surface, i: Ints, j: Ints, pair: Ints, phi: Array
) -> Array | float:
    """Height to take from the gap at points of `on` facets (q,) with hats φ (q, v).

    Displacements of first order are linear on the facet, so the gap must be, too: the mean of a
    curved gap with a dual function is below all its values, by h²/6R for a facet with an end on a
    circle of radius R. So the height is that of the `on` side less the curvature of the gap, and
    the gap is linear between its values at the vertices, which lie on the smooth surface. Where
    one side fits into the other, the gap has hardly any curvature but errors of the fits, which are
    left out. Displacements of second order follow a curved gap.
    """
    if on.bulge is None or on.nodes.shape[1] > phi.shape[1]:
        return on.height(i[pair], phi)
    both = on.bulge[i], against.bulge_over(j, on.vertices[i])
    curved = both[0] + both[1]
    curved[np.abs(curved) <= FITTING * (np.abs(both[0]) + np.abs(both[1]))] = 0.0
    return 0.5 * np.einsum("qa,qab,qb->q", phi, (both[0] - curved)[pair], phi)


def smallest(index: Ints, values: Array, count: int) -> Array:
    """The smallest value with each index, (count,); infinite without one."""
    result = np.full(count, np.inf)
    np.minimum.at(result, index, values)
    return result


def _bounds(points: Array) -> tuple[Array, Array]:
    """Smallest and largest coordinates of sets of points (n, k, d), (n, d) each.

    One point after another: numpy reduces short axes slowly.
    """
    lower = upper = points[:, 0]
    for k in range(1, points.shape[1]):
        lower, upper = np.minimum(lower, points[:, k]), np.maximum(upper, points[:, k])
    return lower, upper


def _segments(flat: Array, other: Array, linear: bool, curved: bool) -> tuple[Ints, Array, Array]:
    """Gauss points of the overlap of segments (n, 2, 1): pair, coordinate (q, 1), weight.

    Two points (exact for degree 3) are enough also for straight facets of second order.
    """
    at, share = np.polynomial.legendre.leggauss(5 if curved else 2)
    lower = np.maximum(flat.min(axis=1), other.min(axis=1))[:, 0]
    upper = np.minimum(flat.max(axis=1), other.max(axis=1))[:, 0]
    size = np.ptp(flat, axis=1)[:, 0]
    pair = np.flatnonzero(upper - lower > SLIVER * size)
    half, middle = 0.5 * (upper - lower)[pair], 0.5 * (upper + lower)[pair]
    x = middle[:, None] + half[:, None] * at
    return np.repeat(pair, len(at)), x.reshape(-1, 1), (half[:, None] * share).ravel()


def _upright(polygons: Array) -> bool:
    """Whether all polygons (n, v, d - 1) are rectangles along the axes."""
    if polygons.shape[1:] != (4, 2) or not len(polygons):
        return False
    lower, upper = _bounds(polygons)
    off = np.minimum(polygons - lower[:, None], upper[:, None] - polygons)
    return bool((off <= UPRIGHT * (upper - lower)[:, None]).all())


def _rectangles(flat: Array, other: Array, linear: bool, curved: bool) -> tuple[Ints, Array, Array]:
    """Like `_polygons` for rectangles along the axes, with a third of the points."""
    at, share = np.polynomial.legendre.leggauss(5 if curved else 2 if linear else 3)
    (begin, end), (other_begin, other_end) = _bounds(flat), _bounds(other)
    lower = np.maximum(begin, other_begin)
    half = 0.5 * (np.minimum(end, other_end) - lower)
    pair = np.flatnonzero((half > SLIVER * (end - begin)).all(axis=1))
    lower, half = lower[pair], half[pair]
    at = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    x = (lower + half)[:, None] + half[:, None] * at
    weights = half.prod(axis=1)[:, None] * np.outer(share, share).ravel()
    return np.repeat(pair, len(at)), x.reshape(-1, 2), weights.ravel()


def _polygons(flat: Array, other: Array, linear: bool, curved: bool) -> tuple[Ints, Array, Array]:
    """Gauss points of the overlap of convex polygons (n, v, 2): pair, coordinates, weight."""
    polygon, count = clip(flat, other)
    pairs, parts = [], []
    for k in range(1, polygon.shape[1] - 1):
        have = np.flatnonzero(count > k + 1)
        pairs.append(have)
        parts.append(polygon[have][:, [0, k, k + 1]])
    pair, triangle = np.concatenate(pairs), np.concatenate(parts)
    edges = triangle[:, 1:] - triangle[:, :1]
    area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    lower, upper = _bounds(flat)
    size = (upper - lower).max(axis=1) ** 2
    solid = area > SLIVER * size[pair]
    order = np.argsort(pair[solid], kind="stable")
    pair, triangle, area = pair[solid][order], triangle[solid][order], area[solid][order]
    at, weights = dolfinx_compat.quadrature(
        "triangle", 8 if curved else _degree(linear, flat, other)
    )
    x = triangle[:, :1] + at @ edges[solid][order]
    w = 2.0 * area[:, None] * weights
    return np.repeat(pair, len(weights)), x.reshape(-1, 2), w.ravel()


def _degree(linear: bool, *polygons: Array) -> int:
    """Degree of the product of shape functions of both sides."""
    if all(p.shape[1] == 3 for p in polygons):
        return 2 if linear else 4
    for p in polygons:
        if p.shape[1] == 4:
            skew = np.abs(p[:, 0] - p[:, 1] + p[:, 2] - p[:, 3]).max(initial=0.0)
            if skew > 1e-12 * np.abs(p).max(initial=0.0):
                return 8
    return 4 if linear else 8


def clip(window: Array, subject: Array) -> tuple[Array, Ints]:
    """Intersect convex polygons pair by pair (Sutherland, Hodgman, CACM 17 (1974)).

    Parameters
    ----------
    window : (n, v, 2)
        Anticlockwise.
    subject : (n, w, 2)

    Returns
    -------
    Vertices (n, k, 2), of which the first `count` (n,) are valid. Rounding errors may repeat
    some, so that a polygon can have more than v + w.
    """
    (n, v), chosen = window.shape[:2], np.arange(len(window))
    # complex numbers: half as many arrays as with two coordinates
    corners, polygon = (np.ascontiguousarray(x).view(complex)[..., 0] for x in (window, subject))
    count = np.full(n, subject.shape[1])
    for edge in range(v):
        start, end = corners[chosen, edge], corners[chosen, (edge + 1) % v]
        along, away = (end - start)[:, None], polygon - start[:, None]
        side = along.real * away.imag - along.imag * away.real
        place, some = np.arange(polygon.shape[1]), count[chosen, None]
        valid, ends = place < some, place + 1 >= some
        next_side, next_point = (
            np.where(ends, x[:, :1], np.roll(x, -1, axis=1)) for x in (side, polygon)
        )
        inside = side >= 0.0
        crossing = valid & (inside != (next_side >= 0.0))
        share = side / np.where(crossing, side - next_side, 1.0)
        cut = polygon + share * (next_point - polygon)
        keep = np.stack([valid & inside, crossing], axis=2)
        count[chosen] = made = keep.sum(axis=(1, 2))
        points = np.stack([polygon, cut], axis=2)[keep]
        chosen, made = chosen[made > 0], made[made > 0]  # others have no part in common
        polygon = np.zeros((len(chosen), max(made.max(initial=0), 3)), complex)
        polygon[np.arange(polygon.shape[1]) < made[:, None]] = points
    result = np.zeros((n, polygon.shape[1], 2))
    result[chosen] = polygon[..., None].view(float)
    return result, count


def on_facets(nodes: Array, x: Array, curved: bool) -> tuple[Array, Array, Array]:
    """Shape functions of the vertices (linear) and of all nodes, at points of the plane.

    Parameters
    ----------
    nodes : (q, n, d - 1)
        Projected nodes of the facet of each point.
    x : (q, d - 1)
    curved
        Whether a node lies off the middle of its vertices.

    Returns
    -------
    Values (q, v) and (q, n), and derivatives of the latter in the reference facet (q, d - 1, n).
    """
    cell, vertices, degree = FACETS[x.shape[1] + 1, nodes.shape[1]]
    if curved:
        place = vtk_places(cell, degree, nodes, x)
    else:
        place = vtk_places(cell, 1, nodes[:, :vertices], x)
    vertex_shapes = vtk_shapes(cell, 1, place)
    return vertex_shapes[0], *(vtk_shapes(cell, degree, place) if degree > 1 else vertex_shapes)
