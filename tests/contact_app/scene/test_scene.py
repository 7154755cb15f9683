"""The scene: names resolved, dimensions checked, sizes refused before anything is allocated."""

import copy
from typing import Any

import numpy as np
import pytest

from contact_app.errors import ConfigurationError
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from contact_app.scene.obstacles import Cylinder, Plane, Sphere
from contact_app.scene.scene import Scene
from tests import scenes

GIGABYTE = 1e9


def build(made: dict[str, Any], memory: float | None = None) -> Scene:
    return build_scene(Configuration.model_validate(copy.deepcopy(made)), memory=memory)


@pytest.mark.parametrize("name", scenes.ALL)
def test_every_test_scene_is_resolved(name: str) -> None:
    scene = build(scenes.ALL[name]("hexahedron", 2))
    assert scene.dimension == 3
    assert scene.plane is None
    assert all(0 <= c.body < len(scene.bodies) for c in (*scene.contacts, *scene.displacements))


@pytest.mark.parametrize(
    ("given", "dimension", "plane"),
    [
        (3, 3, None),
        ("3", 3, None),
        (2, 2, "strain"),
        ("plane_strain", 2, "strain"),
        ("plane_stress", 2, "stress"),
        ("2 (plane_stress)", 2, "stress"),
    ],
)
def test_dimension(given: int | str, dimension: int, plane: str | None) -> None:
    made = scenes.wall("hexahedron" if dimension == 3 else "quadrilateral", 2)
    made["dimension"] = given
    scene = build(made)
    assert (scene.dimension, scene.plane) == (dimension, plane)


def test_default_cell_follows_the_dimension() -> None:
    for cell in ("hexahedron", "quadrilateral"):
        made = scenes.wall(cell, 2)
        del made["bodies"][0]["mesh"]["box"]["cell"]
        assert build(made).bodies[0].mesh.cell == cell


def test_sizes_of_a_box() -> None:
    box = build(scenes.wall("tetrahedron", 3)).bodies[0].mesh
    assert box.nodes == 64
    assert box.total_cells == 162


def test_vectors_in_the_plane_get_a_third_component() -> None:
    made = scenes.sphere("quadrilateral", 2)
    circle = build(made).contacts[0].obstacle
    assert isinstance(circle, Sphere)
    assert len(circle.center) == 3
    assert circle.center[2] == 0.0


def test_tiny_and_huge_directions_keep_their_meaning() -> None:
    made = scenes.wall("hexahedron", 2)
    for size in (1e-300, 1e50):
        made["contacts"][0]["obstacle"]["plane"]["normal"] = [-size, 0, size]
        plane = build(made).contacts[0].obstacle
        assert isinstance(plane, Plane)
        normal = plane.gap_and_normal(np.zeros((1, 3)))[1][0]
        np.testing.assert_allclose(normal, [-(0.5**0.5), 0, 0.5**0.5])


def refusal(made: dict[str, Any], memory: float | None = None) -> str:
    with pytest.raises(ConfigurationError) as caught:
        build(made, memory)
    return str(caught.value)


def test_three_components_in_the_plane_are_refused() -> None:
    made = scenes.wall("quadrilateral", 2)
    made["conditions"][1]["traction"] = [0, 0, -1]
    assert "conditions[1].traction has 3 components; a traction in 2D has 2" in refusal(made)
    made = scenes.wall("quadrilateral", 2)
    made["contacts"][0]["obstacle"]["plane"]["point"] = [0, 0, 0]
    assert "point has 3 components" in refusal(made)


def test_no_cylinder_in_the_plane() -> None:
    made = scenes.wall("quadrilateral", 2)
    made["contacts"][0]["obstacle"] = {"cylinder": {"point": [3, 0], "axis": [0, 1], "radius": 1}}
    assert "in 2D use sphere, a circle there" in refusal(made)


def test_z_faces_and_z_are_unknown_in_the_plane() -> None:
    made = scenes.wall("quadrilateral", 2)
    made["contacts"][0]["on"] = "block.z+"
    assert "(known: x-, x+, y-, y+)" in refusal(made)
    made = scenes.wall("quadrilateral", 2)
    made["bodies"][0]["boundaries"] = {"top": {"where": "z > 0"}}
    assert "the name 'z'" in refusal(made)


def test_memory_is_estimated_before_anything_is_allocated() -> None:
    memory = 4.0 * GIGABYTE
    made = scenes.wall("hexahedron", 40)
    assert build(made, memory).bodies[0].mesh.cells == (40, 40, 40)
    made = scenes.wall("hexahedron", 400)
    assert "4 GB are available" in refusal(made, memory)
    made = scenes.wall("hexahedron", 60)  # one factor of it all: more than the mesh
    made["decomposition"] = {"subdomains": 1}
    assert "GB are available" in refusal(made, memory)
    made["decomposition"] = {"subdomains": [6, 6, 6]}
    assert build(made, memory).decomposition.subdomains == (6, 6, 6)


def contact_only(obstacle: dict[str, Any]) -> dict[str, Any]:
    made = scenes.wall("hexahedron", 2)
    del made["conditions"][1]
    made["contacts"][0]["obstacle"] = obstacle
    return made


@pytest.mark.parametrize(
    ("obstacle", "loads"),
    [
        ({"plane": {"point": [1.1, 0, 0], "normal": [-1, 0, 0]}}, False),
        ({"plane": {"point": [0.9, 0, 0], "normal": [-1, 0, 0]}}, True),
        ({"sphere": {"center": [2.05, 0.5, 0.5], "radius": 1}}, False),
        ({"sphere": {"center": [1.95, 0.5, 0.5], "radius": 1}}, True),  # misses every corner
        ({"sphere": {"center": [0.5, 0.5, 0.5], "radius": 0.9, "hollow": True}}, False),
        ({"sphere": {"center": [0.5, 0.5, 0.5], "radius": 0.8, "hollow": True}}, True),
        ({"sphere": {"center": [0, 0, 0], "radius": 2, "hollow": True}}, False),  # about a corner
        ({"cylinder": {"point": [0, 0, 0], "axis": [0, 0, 1], "radius": 2, "hollow": True}}, False),
        (
            {"cylinder": {"point": [0, 0, 0], "axis": [0, 0, 1], "radius": 1.4, "hollow": True}},
            True,
        ),
    ],
)
def test_an_overlapping_obstacle_is_a_load(obstacle: dict[str, Any], loads: bool) -> None:
    made = contact_only(obstacle)
    if loads:
        assert len(build(made).contacts) == 1
    else:
        assert "load nothing" in refusal(made)


def test_cylinder() -> None:
    made = contact_only({"cylinder": {"point": [2, 0, 0], "axis": [0, 0, 3], "radius": 1.1}})
    bar = build(made).contacts[0].obstacle
    assert isinstance(bar, Cylinder)
    assert bar.axis == (0.0, 0.0, 1.0)


def test_places_in_the_file_are_stored_for_later_messages() -> None:
    scene = build(scenes.wall("hexahedron", 2))
    assert scene.at("contacts[0]") == "scene: contacts[0]"
    assert scene.at("conditions[7]") == "scene: conditions[7]"
