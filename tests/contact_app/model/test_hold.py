"""Rigid motions that are held on request, and slides that hardly anything resists."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from solver.contact.equilibrium import loose_motions
from solver.tfeti.subdomain.kernels import rigid_motions
from tests import scenes
from tests.scenes import Config
from tests.scenes_on_ranks import summary_of

CELLS = ["quadrilateral", "triangle", "hexahedron", "tetrahedron"]


def block_on_a_floor(cell: str, hold: list[str], along: float) -> Config:
    """A block pressed on a smooth floor that a traction pushes along x: nothing else resists."""
    made = scenes.wall(cell, 4)
    floor = (0.0, 1.0) if scenes.dimension(cell) == 2 else (0.0, 0.0, 1.0)
    made["bodies"][0]["hold"] = hold
    made["conditions"] = [
        {"on": f"block.{scenes.up(cell)}", "traction": scenes.vector(cell, along, 0.0, -7.0)}
    ]
    obstacle = {"plane": {"point": [0.0] * len(floor), "normal": list(floor)}}
    made["contacts"] = [{"on": f"block.{scenes.down(cell)}", "obstacle": obstacle}]
    return made


def free(cell: str) -> list[str]:
    return ["x"] if scenes.dimension(cell) == 2 else ["x", "y", "rz"]


@pytest.mark.parametrize("subdomains", [1, 5])
@pytest.mark.parametrize("cell", CELLS)
def test_the_hold_takes_what_drives_the_motion(cell: str, subdomains: int) -> None:
    summary = solve_scene(scenes.build(block_on_a_floor(cell, free(cell), 0.5), subdomains)).summary
    assert summary["certificate"]["passed"]
    assert not summary["certificate"]["warnings"]
    (reaction,), (floor,) = summary["reactions"], summary["contacts"]
    assert reaction["on"] == "block"
    assert reaction["hold"] == free(cell)
    up = scenes.dimension(cell) - 1
    force, pushed = np.array(reaction["force"]), np.zeros(3)
    pushed[0] = -0.5
    np.testing.assert_allclose(force, pushed, atol=1e-9)
    assert floor["force"][up] == pytest.approx(7.0, rel=1e-6)


def test_what_is_held_does_not_move_in_the_mean() -> None:
    """The mean motion over the surface of a whole body vanishes; other motions do not."""
    made = block_on_a_floor("quadrilateral", ["x"], 0.5)
    solved = solve_scene(scenes.build(made, 1))
    (s,) = solved.model.partition.subdomains
    surface = s.nodes[np.unique(s.reference.facets)]
    points, u = solved.nodes.points[surface], solved.nodes.displacement[surface]
    motions = rigid_motions(points, 2, np.array([0.5, 0.5, 0.0]), 1.0).reshape(-1, 3)
    mean = np.linalg.lstsq(motions, u.ravel(), rcond=None)[0]
    assert abs(mean[0]) < 1e-9 * np.abs(u).max() < abs(mean[1])


def test_a_hold_that_nothing_drives_changes_no_stress() -> None:
    made = block_on_a_floor("hexahedron", [], 0.0)
    without = solve_scene(scenes.build(made, 4))
    made["bodies"][0]["hold"] = ["x", "y", "rz"]
    held = solve_scene(scenes.build(made, 4))
    np.testing.assert_allclose(
        held.cells.von_mises, without.cells.von_mises, rtol=1e-5, atol=1e-5 * 7.0
    )
    (reaction,) = held.summary["reactions"]
    np.testing.assert_allclose(reaction["force"], 0.0, atol=1e-5)
    assert "can move freely" in " ".join(without.summary["certificate"]["warnings"])


def test_a_moment_is_held_about_the_centre() -> None:
    """A block that floats: all motions are held, and the hold has the moment of the load."""
    made = block_on_a_floor("quadrilateral", ["x", "y", "rz"], 2.0)
    made["contacts"] = []
    summary = solve_scene(scenes.build(made, 3)).summary
    (reaction,) = summary["reactions"]
    np.testing.assert_allclose(reaction["force"], [-2.0, 7.0, 0.0], atol=1e-9)
    assert reaction["moment"] == pytest.approx(0.5 * 2.0, abs=1e-9)
    np.testing.assert_allclose(reaction["point"], [0.5, 0.5, 0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hold": ["z"]}, "bodies[0].hold[0] is 'z'; allowed: x, y, rz"),
        ({"hold": ["x", "x"]}, "bodies[0].hold[1] is x, which is given before"),
        ({"hold": ["rz", "x"]}, "displacement conditions stop rz of block already"),
    ],
)
def test_wrong_holds_are_located(change: Any, message: str) -> None:
    made = block_on_a_floor("quadrilateral", [], 0.0)
    made["conditions"].append({"on": "block.x-", "displacement": [None, 0]})
    made["conditions"].append({"on": "block.x+", "displacement": [None, 0]})
    made["bodies"][0] |= change
    with pytest.raises(ConfigurationError) as caught:
        solve_scene(scenes.build(made))
    assert message in str(caught.value)


def test_a_scene_with_a_hold_is_not_halved() -> None:
    made = block_on_a_floor("quadrilateral", ["x"], 0.0)
    found = halved(scenes.build(made))
    assert not found.scene.mirrors
    assert "held on request" in " ".join(found.notes)


def test_slides_along_round_surfaces_are_loose_and_others_are_not() -> None:
    """Normals on an arc of 60° that are off by up to 0.01 rad: only the turn is loose."""
    angle = np.linspace(-np.pi / 6, np.pi / 6, 21) - np.pi / 2
    points = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    tilted = angle + 0.01 * np.sin(40.0 * angle)
    motions = rigid_motions(points, 2, np.zeros(3), 1.0)
    rows = np.einsum("id,idk->ik", np.column_stack([np.cos(tilted), np.sin(tilted)]), motions)
    loose = loose_motions(MPI.COMM_SELF, np.zeros((0, 3)), rows, motions.reshape(-1, 3))
    assert loose.shape == (3, 1)
    np.testing.assert_allclose(np.abs(loose[:, 0]), [0.0, 0.0, 1.0], atol=0.05)
    held = loose_motions(MPI.COMM_SELF, np.eye(3)[2:], rows, motions.reshape(-1, 3))
    assert held.shape == (3, 0)


@pytest.mark.mpi
def test_two_ranks(tmp_path: Path) -> None:
    made = block_on_a_floor("hexahedron", ["x", "y", "rz"], 0.5)
    made["decomposition"] = {"subdomains": 4}
    one, two = (summary_of(made, tmp_path, ranks)["reactions"] for ranks in (1, 2))
    np.testing.assert_allclose(two[0]["force"], one[0]["force"], atol=1e-8)
