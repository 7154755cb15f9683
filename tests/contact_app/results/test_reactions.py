"""Reactions of supports: they balance loads and contact forces, in forces and moments."""

from typing import Any

import numpy as np
import pytest

from contact_app.model.boundaries import boundary_nodes
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.comparison import load_resultant
from tests.rows import covering
from tests.scenes import Config

CASES = ["wall", "two_bodies", "rollers_and_floor", "tilted_plane"]


def about_origin(records: list[dict[str, Any]], dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums of forces and of moments about the origin."""
    force, moment = np.zeros(3), np.zeros(3)
    for record in records:
        own = record["moment"]
        force += record["force"]
        moment += np.array(own) if dimension == 3 else np.array([0.0, 0.0, own])
        moment += np.cross(record["point"], record["force"])
    return force, moment


@pytest.mark.parametrize(
    ("degree", "cell", "name"),
    covering([1, 2], ["quadrilateral", "triangle", "hexahedron", "tetrahedron"], CASES, together=2),
)
def test_reactions_contacts_and_loads_are_in_balance(name: str, cell: str, degree: int) -> None:
    made = scenes.ALL[name](cell, 4)
    for body in made["bodies"]:
        body["degree"] = degree
    scene = scenes.build(made, 3)
    summary = solve_scene(scene).summary
    assert summary["certificate"]["passed"]
    force, moment = load_resultant(scene)
    against_obstacles = [c for c, k in zip(summary["contacts"], made["contacts"], strict=True)
                         if "obstacle" in k]  # fmt: skip
    for records in (summary["reactions"], against_obstacles):
        f, m = about_origin(records, scene.dimension)
        force, moment = force + f, moment + m
    size = max(np.abs(r["force"]).max() for r in summary["reactions"])
    np.testing.assert_allclose(force, 0.0, atol=1e-6 * size)
    np.testing.assert_allclose(moment, 0.0, atol=1e-6 * size)


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_a_subdomain_that_meets_a_support_in_a_corner_has_its_share(cell: str) -> None:
    """Such a subdomain has a copy of a held node and no facet of the support."""
    made = scenes.wall(cell, 4)
    made["contacts"] = []
    made["conditions"][1]["traction"] = scenes.vector(cell, 3.0, 0.0, 7.0)
    scene = scenes.build(made, 11)
    solved = solve_scene(scene)
    up, body = scene.dimension - 1, scene.bodies[0]
    without_facet = sum(
        len(np.setdiff1d(np.flatnonzero(s.points()[:, up] < 1e-9), boundary_nodes(s, body, foot)))
        for s in solved.model.partition.subdomains
        for foot in [scenes.down(cell)]
    )
    assert without_facet > 0
    (reaction,) = solved.summary["reactions"]
    np.testing.assert_allclose(reaction["force"][0], -3.0, rtol=1e-9)
    np.testing.assert_allclose(reaction["force"][up], -7.0, rtol=1e-9)


def column(cell: str) -> Config:
    """Clamped at the foot and pulled at the top, beside a roller at x-."""
    made = scenes.wall(cell, 4)
    made["contacts"] = []
    made["conditions"][1]["traction"] = scenes.vector(cell, 0.0, 0.0, 7.0)
    roller: list[Any] = [0.0] + [None] * (scenes.dimension(cell) - 1)
    made["conditions"].append({"on": "block.x-", "displacement": roller})
    return made


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("subdomains", [1, 4])
def test_a_shared_component_counts_once(cell: str, subdomains: int) -> None:
    """The edge of foot and roller is held along x by both: the first condition has its reaction."""
    summary = solve_scene(scenes.build(column(cell), subdomains)).summary
    foot, roller = summary["reactions"]
    assert foot["on"] == f"block.{scenes.down(cell)}"
    up = scenes.dimension(cell) - 1
    assert foot["force"][up] == pytest.approx(-7.0, rel=1e-9)
    assert roller["force"][up] == 0.0
    assert foot["force"][0] == pytest.approx(-roller["force"][0], rel=1e-7)
    middle = 0.5 * np.ones(3)[: up + 1]
    middle[up] = 0.0
    np.testing.assert_allclose(foot["point"][: up + 1], middle, atol=1e-12)


def test_a_prescribed_displacement_has_a_reaction() -> None:
    """A bar pulled by 1e-3 of its length in plane stress: σ = E ε."""
    made = scenes.wall("quadrilateral", 4)
    made |= {"dimension": "plane_stress", "contacts": []}
    made["conditions"] = [
        {"on": "block.y-", "displacement": [None, 0.0]},
        {"on": "block.y+", "displacement": [None, 1e-3]},
        {"on": "block.x-", "displacement": [0.0, None]},
    ]
    young = made["bodies"][0]["material"]["young"]
    pulled = solve_scene(scenes.build(made)).summary["reactions"][1]
    assert pulled["force"][1] == pytest.approx(1e-3 * young, rel=1e-9)
    assert pulled["moment"] == pytest.approx(0.0, abs=1e-9 * young)


def test_symmetric_scenes_have_the_reactions_of_the_whole() -> None:
    """Two feet, images of each other: each has its own reaction though one is solved."""
    made = scenes.wall("hexahedron", 4)
    made["contacts"] = []
    made["bodies"][0]["boundaries"] = {
        "left": {"where": "z < 1e-9 and x < 0.3"}, "right": {"where": "z < 1e-9 and x > 0.7"},
    }  # fmt: skip
    made["conditions"] = [
        {"on": "block.left", "displacement": [0, 0, 0]},
        {"on": "block.right", "displacement": [0, 0, 0]},
        {"on": "block.z+", "traction": [0, 0, -50]},
    ]
    whole = solve_scene(scenes.build(made)).summary["reactions"]
    half = halved(scenes.build(made)).scene
    assert len(half.mirrors) == 2
    found = solve_scene(half).summary["reactions"]
    assert [r["on"] for r in found] == ["block.left", "block.right"]
    for a, b in zip(found, whole, strict=True):
        np.testing.assert_allclose(a["force"], b["force"], atol=1e-6 * 50)
        np.testing.assert_allclose(a["moment"], b["moment"], atol=1e-6 * 50)
        np.testing.assert_allclose(a["point"], b["point"], atol=1e-12)


def test_the_shipped_scene_with_a_remote_load_is_in_balance() -> None:
    """The floor carries the force and its moment: its edge is where a beam's would be."""
    summary = solve_scene(scenes.read("remote_load")).summary
    (floor,) = summary["contacts"]
    assert floor["force"][2] == pytest.approx(5000.0, rel=1e-6)
    assert floor["moment"][1] == pytest.approx(-5000.0 * 12.0, rel=1e-6)  # 12 beside the middle
    width = floor["area"] / 40.0
    assert width == pytest.approx(3.0 * (40.0 - 32.0), abs=2.5)  # triangle of pressure
    assert summary["probes"]["top"]["displacement"][0] > 0.0
