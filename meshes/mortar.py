"""Mortar contact of two meshed surfaces: averages of the gap that non-matching meshes can meet.

The pressure between two bodies is a field on the side that carries the multipliers (the contact's
`on`), p = Σ p_j ψ_j with one value a node, and the bodies do not penetrate on the average over
each ψ_j:

    ∫ ψ_j n·(u_on - u_against) ≤ ∫ ψ_j g,    g = n·(x_against - x_on),

with n the outward normal of the `on` side and x_against the point of the other side that n meets.
Divided by W_j = ∫ ψ_j that is a mean gap, and its multiplier p_j W_j a force.

Projection. Every `on` facet is taken for flat: n is constant on it and the facets of the other
side are projected along n onto its plane, where the two are intersected (segments in 2D, convex
polygons cut into triangles in 3D) and integrated by Gauss points that are exact for triangles and
parallelograms (M. A. Puso, A 3D mortar method for solid mechanics, IJNME 59 (2004)). Where
surfaces are round and edges straight the integrals see the polyhedra, whose distance from the
smooth surfaces is of second order in the size of facets; facets of the second order with curved
edges are taken as they are, with the point of either that projects to each Gauss point, and are of
fourth order there. The jump x_against - x_on has the direction of n, so that rows
do not see any rigid motion of both bodies together: forces and moments balance to round-off.

Multipliers. On facets the other side covers wholly the ψ_j are dual to the shape functions,
∫ ψ_j φ_k = δ_jk ∫ φ_k (B. Wohlmuth, A mortar finite element method using dual spaces for the
Lagrange multiplier, SINUM 38 (2000)): a row has one `on` node, and matching meshes reduce to node
pairs. On facets covered in part, where dual functions grow without bound, they are the shape
functions themselves, as they are on facets of the second order, where multipliers live on the
vertices and displacements on all nodes. All of them add up to one, so a constant pressure is
transmitted exactly. A node whose share is hardly covered gives its row to its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from meshes import dolfinx_compat
from meshes.quadratic import FACETS
from meshes.smooth_surface import bulges
from meshes.subdomains import vtk_places, vtk_shapes

FACING = 0.5
"""Facets face each other if their normals are within 60° of opposite."""

COVERED = 1.0 - 1e-6
"""Share of a facet from which it counts as covered."""

WEAK = 0.01
"""Share of a node's area below which its row is given to its neighbours.

