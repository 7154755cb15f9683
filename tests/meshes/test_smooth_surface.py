"""The smooth surface over flat facets: heights of circles, cylinders and balls, also at ends."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from meshes.contact_surface import Surface
from meshes.mortar import mean_gaps

RADIUS, FACETS = 10.0, 12


def strip(radius: float, count: int, outward: float, deep: int = 0, cut: bool = False) -> Surface:
    """A quarter of a circle, or of a cylinder of some cells along its axis, of straight facets."""
    angle = np.linspace(0.0, 0.5 * np.pi, count + 1)
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    if deep == 0:
        nodes = np.column_stack([np.arange(count), np.arange(1, count + 1)])
        points = ring[nodes]
    else:
        points = (ring[None] + 2.0 * np.arange(deep + 1)[:, None, None] * [0.0, 0.0, 1.0]).reshape(
            -1, 3
        )
        grid = np.arange(len(points)).reshape(deep + 1, count + 1)
        nodes = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=-1)
        nodes = nodes.reshape(-1, 4)
        if cut:
            nodes = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [0, 2, 3]]])
        points = points[nodes]
    inside = points.mean(axis=1) * [1.0 - outward * 0.1, 1.0 - outward * 0.1, 1.0]
    return Surface.of(2 if deep == 0 else 3, nodes, points, inside)


@pytest.mark.parametrize("deep", [0, 3])
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("outward", [1.0, -1.0])
def test_heights_of_round_surfaces(deep: int, cut: bool, outward: float) -> None:
    """At the middles of facets h²/8R, above a shaft and below a bore, at the ends too."""
    surface = strip(RADIUS, FACETS, outward, deep, cut).smooth()
    assert surface.bulge is not None
    v = surface.vertices.shape[1]
    middles = np.full((len(surface.nodes), v), 1.0 / v)
    found = surface.height(np.arange(len(surface.nodes)), middles)
    away = np.linalg.norm(surface.centres[:, :2], axis=1)
    right = outward * (RADIUS - away)
    np.testing.assert_allclose(found, right, rtol=0.01)


def test_corners_stay_sharp() -> None:
    """Two flat sides of a square have no height."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0]])
    nodes = np.column_stack([np.arange(4), np.arange(1, 5)])
    surface = Surface.of(2, nodes, x[nodes], x[nodes].mean(axis=1) + [-0.1, 0.1, 0.0]).smooth()
    assert surface.bulge is not None
    np.testing.assert_allclose(surface.bulge, 0.0, atol=1e-14)


def test_the_gap_of_arcs_is_that_of_circles() -> None:
    """Polygons of different counts in a distance of 0.05."""
    bore, shaft = strip(RADIUS, 13, -1.0), strip(RADIUS - 0.05, 8, 1.0)
    flat, smooth = mean_gaps(bore, shaft).gaps, mean_gaps(bore.smooth(), shaft.smooth()).gaps
    assert np.abs(flat - 0.05).max() > 0.02
    np.testing.assert_allclose(smooth, 0.05, rtol=0.01)


@pytest.mark.parametrize(("deep", "cut"), [(0, False), (3, False), (3, True)])
@pytest.mark.parametrize("count", [8, 12, 13, 29])
def test_the_gap_of_two_rollers_is_that_at_the_nodes(deep: int, cut: bool, count: int) -> None:
    """At the nearest node and its neighbours; the mean with a dual function is h²/6R less.

    The distance of a node is along its row's normal, to the circle of the other roller.
    """
    distance, sagitta = 0.02, RADIUS * (0.5 * np.pi / FACETS) ** 2 / 8.0
    roller = strip(RADIUS, FACETS, 1.0, deep, cut).smooth()
    other = strip(RADIUS, count, 1.0, deep, cut)
    centre = (2.0 * RADIUS + distance) * np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
    turned = other.points * [-1.0, -1.0, 1.0] + centre
    opposite = Surface.of(
        other.dimension, 1000 + other.nodes, turned, turned.mean(axis=1) + 0.1 * other.normals
    ).smooth()  # fmt: skip
    rows = mean_gaps(roller, opposite)
    along = np.pad(rows.normals, ((0, 0), (0, 3 - rows.normals.shape[1])))
    along /= -np.linalg.norm(along, axis=1, keepdims=True)
    away = (centre - rows.points) * [1.0, 1.0, 0.0]
    ahead = np.einsum("ri,ri->r", away, along)
    right = ahead - np.sqrt(RADIUS**2 - (away**2).sum(axis=1) + ahead**2)
    near = np.abs(np.arctan2(rows.points[:, 1], rows.points[:, 0]) - 0.25 * np.pi) < 0.2
    assert near.sum() >= 3
    np.testing.assert_allclose(rows.gaps[near], right[near], atol=0.2 * sagitta)


@pytest.mark.parametrize("outward", [1.0, -1.0])
def test_heights_on_uneven_triangles_of_a_ball_and_a_cylinder(outward: float) -> None:
    """Vertices at random on the surface: an error of a fiftieth of the largest height."""
    random = np.random.default_rng(4)
    t = np.linspace(-0.9, 0.9, 8)
    plane = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    inside = (np.abs(plane) < 0.89).all(axis=1)
    plane[inside] += 0.07 * random.uniform(-1, 1, (int(inside.sum()), 2))
    triangles = Delaunay(plane).simplices
    for axes in (1, 2):
        below = RADIUS - np.sqrt(RADIUS**2 - ((4.0 * plane[:, :axes]) ** 2).sum(axis=1))
        points = np.column_stack([4.0 * plane, -below])[triangles]
        inside_of = points.mean(axis=1) - [0.0, 0.0, outward]
        surface = Surface.of(3, triangles, points, inside_of).smooth()
        middles = surface.centres
        away = middles + [0.0, 0.0, RADIUS]
        right = outward * (RADIUS - np.linalg.norm(_across(away, axes), axis=1))
        found = surface.height(np.arange(len(middles)), np.full((len(middles), 3), 1.0 / 3.0))
        assert np.abs(right).max() > 0.02
        np.testing.assert_allclose(found, right, atol=0.02 * np.abs(right).max())


def test_heights_are_independent_of_numbers_and_of_rounding_errors() -> None:
    """Facets of several subdomains have coordinates of their own, equal but for rounding errors."""
    random = np.random.default_rng(7)
    plane = random.uniform(-1, 1, (60, 2))
    x, y = 4.0 * plane.T
    points = np.column_stack([x, y, 0.05 * x**2 - 0.02 * y**2 + 0.004 * x**3])
    triangles = Delaunay(plane).simplices

    def height(numbers: np.ndarray, facets: np.ndarray, rounding: float) -> np.ndarray:
        nodes = triangles[facets]
        corners = points[nodes] * (1.0 + rounding * random.uniform(-1, 1, (len(nodes), 3, 3)))
        inside = corners.mean(axis=1) - [0.0, 0.0, 1.0]
        surface = Surface.of(3, numbers[nodes], corners, inside).smooth()
        found = surface.height(np.arange(len(nodes)), np.full((len(nodes), 3), 1.0 / 3.0))
        return np.asarray(found)[np.lexsort(np.round(surface.centres, 9).T)]

    first = height(np.arange(60), np.arange(len(triangles)), 0.0)
    other = height(random.permutation(60), random.permutation(len(triangles)), 4e-16)
    assert np.abs(first).max() > 0.05
    np.testing.assert_allclose(other, first, atol=1e-9)


def _across(points: np.ndarray, axes: int) -> np.ndarray:
    """Components of points from the axis of a cylinder along y, or from the centre of a ball."""
    return points[:, [0, 2]] if axes == 1 else points
