"""Obstacles: signed distance, outward normal, and what has none."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_app.errors import ConfigurationError
from contact_app.scene import obstacles
from contact_app.scene.obstacles import Cylinder, Obstacle, Plane, Sphere
from contact_app.scene.schema import bodies

SHAPES: dict[str, Obstacle] = {
    "plane": Plane((1.0, 2.0, 3.0), (0.0, 0.0, 5.0)),
    "tilted plane": Plane((0.1, 0.0, 0.0), (1.0, -2.0, 3.0)),
    "sphere": Sphere((0.5, 0.0, -1.0), 2.0),
    "cavity": Sphere((0.5, 0.0, -1.0), 2.0, hollow=True),
    "cylinder": Cylinder((0.0, 1.0, 0.0), (1.0, 1.0, 0.5), 1.5),
    "bore": Cylinder((0.0, 1.0, 0.0), (1.0, 1.0, 0.5), 1.5, hollow=True),
}


def gap(shape: Obstacle, *point: float) -> float:
    return float(shape.gap_and_normal(np.array([point]))[0][0])


def test_plane() -> None:
    assert gap(SHAPES["plane"], 7, 7, 4) == pytest.approx(1)
    assert gap(SHAPES["plane"], 7, 7, 2.5) == pytest.approx(-0.5)
    assert SHAPES["plane"].curvature_radius is None


def test_sphere_and_cavity() -> None:
    assert gap(SHAPES["sphere"], 3.5, 0, -1) == pytest.approx(1)
    assert gap(SHAPES["sphere"], 0.5, 0.5, -1) == pytest.approx(-1.5)
    assert gap(SHAPES["cavity"], 3.5, 0, -1) == pytest.approx(-1)
    assert SHAPES["cavity"].curvature_radius == 2.0


def test_cylinder_and_bore() -> None:
    bar, bore = Cylinder((0, 0, 1), (0, 2, 0), 1), Cylinder((0, 0, 1), (0, 2, 0), 1, hollow=True)
    assert gap(bar, 3, 17, 5) == pytest.approx(4)
    assert gap(bore, 0, -4, 1.25) == pytest.approx(0.75)


@pytest.mark.parametrize("name", SHAPES)
def test_the_normal_is_the_gradient_of_the_gap(name: str) -> None:
    points = np.random.default_rng(1).normal(size=(20, 3)) * 3.0
    gaps, normals = SHAPES[name].gap_and_normal(points)
    step = 1e-6
    for axis in range(3):
        moved = points.copy()
        moved[:, axis] += step
        slope = (SHAPES[name].gap_and_normal(moved)[0] - gaps) / step
        np.testing.assert_allclose(slope, normals[:, axis], atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(SHAPES)), st.tuples(*(st.floats(-10, 10),) * 3))
def test_going_back_by_the_gap_ends_on_the_surface(name: str, point: tuple) -> None:
    points = np.array([point])
    try:
        gaps, normals = SHAPES[name].gap_and_normal(points)
    except ConfigurationError:
        return
    back, _ = SHAPES[name].gap_and_normal(points - gaps[:, None] * normals)
    assert abs(back[0]) < 1e-9


@pytest.mark.parametrize(
    ("shape", "point", "message"),
    [
        (SHAPES["sphere"], (0.5, 0, -1), "centre of the sphere"),
        (SHAPES["cavity"], (0.5, 0, -1), "centre of the sphere"),
        (Cylinder((0, 0, 0), (0, 0, 1), 1), (0, 0, 5), "axis of the cylinder"),
    ],
)
def test_the_middle_has_no_normal(shape: Obstacle, point: tuple, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        shape.gap_and_normal(np.array([point], dtype=float))


def test_keys_of_the_configuration_are_fields_of_the_classes() -> None:
    assert set(obstacles.SHAPES) == set(bodies.Obstacle.known_keys())
    for key, shape in obstacles.SHAPES.items():
        fields = {field.name for field in dataclasses.fields(shape)}
        section = getattr(bodies, shape.__name__)
        assert fields == set(section.known_keys()), key
        assert set(shape.directions) <= fields


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(sorted(SHAPES)),
    st.tuples(*(st.floats(-5, 5),) * 3),
    st.tuples(*(st.floats(0.01, 5),) * 3),
)
def test_a_box_that_is_reached_into_is_never_called_free(
    name: str, corner: tuple, size: tuple
) -> None:
    lower, upper = np.array(corner), np.array(corner) + np.array(size)
    inside = lower + np.random.default_rng(0).random((200, 3)) * (upper - lower)
    try:
        gaps, _ = SHAPES[name].gap_and_normal(inside)
    except ConfigurationError:
        return
    assert SHAPES[name].may_overlap(lower, upper) or (gaps >= 0.0).all()


@pytest.mark.parametrize("name", SHAPES)
def test_description(name: str) -> None:
    assert name.split()[-1] in SHAPES[name].describe()
