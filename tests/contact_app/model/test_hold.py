"""Rigid motions that are held on request, and slides that hardly anything resists."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from solver.contact.equilibrium import loose_motions
from solver.rigid_motions import rigid_motions
from tests import meshfiles, scenes
from tests.comparison import certified_in_and_slid
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
def test_the_hold_carries_the_driving_force(cell: str, subdomains: int) -> None:
    summary = solve_scene(scenes.build(block_on_a_floor(cell, free(cell), 0.5), subdomains)).summary
    assert summary["certificate"]["passed"]
    (warning,) = summary["certificate"]["warnings"]
    assert warning.startswith("`hold` on block carries a force of 0.5 and a moment of")
    (reaction,), (floor,) = summary["reactions"], summary["contacts"]
    assert reaction["on"] == "block"
    assert reaction["hold"] == free(cell)
    up = scenes.dimension(cell) - 1
    force, pushed = np.array(reaction["force"]), np.zeros(3)
    pushed[0] = -0.5
    np.testing.assert_allclose(force, pushed, atol=1e-9)
    assert floor["force"][up] == pytest.approx(7.0, rel=1e-6)


@pytest.mark.parametrize("size", [1.0, 100.0])
@pytest.mark.parametrize("share", [0.03, 0.08])
def test_the_lever_of_a_held_turn_is_that_about_its_axis(size: float, share: float) -> None:
    """A long bar lies on a floor, and forces at its ends turn it about the floor's normal."""
    bar = scenes.block("hexahedron", 1, "bar", upper=(size, size, 10.0 * size))
    bar["mesh"]["box"]["cells"] = [1, 1, 5]
    bar["hold"] = ["x", "z", "ry"]
    turning = 0.5 * share * 10.0  # the area of the side is ten times that of an end
    conditions = [
        {"on": "bar.y+", "traction": [0.0, -1.0, 0.0]},
        {"on": "bar.z+", "traction": [turning, 0.0, 0.0]},
        {"on": "bar.z-", "traction": [-turning, 0.0, 0.0]},
    ]
    floor = scenes.plane("hexahedron", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    contacts = [{"on": "bar.y-", "obstacle": floor}]
    made = scenes.config("hexahedron", [bar], conditions, contacts)
    summary = solve_scene(scenes.build(made, 1)).summary
    moment = summary["reactions"][0]["moment"]
    assert abs(moment[1]) == pytest.approx(10.0 * turning * size**3, rel=1e-6)
    warnings = " ".join(summary["certificate"]["warnings"])
    assert ("`hold` on bar carries" in warnings) == (share > 0.05)


@pytest.mark.parametrize("subdomains", [1, 8])
def test_a_held_motion_is_zero_in_the_mean(subdomains: int) -> None:
    """The mean motion over the surface of the whole body vanishes; other motions do not."""
    made = block_on_a_floor("quadrilateral", ["x"], 0.5)
    solved = solve_scene(scenes.build(made, subdomains))
    points = solved.nodes.points
    assert len(points) == 25  # each once, and those of the surface have equal weights
    surface = np.any((points[:, :2] == 0.0) | (points[:, :2] == 1.0), axis=1)
    u, motions = (
        solved.nodes.displacement[surface],
        rigid_motions(points[surface], 2, np.array([0.5, 0.5, 0.0]), 1.0).reshape(-1, 3),
    )
    mean = np.linalg.lstsq(motions, u.ravel(), rcond=None)[0]
    assert abs(mean[0]) < 1e-9 * np.abs(u).max() < abs(mean[1])


@pytest.mark.parametrize("cell", CELLS)
def test_where_a_contact_resists_the_hold_is_one_for_all_decompositions(cell: str) -> None:
    """The floor stops the block from tilting as the hold does: they share the moment."""
    hold = ["x", "rz"] if scenes.dimension(cell) == 2 else ["x", "y", "ry", "rz"]
    found = []
    for subdomains, method in ((1, "active-set"), (8, "active-set"), (1, "primal")):
        made = block_on_a_floor(cell, hold, 3.0)
        made["solver"]["method"] = method
        if method == "primal":
            made.pop("decomposition", None)
            summary = solve_scene(scenes.build(made)).summary
        else:
            summary = solve_scene(scenes.build(made, subdomains)).summary
        assert summary["certificate"]["passed"]
        (reaction,) = summary["reactions"]
        moment = np.append(reaction["moment"], summary["solution"]["max_displacement"])
        found.append([summary["solution"]["energy"], *moment])
    np.testing.assert_allclose(found[1:], found[:1] * 2, rtol=1e-6, atol=1e-5)
    moment = found[0][1:-1]
    assert np.abs(moment).max() > 0.05  # the floor leaves a part of it to the hold


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
@pytest.mark.parametrize("method", ["active-set", "primal"])
def test_ranks(method: str, tmp_path: Path) -> None:
    """The floor resists the held tilt: every rank has a part of the rows that hold it."""
    made = block_on_a_floor("tetrahedron", ["x", "y", "ry", "rz"], 3.0)
    made["solver"] = {"method": method, "tolerance": 1e-9}
    if method == "active-set":
        made["decomposition"] = {"subdomains": 5}
    one = solve_scene(scenes.build(made)).summary["reactions"][0]
    for ranks in (2, 3):
        found = summary_of(made, tmp_path, ranks)["reactions"][0]
        np.testing.assert_allclose(found["force"], one["force"], atol=1e-8)
        np.testing.assert_allclose(found["moment"], one["moment"], atol=1e-6)
    assert np.abs(one["moment"]).max() > 0.05


def shoe_between_races(directory: Path, tolerance: float) -> Config:
    """A sector between two circles whose centres lie 0.04 apart: a small load turns it far."""
    mesh = meshfiles.block("quadrilateral", 6, 0.0)
    radius, angle = 10.0 - 2.0 * mesh.points[:, 1], (mesh.points[:, 0] - 2.0) * np.pi / 3.0
    mesh.points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle])
    outer = {"sphere": {"center": [0.0, 0.02], "radius": 10.02, "hollow": True}}
    inner = {"sphere": {"center": [0.0, -0.02], "radius": 7.982}}  # 0.002 too large
    return {
        "dimension": "plane_strain",
        "bodies": [
            {
                "name": "shoe",
                "mesh": {"file": str(meshfiles.write(mesh, directory / "shoe.msh"))},
                "material": {"young": 2e5, "poisson": 0.3},
            }
        ],
        "conditions": [{"on": "shoe.x-", "traction": [0.1, 0.0]}],
        "contacts": [{"on": "shoe.y-", "obstacle": outer}, {"on": "shoe.y+", "obstacle": inner}],
        "solver": {"tolerance": tolerance},
    }