Such rows are nearly those of their neighbours, and the multipliers nearly undetermined; but rows
that are not nearly so must stay, since a small body may stand on the nodes of one facet.
"""

NEGLIGIBLE = 1e-13
"""Entries of a row, which is of order one, that are round-off."""

SLIVER = 1e-13
"""Overlaps smaller than this, relative to the facets, are round-off."""

STRAIGHT = 1e-9
"""Distance of a middle from that of its vertices, over the size of facets, that is round-off."""

QUERIES = 200_000
"""Points asked of the tree at a time."""

PAIRS = 50_000
"""Pairs of facets intersected at a time; some kilobytes each."""


class SurfacesApartError(ValueError):
    """The two sides have nothing to do with each other; the message says why."""


@dataclass(frozen=True, eq=False)
class Surface:
    """One side of a contact.

    Attributes
    ----------
    dimension
        2 for lines, 3 for triangles and quadrilaterals.
    nodes : (facets, nodes a facet)
        Global nodes: the vertices, anticlockwise seen from outside; of the second order also the
        middles of the edges that start in each vertex, and of a quadrilateral its own.
    points : (facets, nodes a facet, 3)
        Coordinates.
    normals : (facets, 3)
        Outward unit normal of the vertices; of a warped quadrilateral that of its diagonals.
    bulge : (facets, v, v) or None
        Where the facets stand for a smooth surface: its height over them is ½ φᵀ bulge φ.
    """

    dimension: int
    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    bulge: NDArray[np.float64] | None = None

    @classmethod
    def of(
        cls,
        dimension: int,
        nodes: NDArray[np.int64],
        points: NDArray[np.float64],
        inside: NDArray[np.float64],
    ) -> Surface:
        """Order and orient facets.

        Parameters
        ----------
        nodes, points
            As the attributes, the vertices first, otherwise in any order.
        inside : (facets, 3)
            A point of the body behind each facet.
        """
        order = np.lexsort(np.sort(nodes, axis=1).T)
        nodes, points, inside = nodes[order], points[order], inside[order]
        v = FACETS[dimension, nodes.shape[1]].vertices
        place = np.tile(np.arange(nodes.shape[1]), (len(nodes), 1))
        if v == 4:
            place[:, :v] = _around(points[:, :v])
        normals = _normals(np.take_along_axis(points, place[:, :v, None], axis=1))
        inward = np.einsum("ij,ij->i", normals, points[:, :v].mean(axis=1) - inside) < 0.0
        normals[inward] *= -1.0
        place[inward, :v] = place[inward, v - 1 :: -1]
        if nodes.shape[1] > v:
            vertices = np.take_along_axis(points, place[:, :v, None], axis=1)
            place[:, v:] = v + _middles(vertices, points[:, v:])
        return cls(
            dimension,
            np.take_along_axis(nodes, place, axis=1),
            np.take_along_axis(points, place[..., None], axis=1),
            normals,
        )

    def smooth(self) -> Surface:
        """The same with the heights of the smooth surface; as it is where edges are curved."""
        v = self.vertices.shape[1]
        if _curved(self.points, v):
            return self
        return replace(self, bulge=bulges(self.nodes[:, :v], self.vertices, self.normals))

    def height(
        self, facets: NDArray[np.int64], hats: NDArray[np.float64]
    ) -> NDArray[np.float64] | float:
        """Of the smooth surface over points of facets (q,) with hats (q, v)."""
        if self.bulge is None:
            return 0.0
        return 0.5 * np.einsum("qa,qab,qb->q", hats, self.bulge[facets], hats)

    @property
    def vertices(self) -> NDArray[np.float64]:
        """Coordinates of the vertices, (facets, vertices, 3)."""
        return self.points[:, : FACETS[self.dimension, self.nodes.shape[1]].vertices]

    @property
    def centres(self) -> NDArray[np.float64]:
        """Mean of the vertices of each facet, (facets, 3)."""
        return self.vertices.mean(axis=1)

    @property
    def radii(self) -> NDArray[np.float64]:
        """Largest distance of a vertex from the centre, (facets,)."""
        away = self.vertices - self.centres[:, None]
        return np.linalg.norm(away, axis=2).max(axis=1)


@dataclass(frozen=True, eq=False)
class MeanGaps:
    """Rows Σ value · u[node, component] ≤ gap, one for each multiplier.

    Attributes
    ----------
    nodes, points : (rows,), (rows, 3)
        The `on` node a row belongs to, and where it is.
    areas : (rows,)
        W_j: multiplier = mean pressure times W_j.
    gaps : (rows,)
        Mean gap, negative where the bodies overlap.
    normals : (rows, dimension)
        Mean normal out of the other body: force on the `on` body for a multiplier of one.
    moments : (rows, 3)
        Moment of that force about the row's node.
    row, node, component, value : (entries,)
        The rows, sorted; values on `on` nodes add up to a mean of n.
    entry_points : (entries, 3)
        Coordinates of the nodes.
    """

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    areas: NDArray[np.float64]
    gaps: NDArray[np.float64]
    normals: NDArray[np.float64]
    moments: NDArray[np.float64]
    row: NDArray[np.int64]
    node: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]
    entry_points: NDArray[np.float64]


def mean_gaps(on: Surface, against: Surface) -> MeanGaps:
    """The mortar rows of two surfaces.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    return _rows(on, against, overlaps(on, against))


