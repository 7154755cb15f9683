"""Accuracy as the input, and solves that end at a tolerance suited to the mesh."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contact_app
from contact_app.accuracy.refine.grading import evenness, graded
from contact_app.accuracy.refine.levels import with_levels
from contact_app.accuracy.refine.next_mesh import next_factor, refined
from contact_app.accuracy.refine.refinement import Limits, solve_to_accuracy
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.memory import needed_bytes
from contact_app.run.files import write_run
from contact_app.run.progress import Progress
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from meshes.graded import graded_box
from meshes.unstructured import CellMesh
from tests import scenes
from tests.comparison import solve

DATA = Path(__file__).parents[2] / "data"


def shipped(name: str, *overrides: str) -> Scene:
    return scenes.read(name, overrides)


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("name", "share"),
    [("cube", 2 / 3), ("sphere", 2 / 3), ("bushing", 2 / 3), ("flat_punch", 2 / 3), ("stack", 0.8)],
)
def test_auto_saves_a_third_of_the_products_and_no_accuracy(name: str, share: float) -> None:
    """The saving is a fifth if each of several bodies needs a tenth of its own error."""
    converged = solve_scene(shipped(name)).summary
    auto = solve_scene(shipped(name, "solver.tolerance=auto")).summary
    assert auto["solver"]["converged"]
    spent = auto["solver"]["hessian_multiplications"]
    assert spent <= share * converged["solver"]["hessian_multiplications"]
    accuracy = auto["accuracy"]
    assert accuracy["total"] <= 1.05 * converged["accuracy"]["total"]
    assert accuracy["algebraic"] <= 0.1 * accuracy["discretisation"]


def test_auto_keeps_the_contract_of_a_tolerance() -> None:
    """All numbers of the certificate are below the tolerance it chose and reports."""
    summary = solve_scene(shipped("cube", "solver.tolerance=auto")).summary
    tolerance = summary["solver"]["tolerance"]
    assert tolerance == pytest.approx(0.1 * summary["accuracy"]["discretisation"])
    certificate = summary["certificate"]
    assert certificate["passed"]
    for name in ("max_penetration", "max_gluing_jump", "complementarity", "duality_gap"):
        assert certificate[name] <= tolerance


def test_a_loose_answer_of_multigrid_has_an_estimate() -> None:
    """The first answer on one quadrilateral of degree 2 leaves half a percent of the load."""
    made = scenes.wall("quadrilateral", 1)
    made["conditions"][1] = {"on": "block.y+", "pressure": 10.0}
    made["solver"], made["accuracy"] = {"method": "primal"}, 0.2
    accuracy = contact_app.solve(made).summary["accuracy"]
    assert accuracy["met"]
    assert accuracy["total"] < 0.2


def test_auto_ends_where_the_mesh_is_exact() -> None:
    """A patch test has no discretisation error to follow: the tightest tolerance counts."""
    accuracy = solve_scene(shipped("block_2d", "solver.tolerance=auto")).accuracy
    assert accuracy.total <= 2e-4
    assert accuracy.algebraic <= 1e-4


@pytest.mark.parametrize(
    ("errors", "target", "whole", "expected"),
    [
        ([0.3], 0.2, False, 1.5),  # order 1 until two meshes tell
        ([0.3], 0.2, True, 2.0),
        ([0.9], 0.01, False, 2.0),  # no farther than twice
        ([0.2, 0.2 / 2**0.5], 0.105, False, 2 * (2**0.5 / 1.05) ** 2),  # a singularity
    ],
)
def test_the_next_mesh(errors: list[float], target: float, whole: bool, expected: float) -> None:
    factors = [1.0, 2.0][: len(errors)]
    assert next_factor(factors, errors, target, whole) == pytest.approx(min(expected, 4.0))


def weight_config(cell: str, accuracy: float) -> scenes.Config:
    made = scenes.column(cell, 2, scenes.weight(cell, 0, 0, -20.0))
    made["accuracy"] = accuracy
    del made["solver"]
    return made


@pytest.mark.parametrize(
    ("cell", "accuracy"), [("hexahedron", 0.1), ("quadrilateral", 0.05), ("triangle", 0.1)]
)
def test_an_accuracy_is_met_with_no_more_than_it_takes(cell: str, accuracy: float) -> None:
    """Against the exact energy, and against the best mesh of a sweep."""
    scene = scenes.build(weight_config(cell, accuracy))
    found = solve_to_accuracy(scene, solve_scene)
    assert not found.missed
    exact = -(20.0**2) / (6 * scenes.confined_modulus(1000.0, 0.3))
    energy = found.solved.summary["solution"]["energy"]
    assert np.sqrt(max(energy - exact, 0.0) / -exact) <= accuracy * 1.001
    assert len(found.levels) <= 5
    dofs = [level.dofs for level in found.levels]
    assert dofs == sorted(dofs)
    best = next(
        solved.summary["mesh"]["dofs"]
        for n in range(2, 40)
        for finer in (replace(scene, bodies=refined(scene.bodies, n / 2)),)
        if (solved := solve_scene(finer)).accuracy.total <= accuracy
    )
    assert dofs[-1] <= 1.5 * best


def test_parts_picked_by_an_expression_stay_where_they_are() -> None:
    """Meshes that are no whole multiple of the start would move the edge of a punch."""
    made = weight_config("quadrilateral", 0.12)
    made["bodies"][0]["boundaries"] = {"left": {"where": "y < 1e-9 and x < 0.5 + 1e-9"}}
    made["contacts"][0]["on"] = "block.left"
    made["bodies"][0]["degree"] = 1
    edges = []

    def observed(scene: Scene, start: LastLevel | None) -> SolvedScene:
        solved = solve_scene(scene, start=start)
        edges.append(np.isclose(solved.nodes.points[:, 0], 0.5, atol=1e-12).any())
        return solved

    found = solve_to_accuracy(scenes.build(made), observed)
    assert not found.missed
    assert len(edges) == len(found.levels) > 3
    assert all(edges)


def test_the_price_of_each_level_is_reported(tmp_path: Path) -> None:
    scene = scenes.build(weight_config("quadrilateral", 0.1))
    assert run(scene, tmp_path) == 0
    summary: dict[str, Any] = json.loads((tmp_path / "summary.json").read_text())
    assert summary["accuracy"]["target"] == 0.1
    assert summary["accuracy"]["met"] is True
    assert summary["accuracy"]["total"] <= 0.1
    assert summary["levels"][-1]["dofs"] == summary["mesh"]["dofs"]
    assert summary["levels"][-1]["total"] == summary["accuracy"]["total"]
    for level in summary["levels"]:
        assert level["hessian_multiplications"] >= 0
        assert level["seconds"] > 0
    log = (tmp_path / "run.log").read_text()
    assert "level 1: 18 degrees of freedom: error" in log


def test_arguments_that_do_not_fit_are_reported() -> None:
    made = weight_config("quadrilateral", 0.01)
    made["bodies"][0]["degree"] = 1
    scene = scenes.build(made)
    limits = Limits(memory=needed_bytes(4000.0))
    refined = solve_to_accuracy(scene, solve_scene, limits=limits)
    summary = with_levels(refined.solved.summary, refined)
    assert summary["accuracy"]["met"] is False
    assert summary["certificate"]["passed"]
    (warning,) = [w for w in summary["certificate"]["warnings"] if "not reached" in w]
    assert "GB are available" in warning


def test_triangles_are_refined_where_the_error_is() -> None:
    """Under a punch, whose energy is known, equal triangles take 100,000 unknowns for 5 %."""
    scene = punch(0.05)
    (body,) = scene.bodies
    lines = [np.linspace(a, b, 17) for a, b in zip(body.mesh.lower, body.mesh.upper, strict=True)]
    mesh = graded_box("triangle", lines)
    scene = replace(scene, bodies=(replace(body, mesh=mesh, degree_given=True),))
    found = solve_to_accuracy(scene, solve_scene)
    assert not found.missed
    assert found.levels[-1].dofs < 20_000
    solution = found.solved.summary["solution"]
    error = np.sqrt((solution["energy"] - 0.60171) / solution["energy"])
    assert 0.4 * 0.05 < error <= 0.05
    fine = found.solved.model.scene.bodies[0].mesh
    assert isinstance(fine, CellMesh)
    x = fine.points[fine.cells]
    size = np.ptp(x, axis=1).max(axis=1)
    smallest = x[size.argmin()].mean(axis=0)
    assert np.linalg.norm(smallest - [1.0, 0.0]) < 0.05, "cells are small at the punch's edge"
    assert size.max() > 20 * size.min()


def test_mesh_files_are_refined_as_a_whole_where_cells_cannot_be() -> None:
    found = solve_to_accuracy(shipped("hertz_disc", "accuracy=0.03"), solve_scene)
    assert not found.missed
    assert found.levels[1].cells == 4 * found.levels[0].cells
    mixed = solve_to_accuracy(shipped("roller_on_block", "accuracy=0.06"), solve_scene)
    assert not mixed.missed
    assert mixed.levels[-1].cells < 4 * mixed.levels[0].cells


def test_a_given_tolerance_does_not_change() -> None:
    made = weight_config("quadrilateral", 0.2)
    assert scenes.build(made).solver.tolerance == "auto"
    made["solver"] = {"tolerance": 1e-9}
    assert scenes.build(made).solver.tolerance == 1e-9
    assert solve(made, [2, 2]).summary["solver"]["tolerance"] == 1e-9


def test_grid_lines_share_the_error_equally() -> None:
    """An error density of x^-2 for cells of unit length: a grid of x ~ t³ at best."""
    grid = np.linspace(0.0, 1.0, 65)
    for _ in range(8):
        middles, thickness = 0.5 * (grid[1:] + grid[:-1]), np.diff(grid)
        squares = thickness**3 / middles**1.5
        grid = graded(grid, squares, 32, np.array([0.0, 1.0]))
    assert len(grid) == 33
    assert np.all(np.diff(grid) > 0)
    squares = np.diff(grid) ** 3 / (0.5 * (grid[1:] + grid[:-1])) ** 1.5
    assert squares[2:-2].max() < 2.0 * squares[2:-2].min()
    thickness = np.diff(grid)
    assert max(thickness[1:] / thickness[:-1]) < 1.7


def test_grid_lines_that_are_fixed_stay() -> None:
    fixed = np.array([0.0, 0.3, 1.0])
    grid = graded(np.linspace(0, 1, 11), np.geomspace(1, 1e-6, 10), 20, fixed)
    assert set(fixed) <= set(grid)
    assert abs(len(grid) - 21) <= 1
    assert np.all(np.diff(grid) > 0)


def test_the_degree_is_chosen_where_the_file_leaves_it_open() -> None:
    """Own weight: the stress is linear, degree 2 exact; a degree that is given is kept."""
    made = weight_config("quadrilateral", 0.02)
    chosen = solve_to_accuracy(scenes.build(made), solve_scene)
    assert chosen.solved.model.scene.bodies[0].degree == 2
    assert chosen.levels[-1].total < 1e-2
    made["bodies"][0]["degree"] = 1
    given = solve_to_accuracy(scenes.build(made), solve_scene)
    assert given.solved.model.scene.bodies[0].degree == 1
    assert given.levels[-1].dofs > 10 * chosen.levels[-1].dofs


def punch(accuracy: float) -> Scene:
    return scenes.read(DATA / "flat_punch.yaml", [f"accuracy={accuracy}"])


def test_the_error_with_the_best_grid_lines_is_predicted() -> None:
    even = [[np.full(8, 2.0), np.full(4, 4.0)]]
    assert evenness(even) == pytest.approx(1.0)
    uneven = [[np.full(8, 2.0), np.array([8.0, 8.0, 0.0, 0.0])]]  # half the layers would do: h³
    assert evenness(uneven) == pytest.approx(0.5)
    assert evenness([*even, *uneven]) == pytest.approx(np.sqrt(0.625))
    assert evenness([[np.zeros(3), np.zeros(3)]]) == 1.0


def test_smooth_answers_with_a_narrow_contact_take_few_unknowns() -> None:
    """Hertz's disc to 1 %: equal cells of degree 2 take 30,000."""
    wanted = ["bodies.0.mesh.box.cells=[8,8]", "accuracy=0.01", "decomposition=auto"]
    scene = scenes.read(DATA / "hertz.yaml", wanted)
    found = solve_to_accuracy(scene, solve_scene)
    assert not found.missed
    assert found.levels[-1].dofs < 2_500
    assert sum(level.dofs for level in found.levels) < 5_000


