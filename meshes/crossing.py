"""Crossings and winding numbers of closed surfaces of segments (2D) or plane triangles (3D).

**Crossings.** Two segments cross, or an edge pierces a triangle, where the ends of either lie on
different sides of the other: signs of determinants (O'Rourke, Computational Geometry in C, 1998,
section 7.3 and 7.5). Two triangles that meet in more than a common node or edge and are not in one
plane have an edge of one that pierces the other, so testing edges against triangles finds all
crossings, also of triangles that share one node. Most pairs need no such test. Triangles about a
node do not cross one another if their projections along the mean of their normals lie side by side
about the node: each has the same orientation, and their angles add up to one turn. Two triangles
without a common node do not meet if along some direction one begins where the other has ended.

**Winding number.** A ray from x upwards crosses simplices with outward normals n; the winding
number is w(x) = Σ sign(n · ray). The surface is turned by a fixed angle first, so that rays run
into no plane, edge or node of a mesh that is aligned with the axes. Each side of an edge, in
projection, is decided by one determinant for all triangles that have the edge, so that a ray leaves
no gap between two triangles (Haines, Point in polygon strategies, Graphics Gems IV, 1994).

**Candidates** are pairs of bounding boxes that meet, or points in bounding boxes. Boxes are sorted
by size in powers of two, and each size is searched with its own radius (a k-d tree) or in strips
of its own width, so that large and small facets of a graded mesh do not all meet one another.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.arrays import Array, Ints, Mask
from meshes.shares import joined, share

TURN = {
    2: np.array([[0.80901699, -0.58778525], [0.58778525, 0.80901699]]),
    3: np.array(
        [
            [0.73588162, -0.55512063, 0.38743861],
            [0.60817093, 0.20121936, -0.76788063],
            [0.34830697, 0.80707076, 0.48745296],
        ]
    ),
}
"""Rotation of the surface before rays are cast along the last axis; arbitrary angles."""

PAIRS = 2_000_000
"""Approximate number of pairs of boxes tested at once; limits the memory."""

STRIPS = 4096
"""Largest number of strips along an axis: places along all of them are exact enough."""

FEW = 32_000
"""Pairs, over those with a box of like size, that take less time than another search.