def test_a_large_spin_does_not_loosen_the_tolerance(tmp_path: Path) -> None:
    """Penetration and jumps are below the tolerance relative to the displacement without the
    spin."""
    tolerance = 1e-2
    solved = solve_scene(scenes.build(shoe_between_races(tmp_path, tolerance), 4))
    points, u = solved.nodes.points, solved.nodes.displacement
    spin = rigid_motions(points, 2, np.zeros(3), 1.0)[:, :, 2].reshape(-1, 1)
    left = u.ravel() - spin @ np.linalg.lstsq(spin, u.ravel(), rcond=None)[0]
    deformed, largest = (np.linalg.norm(v.reshape(-1, 2), axis=1).max() for v in (left, u))
    assert deformed < 0.005 * largest
    assert solved.summary["certificate"]["passed"]
    assert solved.summary["solution"]["max_displacement"] == pytest.approx(largest)
    (slide,) = solved.summary["free_motions"]
    assert slide["without_it"] == pytest.approx(deformed, rel=0.05)
    # it turns about the axis of the races, beside its centre: to hold its centre would take load
    warnings = solved.summary["certificate"]["warnings"]
    assert sum("`hold: [rz]` on the body" in warning for warning in warnings) == 1
    problem = solved.model.problem
    slack = problem.jumps(solved.solution.displacements) / problem.spread
    wrong = np.where(problem.inequality, np.maximum(slack, 0.0), np.abs(slack))
    assert wrong.max() <= tolerance * deformed


def test_a_body_that_is_tied_to_one_that_slides_has_a_warning(tmp_path: Path) -> None:
    """An arm without contacts moves farther than the shoe."""
    made = shoe_between_races(tmp_path, 1e-6)
    (shoe,) = made["bodies"]
    turned = {**shoe["mesh"], "rotate": {"angle": 60.0}}
    made["bodies"].append({**shoe, "name": "arm", "mesh": turned})
    made["contacts"].append({"on": "arm.x-", "against": "shoe.x+", "tied": True})
    warnings = " ".join(solve_scene(scenes.build(made)).summary["certificate"]["warnings"])
    assert "shoe slides by" in warnings
    assert "arm slides by" in warnings


def test_the_reference_length_excludes_free_motions() -> None:
    """A slide of a hundred times the displacement changes neither the reference length nor the
    penetration."""
    solved = solve_scene(scenes.build(block_on_a_floor("quadrilateral", [], 0.0), 4))
    before, after = certified_in_and_slid(solved, 100.0 * solved.solution.measures.displacement)
    assert after[1].displacement > 50.0 * before[1].displacement
    assert after[1].deformations[0] == pytest.approx(before[1].deformations[0])
    assert after[0].max_penetration == pytest.approx(before[0].max_penetration)
    assert before[0].max_penetration > 1e-3