def test_singularities_are_met_by_graded_cells() -> None:
    """Equal cells take 157,000 unknowns for 5 % under a punch, whose energy is known."""
    found = solve_to_accuracy(punch(0.05), solve_scene)
    assert not found.missed
    assert found.levels[-1].dofs < 3_000
    solution = found.solved.summary["solution"]
    error = np.sqrt((solution["energy"] - 0.60173) / solution["energy"])
    assert 0.4 * 0.05 < error <= 0.05
    edge = found.solved.model.scene.bodies[0].mesh
    assert np.isclose(edge.points[:, 0], 1.0, atol=1e-12).any()  # type: ignore[attr-defined]


def test_a_polygon_is_not_refined_for_ever() -> None:
    """Shaft and hub with straight edges: finer cells stay on the facets, and the run says so."""
    straight = ["bodies.0.degree=1", "bodies.1.degree=1", "accuracy=0.01"]
    found = solve_to_accuracy(shipped("interference_fit", *straight), solve_scene)
    assert len(found.levels) == 2
    assert "contacts[0]: finer cells stay on the flat facets" in found.missed


def test_an_interrupted_run_keeps_the_last_finished_level(tmp_path: Path) -> None:
    """Stopped at the first step of the second level, it writes the first."""
    solved: list[SolvedScene] = []

    def solve(scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        stops = len(solved) == 1
        solved.append(solve_scene(scene, start=start, monitor=lambda event: stops))
        return solved[-1]

    scene = shipped("hertz_disc", "accuracy=1e-3", "output.xdmf=true")
    found = solve_to_accuracy(scene, solve)
    assert len(solved) == 2
    assert not solved[1].solution.converged
    summary, files = write_run(found.solved, found, tmp_path, Progress(False))
    for record in (summary, json.loads((tmp_path / "summary.json").read_text())):
        assert len(record["levels"]) == 1
        assert record["mesh"]["dofs"] == solved[0].summary["mesh"]["dofs"]
        assert record["certificate"]["passed"]
        assert not record["accuracy"]["met"]
        assert (
            "interrupted in level 2; the results are those of level 1"
            in (record["certificate"]["warnings"][-1])
        )
    assert all(path.is_file() for path in files if path.suffix in (".xdmf", ".json"))
    assert found.solved.model.problem.classes[0].inverse is None


def test_a_run_interrupted_in_its_first_level_writes_partial_results() -> None:
    def solve(scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        return solve_scene(scene, start=start, monitor=lambda event: True)

    found = solve_to_accuracy(shipped("sphere", "accuracy=1e-3"), solve)
    assert found.missed == "the run was interrupted"
    assert not found.solved.solution.converged


def test_a_run_interrupted_after_a_level_builds_no_further_mesh() -> None:
    """The model of the next level may take minutes: it is not begun."""
    solves: list[int] = []

    def solve(scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        solves.append(scene.bodies[0].mesh.total_cells)
        return solve_scene(scene, start=start)

    scene = shipped("hertz_disc", "accuracy=1e-3")
    found = solve_to_accuracy(scene, solve, stop=lambda: len(solves) == 2)
    assert found.missed == "the run was interrupted"
    assert len(solves) == len(found.levels) == 2
    assert found.solved.solution.converged