def overlaps(on: Surface, against: Surface, tilted: bool = False) -> Overlaps:
    """Integrals over the parts of two surfaces that face each other.

    Parameters
    ----------
    tilted
        Whether `Overlaps.tilt` is asked for.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    i, j = _candidates(on, against)
    cosine = -np.einsum("ij,ij->i", on.normals[i], against.normals[j])
    facing = cosine >= FACING
    found = Overlaps.of(on, against, i[facing], j[facing], tilted)
    if len(found.i) == 0:
        turned = Overlaps.of(on, against, i[cosine < 0.0], j[cosine < 0.0])
        if len(turned.i):
            raise SurfacesApartError(
                "the two sides face the same way: their outward normals must point at each other"
            )
        raise SurfacesApartError(
            "the two sides never meet: no facet of the first projects, along its normal, onto a "
            "facet of the second that faces it"
        )
    return found


# --- which facets may meet -----------------------------------------------------------------------


def _candidates(on: Surface, against: Surface) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of facets (on, against) near enough for their projections to overlap.

    The facets looked for lie along the normal of an `on` facet, not farther than the nearest
    point of facets within 60° of facing it can be. Trees of the other side's centres, one for
    each size of facets, are asked at points along the normal, so that the work grows with the
    gap over the size and not with its square.
    """
    centres, radii = on.centres, on.radii
    middles, sizes = against.centres, against.radii
    level = np.floor(np.log2(sizes / sizes.min() * (1.0 + 1e-9))).astype(int)
    groups = [np.flatnonzero(level == k) for k in np.unique(level)]
    trees = [cKDTree(middles[group]) for group in groups]
    nearest = np.min([tree.query(centres)[0] for tree in trees], axis=0)
    reach = 2.0 * (nearest + radii)
    pairs: list[NDArray[np.int64]] = []
    for group, tree in zip(groups, trees, strict=True):
        across = radii + sizes[group].max()
        steps = np.ceil(2.0 * reach / across).astype(np.int64) + 1
        for part in np.array_split(np.arange(len(steps)), int(steps.sum()) // QUERIES + 1):
            if len(part) == 0:
                continue
            which = np.repeat(part, steps[part])
            nth = np.arange(len(which)) - np.repeat(np.cumsum(steps[part]) - steps[part],
                                                    steps[part])  # fmt: skip
            along = -reach[which] + nth * across[which]
            asked = centres[which] + along[:, None] * on.normals[which]
            hits = tree.query_ball_point(asked, 1.2 * across[which])
            count = np.fromiter((len(h) for h in hits), np.int64, len(hits))
            if count.sum() == 0:
                continue
            there = group[np.concatenate([np.asarray(h, np.int64) for h in hits if h])]
            pairs.append(np.unique(np.stack([np.repeat(which, count), there], axis=1), axis=0))
    joined = np.unique(np.concatenate(pairs), axis=0) if pairs else np.zeros((0, 2), np.int64)
    return joined[:, 0], joined[:, 1]


# --- overlaps and their integrals ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Overlaps:
    """Integrals over the overlap of each pair of facets.

    Attributes
    ----------
    i, j : (pairs,)
        Facets of the two sides.
    area : (pairs,)
    own : (pairs, v, n), shared : (pairs, v, m), weight : (pairs, v), gap : (pairs, v)
        ∫ φ_k N_l, ∫ φ_k N'_l with N' of the other side, ∫ φ_k and ∫ φ_k g; φ the shape functions
        of the v vertices, N those of all nodes.
    tilt : (pairs, v, d - 1, n)
        ∫ φ_k g ∂_a N_l along the axes of the `on` facet; without axes where it is not asked for.
    """

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    area: NDArray[np.float64]
    own: NDArray[np.float64]
    shared: NDArray[np.float64]
    weight: NDArray[np.float64]
    gap: NDArray[np.float64]
    tilt: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        on: Surface,
        against: Surface,
        i: NDArray[np.int64],
        j: NDArray[np.int64],
        tilted: bool = False,
    ) -> Overlaps:
        """The overlaps among pairs of facets (n,), (n,), sorted by i; others are dropped."""
        parts = np.array_split(np.arange(len(i)), len(i) // PAIRS + 1)
        found = [cls._some(on, against, i[part], j[part], tilted) for part in parts]
        joined = zip(*(part.__dict__.values() for part in found), strict=True)
        return cls(*(np.concatenate(values) for values in joined)).nearest_layer(on)

    @classmethod
    def _some(
        cls,
        on: Surface,
        against: Surface,
        i: NDArray[np.int64],
        j: NDArray[np.int64],
        tilted: bool,
    ) -> Overlaps:
        """Project, intersect, integrate."""
        frame = frames(on)[i]
        origin = on.centres[i][:, None]
        here = np.einsum("pvk,pdk->pvd", on.points[i] - origin, frame)
        there = np.einsum("pvk,pdk->pvd", against.points[j] - origin, frame)
        apart = (here.max(axis=1) < there.min(axis=1)) | (there.max(axis=1) < here.min(axis=1))
        near = ~apart[:, :-1].any(axis=1)  # by their boxes in the plane
        here, there, i, j = here[near], there[near], i[near], j[near]
        v, w = on.vertices.shape[1], against.vertices.shape[1]
        flat, other = here[:, :v, :-1], there[:, :w, :-1]
        linear = (here.shape[1], there.shape[1]) == (v, w) and on.bulge is None
        curved = _curved(here, v) or _curved(there, w)
        cut = _segments if on.dimension == 2 else _polygons
        pair, x, weights = cut(flat, other, linear, curved)
        plane = here[pair, :, :-1]
        phi, mine, slopes = on_facets(plane, x, _curved(here, v))
        hats, theirs, _ = on_facets(there[pair, :, :-1], x, _curved(there, w))
        gap = np.einsum("qv,qv->q", theirs, there[pair, :, -1])
        gap -= np.einsum("qv,qv->q", mine, here[pair, :, -1])
        gap -= on.height(i[pair], phi) + against.height(j[pair], hats)
        slopes = np.linalg.solve(slopes @ plane, slopes) if tilted else slopes[:, :0]
        kept, start = np.unique(pair, return_index=True)

        def integrate(values: NDArray[np.float64]) -> NDArray[np.float64]:
            weighted = values * weights.reshape(-1, *(1,) * (values.ndim - 1))
            return np.add.reduceat(weighted, start) if len(start) else weighted[:0]

        return cls(
            i=i[kept],
            j=j[kept],
            area=integrate(np.ones(len(weights))),
            own=integrate(phi[:, :, None] * mine[:, None, :]),
            shared=integrate(phi[:, :, None] * theirs[:, None, :]),
            weight=integrate(phi),
            gap=integrate(phi * gap[:, None]),
            tilt=integrate(phi[:, :, None, None] * (gap[:, None, None] * slopes)[:, None]),
        )

    def nearest_layer(self, on: Surface) -> Overlaps:
        """Of facets one behind the other keep the layer nearest to each `on` facet."""
        distance = np.abs(self.gap.sum(axis=1) / self.area)
        nearest = np.full(len(on.nodes), np.inf)
        np.minimum.at(nearest, self.i, distance)
        keep = distance <= nearest[self.i] + 4.0 * on.radii[self.i]
        return Overlaps(**{name: values[keep] for name, values in self.__dict__.items()})


def frames(surface: Surface) -> NDArray[np.float64]:
    """Orthonormal axes of each facet, tangents first, the normal last, (facets, d, 3)."""
    normals = surface.normals
    along = surface.vertices[:, 1] - surface.vertices[:, 0]
    along = along - np.einsum("ij,ij->i", along, normals)[:, None] * normals
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    if surface.dimension == 2:
        return np.stack([along, normals], axis=1)
    return np.stack([along, np.cross(normals, along), normals], axis=1)


def _segments(
    flat: NDArray[np.float64], other: NDArray[np.float64], linear: bool, curved: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Gauss points of the overlap of segments (n, 2, 1): pair, coordinate (q, 1), weight.

    Two, which integrate degree 3, are enough for the second order, too, if it is straight.
    """
    at, share = np.polynomial.legendre.leggauss(5 if curved else 2)
    lower = np.maximum(flat.min(axis=1), other.min(axis=1))[:, 0]
    upper = np.minimum(flat.max(axis=1), other.max(axis=1))[:, 0]
    size = np.ptp(flat, axis=1)[:, 0]
    pair = np.flatnonzero(upper - lower > SLIVER * size)
    half, middle = 0.5 * (upper - lower)[pair], 0.5 * (upper + lower)[pair]
    x = middle[:, None] + half[:, None] * at
    return np.repeat(pair, len(at)), x.reshape(-1, 1), (half[:, None] * share).ravel()


def _polygons(
    flat: NDArray[np.float64], other: NDArray[np.float64], linear: bool, curved: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Gauss points of the overlap of convex polygons (n, v, 2): pair, coordinates, weight."""
    polygon, count = clip(flat, other)
    pairs, parts = [], []
    for k in range(1, polygon.shape[1] - 1):
        have = np.flatnonzero(count > k + 1)
        pairs.append(have)
        parts.append(polygon[have][:, [0, k, k + 1]])
    pair, triangle = np.concatenate(pairs), np.concatenate(parts)
    edges = triangle[:, 1:] - triangle[:, :1]
    area = 0.5 * np.abs(np.linalg.det(edges))
    size = np.ptp(flat, axis=1).max(axis=1) ** 2
    solid = area > SLIVER * size[pair]
    order = np.argsort(pair[solid], kind="stable")
    pair, triangle, area = pair[solid][order], triangle[solid][order], area[solid][order]
    at, weights = dolfinx_compat.quadrature(
        "triangle", 8 if curved else _degree(linear, flat, other)
    )
    x = triangle[:, :1] + at @ edges[solid][order]
    w = 2.0 * area[:, None] * weights
    return np.repeat(pair, len(weights)), x.reshape(-1, 2), w.ravel()


def _degree(linear: bool, *polygons: NDArray[np.float64]) -> int:
    """Degree the product of shape functions of both sides needs."""
    if all(p.shape[1] == 3 for p in polygons):
        return 2 if linear else 4
    for p in polygons:
        if p.shape[1] == 4:
            skew = np.abs(p[:, 0] - p[:, 1] + p[:, 2] - p[:, 3]).max(initial=0.0)
            if skew > 1e-12 * np.abs(p).max(initial=0.0):
                return 8
    return 4 if linear else 8


def clip(
    window: NDArray[np.float64], subject: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Intersect convex polygons pair by pair (Sutherland, Hodgman, CACM 17 (1974)).

    Parameters
    ----------
    window : (n, v, 2)
        Anticlockwise.
    subject : (n, w, 2)

    Returns
    -------
    Vertices (n, v + w, 2), of which the first `count` (n,) are meant.
    """
    n, v = window.shape[:2]
    room = v + subject.shape[1]
    polygon = np.zeros((n, room, 2))
    polygon[:, : subject.shape[1]] = subject
    count = np.full(n, subject.shape[1])
    place = np.arange(room)
    for edge in range(v):
        start, end = window[:, edge, None], window[:, (edge + 1) % v, None]
        along = end - start
        away = polygon - start
        side = along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0]
        valid = place < count[:, None]
        following = np.where(place + 1 < count[:, None], place + 1, 0)
        next_side = np.take_along_axis(side, following, axis=1)
        next_point = np.take_along_axis(polygon, following[..., None], axis=1)
        inside = side >= 0.0
        crossing = valid & (inside != (next_side >= 0.0))
        share = side / np.where(crossing, side - next_side, 1.0)
        cut = polygon + share[..., None] * (next_point - polygon)
        made = np.stack([polygon, cut], axis=2).reshape(n, 2 * room, 2)
        keep = np.stack([valid & inside, crossing], axis=2).reshape(n, 2 * room)
        order = np.argsort(~keep, axis=1, kind="stable")[:, :room]
        polygon = np.take_along_axis(made, order[..., None], axis=1)
        count = np.minimum(keep.sum(axis=1), room)
    return polygon, count


def _curved(nodes: NDArray[np.float64], v: int) -> bool:
    """Whether any facet (n, nodes, d) with v vertices has a node off its middle."""
    if nodes.shape[1] == v:
        return False
    corners = np.eye(v)
    hats = np.concatenate([0.5 * (corners + np.roll(corners, -1, axis=0)), np.full((1, v), 1 / v)])
    straight = np.einsum("mv,nvk->nmk", hats[: nodes.shape[1] - v], nodes[:, :v])
    size = np.ptp(nodes[:, :v], axis=1).max(initial=0.0)
    return bool(np.abs(nodes[:, v:] - straight).max(initial=0.0) > STRAIGHT * size)


def on_facets(
    nodes: NDArray[np.float64], x: NDArray[np.float64], curved: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Hats of the vertices, and shape functions of all nodes, at points of the plane.

    Parameters
    ----------
    nodes : (q, n, d - 1)
        Projected nodes of the facet of each point.
    x : (q, d - 1)
    curved
        Whether a node lies off the middle of its vertices.

    Returns
    -------
    Values (q, v) and (q, n), and slopes of the latter in the reference facet (q, d - 1, n).
    """
    cell, vertices, degree = FACETS[x.shape[1] + 1, nodes.shape[1]]
    if curved:
        place = vtk_places(cell, degree, nodes, x)
    else:
        place = vtk_places(cell, 1, nodes[:, :vertices], x)
    hats = vtk_shapes(cell, 1, place)
    return hats[0], *(vtk_shapes(cell, degree, place) if degree > 1 else hats)


def _around(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order in which vertices (n, 4) go round: the one whose diagonals span most area."""
    orders = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 1, 3]])
    turned = points[:, orders]
    diagonals = turned[:, :, 2:] - turned[:, :, :2]
    area = np.linalg.norm(np.cross(diagonals[:, :, 0], diagonals[:, :, 1]), axis=-1)
    return orders[np.argmax(area, axis=1)]


def _middles(vertices: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which of the further nodes (n, m, 3) is in the middle of each edge, and of all."""
    wanted = 0.5 * (vertices + np.roll(vertices, -1, axis=1))
    wanted = np.concatenate([wanted, vertices.mean(axis=1, keepdims=True)], axis=1)
    wanted = wanted[:, [0] if vertices.shape[1] == 2 else range(points.shape[1])]
    return np.linalg.norm(wanted[:, :, None] - points[:, None], axis=3).argmin(axis=2)


def _normals(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals of facets (n, v, 3)."""
    if vertices.shape[1] == 2:
        along = vertices[:, 1] - vertices[:, 0]
        normals = np.stack([along[:, 1], -along[:, 0], np.zeros(len(along))], axis=1)
    elif vertices.shape[1] == 3:
        normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    else:
        normals = np.cross(vertices[:, 2] - vertices[:, 0], vertices[:, 3] - vertices[:, 1])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


# --- rows ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Multipliers:
    """The functions ψ_j of the multipliers on each `on` facet.

    Attributes
    ----------
    functions : (facets, v, v)
        C of ψ = C φ.
    own : (facets, v, n), weight : (facets, v)
        ∫ ψ_k N_l and ∫ ψ_k.
    sizes : (facets,)
        Areas.
    """

    functions: NDArray[np.float64]
    own: NDArray[np.float64]
    weight: NDArray[np.float64]
    sizes: NDArray[np.float64]

    @classmethod
    def of(cls, on: Surface, found: Overlaps) -> Multipliers:
        """Dual functions on facets that are covered and of first order, hats on others.

        Raises
        ------
        SurfacesApartError
            A facet meets two layers of the other side.
        """
        facets, v, sizes = len(on.nodes), on.vertices.shape[1], _areas(on)

        def on_facets(values: NDArray[np.float64]) -> NDArray[np.float64]:
            total = np.zeros((facets, *values.shape[1:]))
            np.add.at(total, found.i, values)
            return total

        own, weight = on_facets(found.own), on_facets(found.weight)
        covered = on_facets(found.area) >= COVERED * sizes
        if (on_facets(found.area) > (1.0 + 1e-3) * sizes).any():
            raise SurfacesApartError(
                "a facet of the first side meets two layers of the second; name a smaller part of "
                "it"
            )
        functions = np.tile(np.eye(v), (facets, 1, 1))
        if own.shape[2] == v:
            functions[covered] = weight[covered, :, None] * np.linalg.inv(own[covered])
            own[covered] = weight[covered, :, None] * np.eye(v)
        return cls(functions, own, weight, sizes)


def _rows(on: Surface, against: Surface, found: Overlaps) -> MeanGaps:
    """Multiplier functions facet by facet, their rows, and weak rows given to neighbours."""
    d = on.dimension
    nodes, local = np.unique(on.nodes, return_inverse=True)
    others, other_local = np.unique(against.nodes, return_inverse=True)
    local, other_local = local.reshape(on.nodes.shape), other_local.reshape(against.nodes.shape)
    v = on.vertices.shape[1]
    psi = Multipliers.of(on, found)
    own, weight, sizes, functions = psi.own, psi.weight, psi.sizes, psi.functions
    shared = functions[found.i] @ found.shared
    gap = np.einsum("pjk,pk->pj", functions[found.i], found.gap)

    count, corners = len(nodes), local[:, :v]
    total = np.bincount(corners.ravel(), weight.ravel(), minlength=count)
    gaps = np.bincount(corners[found.i].ravel(), gap.ravel(), minlength=count)
    touched = np.unique(found.i)
    normals = on.normals[:, :d]
    here = _scatter(corners[touched], local[touched], own[touched], normals[touched], count, count)
    there = _scatter(
        corners[found.i], other_local[found.j], -shared, normals[found.i], count, len(others)
    )
    matrix = sparse.hstack([here, there], format="csr")

    share = np.bincount(corners.ravel(), np.repeat(sizes / v, v), minlength=count)
    given = give(corners, weight, total, total < WEAK * share)
    total, gaps, matrix = given @ total, given @ gaps, (given @ matrix).tocsr()
    strong = np.flatnonzero(given.diagonal() > 0.0)

    place = np.zeros((count, 3))
    place[local.ravel()] = on.points.reshape(-1, 3)
    other_place = np.zeros((len(others), 3))
    other_place[other_local.ravel()] = against.points.reshape(-1, 3)
    scaled = (sparse.diags(1.0 / total[strong]) @ matrix[strong]).tocsr()
    scaled.data[np.abs(scaled.data) < NEGLIGIBLE] = 0.0
    scaled.eliminate_zeros()
    scaled.sort_indices()
    entries = scaled.tocoo()
    at, component = entries.col // d, entries.col % d
    all_nodes, all_points = np.concatenate([nodes, others]), np.concatenate([place, other_place])
    mean, turned = np.zeros((len(strong), d)), np.zeros((len(strong), 3))
    mine = at < count
    np.add.at(mean, (entries.row[mine], component[mine]), entries.data[mine])
    force = -entries.data[mine, None] * np.eye(3)[component[mine]]
    arm = place[at[mine]] - place[strong[entries.row[mine]]]
    np.add.at(turned, entries.row[mine], np.cross(arm, force))
    return MeanGaps(
        nodes=nodes[strong],
        points=place[strong],
        areas=total[strong],
        gaps=gaps[strong] / total[strong],
        normals=-mean,
        moments=turned,
        row=entries.row.astype(np.int64),
        node=all_nodes[at],
        component=component.astype(np.int64),
        value=entries.data,
        entry_points=all_points[at],
    )


def _scatter(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    blocks: NDArray[np.float64],
    normals: NDArray[np.float64],
    height: int,
    width: int,
) -> sparse.csr_matrix:
    """Sum of blocks (n, v, w) times normals (n, d) at rows (n, v) and nodes (n, w)."""
    d = normals.shape[1]
    values = blocks[..., None] * normals[:, None, None, :]
    row = np.broadcast_to(rows[:, :, None, None], values.shape)
    column = np.broadcast_to(
        columns[:, None, :, None] * d + np.arange(d)[None, None, None, :], values.shape
    )
    shape = (height, width * d)
    return sparse.csr_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=shape)


def give(
    local: NDArray[np.int64],
    weight: NDArray[np.float64],
    total: NDArray,
    weak: NDArray[np.bool_],
) -> sparse.csr_matrix:
    """Matrix that adds the rows of weak nodes to those of their neighbours, (nodes, nodes).

    A weak node gives to the nodes it shares facets with, in proportion to their weight there; one
    among weak nodes only keeps its row.
    """
    count, v = len(total), local.shape[1]
    some = total > 0.0
    weak = some & weak
    a = np.repeat(local[:, :, None], v, axis=2).ravel()
    b = np.repeat(local[:, None, :], v, axis=1).ravel()
    w = np.repeat(weight[:, None, :], v, axis=1).ravel()
    link = weak[a] & some[b] & ~weak[b] & (w > 0.0)
    gift = sparse.csr_matrix((w[link], (b[link], a[link])), shape=(count, count))
    received = np.asarray(gift.sum(axis=0)).ravel()
    kept = some & ~(weak & (received > 0.0))
    scale = np.divide(1.0, received, out=np.zeros(count), where=received > 0.0)
    return (gift @ sparse.diags(scale) + sparse.diags(kept.astype(float))).tocsr()


def _areas(surface: Surface) -> NDArray[np.float64]:
    """Area of each facet in its own plane, (facets,)."""
    flat = np.einsum(
        "pvk,pdk->pvd", surface.vertices - surface.centres[:, None], frames(surface)
    )[..., :-1]  # fmt: skip
    if surface.dimension == 2:
        return np.ptp(flat, axis=1)[:, 0]
    x, y = flat[..., 0], flat[..., 1]
    return 0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))