With 0, 3,000, 8,000, 16,000 and 32,000 the check of a hub on a shaft takes 45, 43, 35, 35 and 35 ms
of CPU time at 29,811 unknowns, and 188, 184, 185, 182 and 170 at 248,625; that of a ball between
two grooves 50, 41, 36, 36 and 37."""

SOME = 200
"""Number of boxes from which the number of pairs is estimated."""

STEEP = 1e-9
"""Cosine of the angle between the normal of a triangle and the mean of those about its node above
which its sign is no round-off."""

EACH_OTHER = 200_000
"""Largest number of boxes whose pairs are found all at once; limits the memory."""

Pairs = tuple[Ints, Ints]


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed surface of segments or plane triangles."""

    places: Array  # (nodes, d)
    simplices: Ints  # (simplices, d)
    """Rows of `places`; normals by the right-hand rule (in 2D to the right) point outward."""
    touch: Array  # (simplices,)
    """Depth up to which two simplices merely touch; the smaller value of the two applies."""
    deviation: Array  # (simplices,)
    """Largest distance from the true surface; the sum of the two values applies."""

    def depth(self, i: Ints, j: Ints) -> Array:
        """Depth (pairs,) from which on two simplices count as crossing."""
        deviation = self.deviation[i] + self.deviation[j]
        return np.asarray(np.minimum(self.touch[i], self.touch[j]) + deviation)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Bounding boxes."""

    lower: Array
    upper: Array
    """Shape (boxes, d)."""

    @classmethod
    def of(cls, places: Array, simplices: NDArray[np.integer]) -> "Boxes":
        """Boxes of simplices (simplices, nodes) with coordinates (nodes, d)."""
        lower = upper = places[simplices[:, 0]]
        for k in range(1, simplices.shape[1]):
            corner = places[simplices[:, k]]
            lower, upper = np.minimum(lower, corner), np.maximum(upper, corner)
        return cls(lower, upper)


def points_in_boxes(x: Array, boxes: Boxes) -> Iterator[Pairs]:
    """Iterate over the pairs (row of x, row of boxes) of a point (points, d) in a box, each once.

    Points are sorted into strips along the first axis, as wide as the boxes of one size, and along
    each strip. So the points near a box are a few ranges, which bisection finds.
    """
    if len(x) == 0:
        return
    origin, extent = x.min(axis=0), np.ptp(x, axis=0) + np.finfo(float).tiny
    meets = ((boxes.lower <= origin + extent) & (boxes.upper >= origin)).all(axis=1)
    for rows in _of_one_size(boxes, np.flatnonzero(meets)):
        lower, upper = boxes.lower[rows] - origin, boxes.upper[rows] - origin
        side = np.maximum((upper - lower).max() * (1.0 + 1e-9), extent[1:] / STRIPS)
        last = (extent[1:] / side).astype(np.int64)
        strides = 2.0 * extent[0] * np.cumprod([1, *(last + 1)])[: len(last)]
        strip = [np.clip((y[:, 1:] / side).astype(np.int64), 0, last)
                 for y in (x - origin, lower, upper)]  # fmt: skip
        place = strip[0] @ strides + (x[:, 0] - origin[0])
        order = np.argsort(place)
        place = place[order]
        room = 1e-15 * place[-1]
        ends = np.clip([lower[:, 0], upper[:, 0]], 0.0, extent[0]) + [[-room], [room]]
        for step in product((0, 1), repeat=len(last)):
            some = np.flatnonzero((strip[1] + np.array(step, int) <= strip[2]).all(axis=1))
            along = (strip[1][some] + np.array(step, int)) @ strides + ends[:, some]
            first = np.searchsorted(place, along[0])
            count = np.searchsorted(place, along[1], side="right") - first
            for part in np.array_split(np.arange(len(some)), int(count.sum()) // PAIRS + 1):
                ahead = first[part] - np.cumsum(count[part]) + count[part]
                at = np.repeat(ahead, count[part]) + np.arange(count[part].sum())
                yield _met(Boxes(x, x), boxes, order[at], rows[np.repeat(some[part], count[part])])


def _of_one_size(boxes: Boxes, rows: Ints) -> list[Ints]:
    """Some rows of boxes, divided by size in powers of two, the smallest first.

    Few smaller boxes stay with larger ones: a box of half the size meets four times as many.
    """
    size = (boxes.upper[rows] - boxes.lower[rows]).max(axis=1)
    unit = max(float(size.max(initial=0.0)), np.finfo(float).tiny)
    level = np.frexp(np.maximum(size / unit, 2.0**-40))[1]
    largest, pairs = 1, 0.0
    for k in range(1, int(level.min(initial=1)) - 1, -1):
        some = level == k
        pairs += 4.0 ** (largest - k) * some.sum()
        if pairs > FEW:
            largest, pairs = k, some.sum()
        level[some] = largest
    return [rows[level == k] for k in np.unique(level)]


def meeting_each_other(boxes: Boxes, comm: MPI.Intracomm) -> Iterator[Pairs]:
    """Iterate over the pairs of boxes that meet, each pair once on one of the ranks.

    Ranks share the boxes along the widest axis. A rank has the pairs of its boxes with each other
    and with those behind.
    """
    centres = 0.5 * (boxes.lower + boxes.upper)
    axis = int(np.argmax(np.ptp(centres, axis=0))) if len(centres) else 0
    order = np.argsort(centres[:, axis], kind="stable")
    local = share(comm, len(order))
    if len(local) == 0:
        return
    behind = order[local[-1] + 1 :]
    reached = boxes.lower[behind, axis] <= boxes.upper[order[local], axis].max()
    members, smaller = np.concatenate([order[local], behind[reached]]), np.zeros(0, np.int64)
    is_local = np.zeros(len(order), bool)
    is_local[order[local]] = True
    for rows in _of_one_size(boxes, members):
        for i, j in (*_near(boxes, rows, smaller), *_near_each_other(boxes, rows)):
            chosen = is_local[i] | is_local[j]
            yield i[chosen], j[chosen]
        smaller = np.concatenate([smaller, rows])


def _near_each_other(boxes: Boxes, rows: Ints) -> Iterator[Pairs]:
    """Pairs among some boxes with centres nearer than the largest size, each pair once."""
    if len(rows) <= EACH_OTHER:  # in a third of the time
        centres = 0.5 * (boxes.lower[rows] + boxes.upper[rows])
        tree = cKDTree(centres, balanced_tree=False, compact_nodes=False)
        reach = _reach((boxes, rows, centres), (boxes, rows, centres))
        pairs = rows[tree.query_pairs(reach, output_type="ndarray")]
        yield _met(boxes, boxes, pairs[:, 0], pairs[:, 1])
        return
    for i, j in _near(boxes, rows, rows):
        ordered = i < j
        yield i[ordered], j[ordered]


def _reach(*some: tuple[Boxes, Ints, Array]) -> float:
    """Largest distance of the centres of two boxes that meet; some rows of boxes with centres."""
    sides = [box.upper[k] - box.lower[k] for box, k, _ in some]
    sizes = [float(np.einsum("ni,ni->n", side, side).max()) ** 0.5 for side in sides]
    return 0.5 * sum(sizes) * (1.0 + 1e-9) + 1e-15 * max(float(np.abs(c).max()) for *_, c in some)


def _met(a: Boxes, b: Boxes, i: Ints, j: Ints) -> Pairs:
    """The pairs whose boxes meet."""
    for axis in range(a.lower.shape[1]):
        lower, upper = (np.ascontiguousarray(x[:, axis]) for x in (a.lower, a.upper))
        others = [np.ascontiguousarray(x[:, axis]) for x in (b.lower, b.upper)]
        touch = np.flatnonzero((lower[i] <= others[1][j]) & (others[0][j] <= upper[i]))
        i, j = i[touch], j[touch]
    return i, j


def _near(boxes: Boxes, rows: Ints, others: Ints) -> Iterator[Pairs]:
    """Pairs of some boxes and some others with centres nearer than half the sum of their sizes."""
    if len(rows) == 0 or len(others) == 0:
        return
    centres = [0.5 * (boxes.lower[k] + boxes.upper[k]) for k in (rows, others)]
    reach = _reach((boxes, rows, centres[0]), (boxes, others, centres[1]))
    tree = cKDTree(centres[1], balanced_tree=False, compact_nodes=False)
    some = centres[0][:: len(rows) // SOME + 1]
    mean = tree.query_ball_point(some, reach, return_length=True).mean()
    for chosen in np.array_split(np.arange(len(rows)), int(mean * len(rows)) // PAIRS + 1):
        part = cKDTree(centres[0][chosen], balanced_tree=False, compact_nodes=False)
        table = part.sparse_distance_matrix(tree, reach, output_type="ndarray")
        yield _met(boxes, boxes, rows[chosen[table["i"]]], others[table["j"]])


def segment_crossings(surface: ClosedSurface) -> Ints:
    """Pairs of segments in the plane that cross, (pairs, 2).

    The ends of both are farther from the line of the other than `ClosedSurface.depth`.
    """
    places, segments = surface.places, surface.simplices
    boxes, crossing_pairs = Boxes.of(places, segments), [np.zeros((0, 2), np.int64)]
    for i, j in meeting_each_other(boxes, MPI.COMM_SELF):
        new = (segments[i][:, :, None] != segments[j][:, None, :]).all(axis=(1, 2))
        i, j = i[new], j[new]
        p, q = (places[segments[i, k]] for k in range(2))
        r, s = (places[segments[j, k]] for k in range(2))
        least = surface.depth(i, j)
        on_j = _separated(_signed_distance(r, s, p), _signed_distance(r, s, q), least)
        on_i = _separated(_signed_distance(p, q, r), _signed_distance(p, q, s), least)
        crossed = on_i & on_j
        crossing_pairs.append(np.stack([i[crossed], j[crossed]], axis=1))
    return np.concatenate(crossing_pairs)


def _signed_distance(a: Array, b: Array, x: Array) -> Array:
    """Distance of points to lines, positive on the left."""
    along = b - a
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), np.finfo(float).tiny)
    return (along[:, 0] * (x - a)[:, 1] - along[:, 1] * (x - a)[:, 0]) / length


def _separated(first: Array, second: Array, least: Array) -> Mask:
    """Mask of pairs of distances with different signs and magnitudes above `least`."""
    return np.asarray((first * second < 0.0) & (np.minimum(abs(first), abs(second)) > least))


def triangle_crossings(surface: ClosedSurface, comm: MPI.Intracomm) -> tuple[Ints, Mask]:
    """Pairs of triangles of which one has an edge that pierces the other (collective).

    The ends of the edge are farther from the plane of the triangle, and the point where it pierces
    the plane is farther inside the edges of the triangle, than `ClosedSurface.depth`.

    Returns
    -------
    The pairs (pairs, 2), which ranks with the same surface share; and the mask (triangles,) of
    doubtful triangles: each that may touch one with which it has no node in common, or overlap one
    with which it has, and all near the true surface only.
    """
    places, triangles = surface.places, surface.simplices
    corners = [places[corner] for corner in triangles.T]
    area = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    is_plain = _side_by_side(surface, area)
    doubtful = ~is_plain[triangles].all(axis=1) | (surface.deviation > 0.0)
    crossing_pairs = [np.zeros((0, 2), np.int64)]
    boxes, room = Boxes.of(places, triangles), surface.touch[:, None]
    columns = np.ascontiguousarray(triangles.T)
    for i, j in meeting_each_other(Boxes(boxes.lower - room, boxes.upper + room), comm):
        shares, is_done, others = *np.zeros((2, len(i)), bool), columns.take(j, axis=1)
        for node in columns.take(i, axis=1):
            is_same = (others[0] == node) | (others[1] == node) | (others[2] == node)
            shares |= is_same
            is_done |= is_same & is_plain[node]
        i, j, shares = i[~is_done], j[~is_done], shares[~is_done]
        near = np.flatnonzero(shares | ~_are_separate(surface, corners, normal, i, j))
        i, j = i[near], j[near]
        doubtful[i] = doubtful[j] = True
        crossing_pairs += [_crossing(surface, i, j), _crossing(surface, j, i)]
    comm.Allreduce(MPI.IN_PLACE, doubtful, MPI.LOR)
    return joined(comm, np.concatenate(crossing_pairs)), doubtful


def _side_by_side(surface: ClosedSurface, area: Array) -> Mask:
    """Mask (nodes,) of nodes about which projected triangles lie side by side.

    Parameters
    ----------
    area : (triangles, 3)
        Normals times twice the areas.
    """
    places, triangles = surface.places, surface.simplices
    nodes = triangles.T.ravel()
    sums = [np.bincount(nodes, np.tile(part, 3), len(places)) for part in area.T]
    mean = np.stack(sums, axis=1)
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1), np.finfo(float).tiny)[:, None]
    turn, is_plain = np.zeros(len(places)), np.ones(len(places), bool)
    double = np.linalg.norm(area, axis=1)
    for first, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        node = triangles[:, first]
        along = mean[node]
        a, b = (places[triangles[:, k]] - places[node] for k in (second, third))
        up, a_up, b_up = (np.einsum("ni,ni->n", x, along) for x in (area, a, b))
        is_plain[node[up < STEEP * double]] = False
        angle = np.arctan2(up, np.einsum("ni,ni->n", a, b) - a_up * b_up)
        turn += np.bincount(node, angle, len(places))
    return is_plain & (np.abs(turn - 2.0 * np.pi) < 1.0)


def _are_separate(
    surface: ClosedSurface, corners: list[Array], normal: Array, i: Ints, j: Ints
) -> Mask:
    """Mask (pairs,) of triangles with some distance between them.

    One begins where the other has ended: along the normal of one, along the line between their
    centres, or in the plane of one across one of its edges.
    """
    touch = np.maximum(surface.touch[i], surface.touch[j])
    least = touch + surface.deviation[i] + surface.deviation[j]
    separate = np.zeros(len(i), bool)
    for direction, (s, t) in product(range(5), ((i, j), (j, i))):
        rows = np.flatnonzero(~separate)
        s, t = s[rows], t[rows]
        if direction == 0:
            along = normal[s]
        elif direction == 1:
            along = corners[0][t] - corners[0][s]
            along += corners[1][t] - corners[1][s] + corners[2][t] - corners[2][s]
        else:
            along = np.cross(corners[direction - 4][s] - corners[direction - 2][s], normal[s])
        a, b = ([np.einsum("ni,ni->n", x.take(k, axis=0), along) for x in corners] for k in (s, t))
        begin, end = (
            np.stack([part.reduce(a), part.reduce(b)]) for part in (np.minimum, np.maximum)
        )
        separate[rows] = (begin - end[::-1]).max(axis=0) > least[rows] * np.linalg.norm(
            along, axis=1
        )
    return separate


def _crossing(surface: ClosedSurface, s: Ints, t: Ints) -> Ints:
    """The pairs (pairs, 2) of some triangles s and t of which an edge of s pierces t."""
    places, triangles = surface.places, surface.simplices
    edge = np.repeat([(0, 1), (1, 2), (2, 0)], len(s), axis=0)
    s, t = np.tile(s, 3), np.tile(t, 3)
    edges = np.take_along_axis(triangles[s], edge, axis=1)
    new = (edges[:, :, None] != triangles[t][:, None, :]).all(axis=(1, 2))
    s, t, edges = s[new], t[new], edges[new]
    pierced = _pierces(places, edges, triangles[t], surface.depth(s, t))
    return np.stack([s[pierced], t[pierced]], axis=1)


def _pierces(places: Array, edges: Ints, triangles: Ints, least: Array) -> Mask:
    """Mask (pairs,) of edges (pairs, 2) that pierce triangles (pairs, 3) deeper than `least`."""
    pierced = np.zeros(len(edges), bool)
    a = places[triangles[:, 0]]
    u, v = places[triangles[:, 1]] - a, places[triangles[:, 2]] - a
    normal = np.cross(u, v)
    double = np.maximum(np.sqrt(np.einsum("ni,ni->n", normal, normal)), np.finfo(float).tiny)
    first = np.einsum("ni,ni->n", places[edges[:, 0]] - a, normal) / double
    second = np.einsum("ni,ni->n", places[edges[:, 1]] - a, normal) / double
    rows = np.flatnonzero(_separated(first, second, least))
    a, u, v, normal, double = (x[rows] for x in (a, u, v, normal, double))
    p, q = places[edges[rows, 0]], places[edges[rows, 1]]
    share = (first[rows] / (first[rows] - second[rows]))[:, None]
    x = p + share * (q - p) - a
    weights = [
        np.einsum("ni,ni->n", np.cross(x, v), normal) / double,
        np.einsum("ni,ni->n", np.cross(u, x), normal) / double,
    ]
    weights.append(double - weights[0] - weights[1])
    opposite = [v, u, v - u]
    inside = np.ones(len(rows), bool)
    for weight, edge in zip(weights, opposite, strict=True):
        inside &= weight > least[rows] * np.sqrt(np.einsum("ni,ni->n", edge, edge))
    pierced[rows[inside]] = True
    return pierced


def winding(x: Array, surface: ClosedSurface, comm: MPI.Intracomm = MPI.COMM_SELF) -> Ints:
    """Winding numbers of a surface about points x (points, d), (points,).

    Ranks that have the same points and surface share the points along an axis (collective).
    """
    d, simplices = x.shape[1], surface.simplices
    centre = surface.places.mean(axis=0)
    x, places = (x - centre) @ TURN[d].T, (surface.places - centre) @ TURN[d].T
    shadows = Boxes.of(places[:, : d - 1], simplices)
    order = np.argsort(x[:, 0])
    x = x[order[share(comm, len(x))]]
    total = np.zeros(len(x), np.int64)
    for i, s in points_in_boxes(x[:, : d - 1], shadows):
        hit = _above(x[i], places, simplices[s])
        total += np.bincount(i, hit, len(x)).astype(np.int64)
    around = np.empty(len(order), np.int64)
    around[order] = joined(comm, total)
    return around


def _above(x: Array, places: Array, simplices: Ints) -> Array:
    """1 or -1 for a simplex above a point whose normal points up or down, 0 for none, (points,)."""
    if x.shape[1] == 2:
        a, b = (places[simplices[:, k]] for k in range(2))
        side = (b[:, 0] <= x[:, 0]).astype(float) - (a[:, 0] <= x[:, 0])
        up = _signed_distance(a, b, x) * side  # the normal is on the right: up if a is right of b
        return np.asarray(np.where(up > 0.0, side, 0.0))
    side = [_left(x, places, simplices[:, k], simplices[:, (k + 1) % 3]) for k in range(3)]
    hit = np.zeros(len(x))
    rows = np.flatnonzero((side[0] == side[1]) & (side[1] == side[2]))
    a, b, c = (places[simplices[rows, k]] - x[rows] for k in range(3))
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    sign = np.where(side[0][rows], 1.0, -1.0)
    hit[rows] = np.where(volume * sign > 0.0, sign, 0.0)
    return hit


def _left(x: Array, places: Array, first: Ints, second: Ints) -> Mask:
    """Mask (points,) of points left of an edge in the projection along the last axis.

    The decision for both directions of an edge is made with one number.
    """
    swap = first > second
    a = places[np.where(swap, second, first), :2]
    b = places[np.where(swap, first, second), :2]
    left = (b[:, 0] - a[:, 0]) * (x[:, 1] - a[:, 1]) > (b[:, 1] - a[:, 1]) * (x[:, 0] - a[:, 0])
    return np.asarray(left ^ swap)
