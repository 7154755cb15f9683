"""Mortar rows of two surfaces: what they reproduce, conserve and refuse."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from meshes.contact_surface import Surface
from meshes.facet_overlaps import Overlaps, clip
from meshes.facing import SurfacesApartError, overlaps
from meshes.mortar import MeanGaps, mean_gaps
from meshes.ties import Decided, mean_jumps
from tests import mortar_reference

TURN = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
SHAPES = ("segment", "triangle", "quadrilateral", "skew")
SECOND = ("segment2", "triangle2", "quadrilateral2")


def patch(
    kind: str,
    n: int,
    upwards: bool,
    first: int = 0,
    lower: float = 0.0,
    upper: float = 1.0,
    height: float = 0.0,
    turn: np.ndarray = TURN,
) -> Surface:
    """A flat square (a line in the plane) of n facets along each edge, turned in space.

    `skew` moves the inner nodes of quadrilaterals, so that they are no parallelograms; a 2 at the
    end makes facets of the second order, with straight edges.
    """
    if kind.endswith("2"):
        return second(patch(kind[:-1], n, upwards, first, lower, upper, height, turn))
    x = np.linspace(lower, upper, n + 1)
    if kind == "segment":
        points = np.stack([x, np.full(n + 1, height), 0 * x], axis=1)
        facets = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
        turn = Rotation.from_rotvec([0, 0, 0.7]).as_matrix() if turn is TURN else turn
        out = np.array([0, 1.0, 0])
    else:
        points = np.stack([*np.meshgrid(x, x, indexing="ij"), np.full((n + 1, n + 1), height)], -1)
        if kind == "skew":
            inner = points[1:-1, 1:-1]
            inner[..., :2] += 0.2 / n * np.sin(9 * inner[..., [1, 0]])
        points = points.reshape(-1, 3)
        corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
        a, b, c, d = corner, corner + n + 1, corner + n + 2, corner + 1
        facets = np.stack([a, c, b, d], axis=1)  # in no useful order
        if kind == "triangle":
            facets = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        out = np.array([0, 0, 1.0])
    inside = points[facets].mean(axis=1) + (-0.1 if upwards else 0.1) * out
    d = 2 if kind == "segment" else 3
    return Surface.of(d, facets + first, (points @ turn.T)[facets], inside @ turn.T)


def second(flat: Surface) -> Surface:
    """The same surface with nodes in the middle of edges and quadrilaterals."""
    v = flat.nodes.shape[1]
    ends = [(k, (k + 1) % v) for k in range(v)][: 1 if v == 2 else v]
    if v == 4:
        ends.append((0, 1, 2, 3))
    middles = np.stack([flat.points[:, list(e)].mean(axis=1) for e in ends], axis=1)
    _, number = np.unique(np.round(middles.reshape(-1, 3), 9), axis=0, return_inverse=True)
    nodes = flat.nodes.max() + 1 + number.reshape(len(middles), -1)
    turned = slice(None, None, -1)  # in no useful order
    return Surface.of(
        flat.dimension,
        np.concatenate([flat.nodes, nodes[:, turned]], axis=1),
        np.concatenate([flat.points, middles[:, turned]], axis=1),
        flat.centres - 0.1 * flat.normals,
    )


def apply(rows: MeanGaps, field) -> np.ndarray:
    """Rows applied to a displacement field, (n, 3) of (n, 3)."""
    values = field(rows.entry_points)[np.arange(len(rows.row)), rows.component]
    return np.bincount(rows.row, rows.value * values)


def nodal_forces(rows: MeanGaps, pressure: float) -> dict[int, np.ndarray]:
    """Forces by node of a constant pressure."""
    forces: dict[int, np.ndarray] = {}
    for row, node, component, value in zip(
        rows.row, rows.node, rows.component, rows.value, strict=True
    ):
        forces.setdefault(int(node), np.zeros(3))[component] += (
            pressure * rows.areas[row] * value
        )  # fmt: skip
    return forces


def consistent_forces(surface: Surface, pressure: float) -> dict[int, np.ndarray]:
    """∫ p N n on a surface, bilinear facets by tensor Gauss points; the second order by hand."""
    forces: dict[int, np.ndarray] = {}
    g = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
    second_order = {
        3: [1 / 6, 1 / 6, 4 / 6], 6: [0, 0, 0, 1 / 3, 1 / 3, 1 / 3],
        9: [1 / 36] * 4 + [4 / 36] * 4 + [16 / 36],
    }  # fmt: skip
    for nodes, p, n in zip(surface.nodes, surface.points, surface.normals, strict=True):
        if len(nodes) > surface.vertices.shape[1]:
            last = {3: [1], 6: [1, 2], 9: [1, 3]}[len(nodes)]
            edges = p[last] - p[0]
            area = np.sqrt(np.linalg.det(edges @ edges.T)) / (2 if len(nodes) == 6 else 1)
            shares = area * np.array(second_order[len(nodes)])
        elif len(nodes) == 4:
            shares = np.zeros(4)
            for r in g:
                for s in g:
                    phi = np.array([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
                    dr = np.array([s - 1, 1 - s, s, -s]) @ p
                    ds = np.array([r - 1, -r, r, 1 - r]) @ p
                    shares += phi * np.linalg.norm(np.cross(dr, ds)) / 4
        else:
            edges = p[1:] - p[0]
            area = np.sqrt(np.linalg.det(edges @ edges.T)) / (len(nodes) - 1)
            shares = np.full(len(nodes), area / len(nodes))
        for node, share in zip(nodes, shares, strict=True):
            forces.setdefault(int(node), np.zeros(3))
            forces[int(node)] += pressure * share * n
    return forces


def pairs() -> list[tuple[str, str]]:
    """Shapes of the two sides: a line does not meet a surface."""
    every = [(a, b) for a in SHAPES + SECOND for b in SHAPES + SECOND]
    return [(a, b) for a, b in every if a.startswith("segment") == b.startswith("segment")]


@pytest.mark.parametrize(("kind", "other"), pairs())
@pytest.mark.parametrize(("n", "m"), [(3, 4), (5, 2), (1, 3)])
def test_an_inclined_patch_is_exact(kind: str, other: str, n: int, m: int) -> None:
    """Constant pressure gives both sides their consistent forces; linear fields do not open it."""
    on, against = patch(kind, n, False), patch(other, m, True, first=1000)
    rows = mean_gaps(on, against)
    corners = on.nodes[:, : on.vertices.shape[1]]
    assert rows.nodes.tolist() == np.unique(corners).tolist()
    np.testing.assert_allclose(rows.gaps, 0, atol=1e-14)
    np.testing.assert_allclose(rows.areas.sum(), 1, rtol=1e-13)
    matrix = np.array([[1.0, 2, 3], [-2, 1, 0.5], [0.1, 0.7, -1]])
    np.testing.assert_allclose(apply(rows, lambda x: x @ matrix + 0.3), 0, atol=2e-9)
    forces = nodal_forces(rows, 7.0)
    exact = consistent_forces(on, 7.0)
    exact |= {k: -v for k, v in consistent_forces(against, -7.0).items()}
    zero = np.zeros(3)
    for node in forces.keys() | exact.keys():
        known = exact.get(node, zero)
        np.testing.assert_allclose(forces.get(node, zero), known, rtol=0, atol=7e-9)


@pytest.mark.parametrize("kind", SHAPES)
def test_matching_meshes_reduce_to_node_pairs(kind: str) -> None:
    on, against = patch(kind, 3, False), patch(kind, 3, True, first=1000)
    rows = mean_gaps(on, against)
    for k, node in enumerate(rows.nodes):
        mine = rows.row == k
        assert set(rows.node[mine]) == {node, node + 1000}
        normal, component = on.normals[0], rows.component[mine]
        sign = np.where(rows.node[mine] == node, 1.0, -1.0)
        np.testing.assert_allclose(rows.value[mine], sign * normal[component], atol=1e-9)


@pytest.mark.parametrize("kind", ["segment", "triangle", "quadrilateral"])
@pytest.mark.parametrize("height", [0.05, -0.03])
def test_the_gap_is_the_distance(kind: str, height: float) -> None:
    rows = mean_gaps(patch(kind, 3, False, height=height), patch(kind, 4, True, first=1000))
    np.testing.assert_allclose(rows.gaps, height, rtol=1e-12)


def arc(n: int, radius: float, first: int, inward: bool) -> Surface:
    """Part of a circle in the plane; the body lies outside it or inside."""
    angle = np.linspace(0.2, 2.0, n + 1)
    points = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    facets = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    inside = points[facets].mean(axis=1) * (1.1 if inward else 0.9)
    return Surface.of(2, facets + first, points[facets], inside)


def cap(n: int, radius: float, first: int, inward: bool) -> Surface:
    """Part of a sphere, meshed by warped quadrilaterals."""
    flat = patch("quadrilateral", n, True, lower=-0.4, upper=0.45, turn=np.eye(3))
    points = flat.points + [0, 0, 1.0]
    points = radius * points / np.linalg.norm(points, axis=2, keepdims=True)
    inside = points.mean(axis=1) * (1.1 if inward else 0.9)
    return Surface.of(3, flat.nodes + first, points, inside)


@pytest.mark.parametrize("make", [arc, cap])
def test_curved_rows_vanish_for_rigid_motions(make) -> None:
    """Forces and moments between the bodies balance to round-off, whatever the gap."""
    rows = mean_gaps(make(7, 1.0, 0, False), make(5, 1.05, 1000, True))
    for k in range(3):
        np.testing.assert_allclose(apply(rows, lambda x, k=k: np.eye(3)[k] + 0 * x), 0, atol=1e-13)
    around = np.array([0, 0, 1.0]) if make is arc else np.array([0.3, -0.5, 0.8])
    turned = apply(rows, lambda x: np.cross(around, x))
    np.testing.assert_allclose(turned, 0, atol=1e-12 if make is arc else 2e-2)


@pytest.mark.parametrize("make", [arc, cap])
def test_the_gap_of_curved_surfaces_converges(make) -> None:
    """Gap 0.05 between concentric surfaces, to second order in the size of facets."""
    errors = []
    for n in (8, 16, 32):
        rows = mean_gaps(make(n, 1.0, 0, False), make(3 * n // 2, 1.05, 10**5, True))
        inner = rows.areas > 0.6 * np.median(rows.areas)
        errors.append(np.abs(rows.gaps[inner] - 0.05).max())
    assert errors[-1] < 1e-3
    assert np.log2(errors[0] / errors[-1]) / 2 > 1.7


def rounded(make, n: int, radius: float, first: int, inward: bool) -> Surface:
    """The same surfaces of the second order, all nodes on the circle or sphere."""
    flat = second(make(n, radius, first, inward))
    points = radius * flat.points / np.linalg.norm(flat.points, axis=2, keepdims=True)
    inside = flat.centres * (1.1 if inward else 0.9)
    return Surface.of(flat.dimension, flat.nodes, points, inside)


@pytest.mark.parametrize("make", [arc, cap])
def test_rows_of_curved_facets(make) -> None:
    """No rigid motion is seen, as above, and the gap is nearly that of the smooth surfaces."""
    rows = mean_gaps(rounded(make, 7, 1.0, 0, False), rounded(make, 5, 1.05, 1000, True))
    for k in range(3):
        np.testing.assert_allclose(apply(rows, lambda x, k=k: np.eye(3)[k] + 0 * x), 0, atol=1e-13)
    around = np.array([0, 0, 1.0]) if make is arc else np.array([0.3, -0.5, 0.8])
    turned = apply(rows, lambda x: np.cross(around, x))
    np.testing.assert_allclose(turned, 0, atol=1e-12 if make is arc else 2e-2)
    errors = []
    for kind in (make, lambda *a: rounded(make, *a)):
        rows = mean_gaps(kind(8, 1.0, 0, False), kind(12, 1.05, 10**5, True))
        inner = rows.areas > 0.6 * np.median(rows.areas)
        errors.append(np.abs(rows.gaps[inner] - 0.05).max())
    assert errors[1] < 0.1 * errors[0]


@pytest.mark.parametrize("kind", ["segment", "triangle", "quadrilateral"])
@pytest.mark.parametrize("end", [0.5, 0.51, 0.667, 0.67, 1 / 3 + 1e-9, 0.34, 1e-3])
def test_a_side_covered_in_part(kind: str, end: float) -> None:
    """Rows stay mild wherever the other body ends, and a constant pressure is transmitted."""
    on, against = patch(kind, 3, False), patch(kind, 2, True, first=1000, upper=end)
    rows = mean_gaps(on, against)
    assert np.abs(rows.value).max() < 3
    total = np.zeros(3)
    for node, force in nodal_forces(rows, 1.0).items():
        if node >= 1000:
            np.testing.assert_allclose(force, -consistent_forces(against, -1.0)[node], atol=1e-12)
        else:
            total += force
    side = end if kind == "segment" else end**2
    np.testing.assert_allclose(total, side * on.normals[0], atol=1e-12)
    gram = np.zeros((len(rows.nodes),) * 2)
    for k in np.unique(rows.node * 3 + rows.component):
        mine = rows.node * 3 + rows.component == k
        column = np.bincount(rows.row[mine], rows.value[mine], minlength=len(gram))
        gram += np.outer(column, column)
    scale = 1 / np.sqrt(np.diag(gram))
    assert np.linalg.cond(gram * np.outer(scale, scale)) < 2e4


def test_sides_that_face_the_same_way_are_refused() -> None:
    with pytest.raises(SurfacesApartError, match="face the same way"):
        mean_gaps(patch("triangle", 2, True), patch("triangle", 3, True, first=1000))


def test_sides_that_never_meet_are_refused() -> None:
    away = patch("triangle", 3, True, first=1000, lower=2.0, upper=3.0)
    with pytest.raises(SurfacesApartError, match="never meet"):
        mean_gaps(patch("triangle", 2, False), away)


def test_facets_of_very_different_size_find_each_other() -> None:
    rows = mean_gaps(patch("triangle", 1, False, height=0.3), patch("quadrilateral", 40, True, 10))
    np.testing.assert_allclose(rows.gaps, 0.3)
    rows = mean_gaps(
        patch("quadrilateral", 40, False, height=0.3), patch("triangle", 1, True, 9999)
    )
    np.testing.assert_allclose(rows.gaps, 0.3)
    assert len(rows.nodes) == 41**2


@pytest.mark.parametrize("make", [patch, cap, arc])
def test_facets_find_each_other_across_a_wide_gap(make) -> None:
    """The search along normals finds all overlapping pairs that a search over all pairs finds."""
    if make is patch:
        on = patch("triangle", 9, False, height=2.7)
        against = patch("quadrilateral", 16, True, 1000, -0.2, 1.3)
    else:
        on, against = make(9, 2.3, 0, True), make(25, 1.0, 1000, False)
    i, j = (part.ravel() for part in np.indices((len(on.nodes), len(against.nodes))))
    facing = np.einsum("pk,pk->p", on.normals[i], against.normals[j]) < -0.5
    every, found = Overlaps.of(on, against, i[facing], j[facing]), overlaps(on, against)
    assert len(found.i) > len(on.nodes)
    np.testing.assert_array_equal(found.i, every.i)
    np.testing.assert_array_equal(found.j, every.j)
    np.testing.assert_array_equal(found.gap, every.gap)


@pytest.mark.parametrize("kind", ["segment", "quadrilateral", "segment2", "quadrilateral2"])
def test_pairs_of_one_offset_have_the_integrals_of_each_pair(kind: str) -> None:
    """On grids: each facet with all of the other side has no pairs of one offset."""
    on, against = patch(kind, 8, True), patch(kind, 4, False, 500, 0.05, 1.05, height=0.1)
    facets = np.arange(len(against.nodes))
    parts = [(np.full(len(facets), k), facets) for k in range(len(on.nodes))]
    together = Overlaps.of(on, against, *map(np.concatenate, zip(*parts, strict=True)), True)
    apart = [vars(Overlaps.of(on, against, *part, True)).values() for part in parts]
    for values, each in zip(vars(together).values(), zip(*apart, strict=True), strict=True):
        np.testing.assert_allclose(values, np.concatenate(each), rtol=0.0, atol=1e-14)


numbers = st.floats(-1, 1, allow_nan=False, width=32)

# A common vertex off by a rounding error, which the overlap has several times.
NEARLY_COMMON = [(-0.5, -1.0), (1.0, 0.0), (0.125, -4e-29), (0.0, -1.0), (0.0, -0.125), (1.0, 0.5)]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=6, max_size=6), st.integers(3, 4))
@example(NEARLY_COMMON, 4)
def test_clipping_against_qhull(points: list[tuple[float, float]], v: int) -> None:
    """The area of the overlap of random convex polygons, by halfplane intersection.

    Qhull needs a point inside, which scipy's linear programs find to 1e-7: slivers may be lost.
    """
    given = np.array(points, float)
    polygons = []
    for part, size in ((given[:3], 3), (given[2:], v)):
        hull = part[:size]
        area = abs(np.linalg.det(hull[1:3] - hull[0])) if size == 3 else 0.0
        if size == 4:
            flat = np.linalg.svd(hull - hull.mean(axis=0))[1]
            if flat[1] < 0.05 or len(ConvexHull(hull).vertices) < 4:
                return
            hull = hull[ConvexHull(hull).vertices]
        elif area < 0.05:
            return
        turn = hull[1] - hull[0], hull[2] - hull[1]
        polygons.append(hull if np.linalg.det(np.stack(turn)) > 0 else hull[::-1])
    window, subject = polygons
    polygon, count = clip(window[None], subject[None])
    x, y = polygon[0, : count[0]].T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    exact = sum(w for _, w in mortar_reference.overlap(window, subject))
    assert area == pytest.approx(exact, abs=1e-6)


def closed_box(lower: tuple[float, ...], upper: tuple[float, ...], n: int, first: int) -> Surface:
    """All facets of a box of n facets along each edge; two bodies have different `first` nodes."""
    number: dict[tuple[int, ...], int] = {}
    facets = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, n):
            for k, m in np.ndindex(n, n):
                corners = np.full((4, 3), side)
                corners[:, a], corners[:, b] = [k, k + 1, k + 1, k], [m, m, m + 1, m + 1]
                facets.append([number.setdefault(tuple(c), len(number)) for c in corners.tolist()])
    low, high = np.array(lower), np.array(upper)
    points = low + np.array(list(number)) / n * (high - low)
    nodes = np.array(facets, dtype=np.int64)
    inside = np.tile(0.5 * (low + high), (len(nodes), 1))
    return Surface.of(3, nodes + first, points[nodes], inside)


@pytest.mark.parametrize("shift", [0.0, 0.1, -0.3])
@pytest.mark.parametrize("size", [1.0, 0.5, 2.0])
@pytest.mark.parametrize("depth", [0.0, 0.2, -0.2])
def test_only_sides_that_face_each_other_meet_of_two_whole_boxes(
    shift: float, size: float, depth: float
) -> None:
    """The far sides of two boxes do not overlap, though their normals are opposite."""
    lower = closed_box((0, 0, 0), (1, 1, 1), 8, 0)
    above = 1.0 - depth
    upper = closed_box((shift, shift, above), (shift + size, shift + size, above + size), 7, 1000)
    rows = mean_gaps(lower, upper)
    strong = rows.areas > 1e-3 * rows.areas.max()
    along = np.abs(rows.normals[:, 2]) > 0.9
    np.testing.assert_allclose(rows.gaps[strong & along], -depth, atol=1e-12)
    assert rows.gaps[strong].min() >= min(-depth, 0.0) - 1e-12


def test_the_nearest_of_two_layers_counts() -> None:
    """Also if both layers are nearer than a facet is large, and one covers a facet in part."""
    on = patch("triangle", 2, False)
    near = patch("triangle", 5, True, first=1000, height=-0.1)
    far = patch("triangle", 7, True, first=2000, height=-0.2)
    both = Surface(3, *(np.concatenate(x) for x in ((near.nodes, far.nodes),
        (near.points, far.points), (near.normals, far.normals))))  # fmt: skip
    rows, alone = mean_gaps(on, both), mean_gaps(on, near)
    np.testing.assert_allclose(rows.gaps, 0.1, atol=1e-12)
    np.testing.assert_array_equal(rows.node, alone.node)
    np.testing.assert_allclose(rows.value, alone.value, atol=1e-14)


def test_moments_of_tied_rows() -> None:
    """Also of rows with several nodes, on facets that the other side covers in part."""
    on, against = patch("triangle", 3, False), patch("quadrilateral", 3, True, 1000, upper=0.8)
    nothing = Decided(np.zeros(0, np.int64), np.zeros((0, 3), bool), np.zeros(0, np.int64))
    for rows in mean_jumps(on, against, nothing).rows:
        own = rows.node < 1000
        arm = rows.entry_points[own] - rows.points[rows.row[own]]
        force = -rows.value[own, None] * np.eye(3)[rows.component[own]]
        moments = np.zeros((len(rows.nodes), 3))
        np.add.at(moments, rows.row[own], np.cross(arm, force))
        assert np.abs(moments).max() > 1e-3
        np.testing.assert_allclose(rows.moments, moments, atol=1e-14)
