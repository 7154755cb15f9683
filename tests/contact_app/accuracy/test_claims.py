"""Claims of accuracy hold: measured by the energy of a fine mesh of degree 2."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from contact_app.accuracy.refine.levels import Refined
from contact_app.accuracy.refine.refinement import Limits, solve_to_accuracy
from contact_app.accuracy.trust import few_cells
from contact_app.run.solve import solve_scene
from contact_app.scene.bodies import Box
from contact_app.scene.scene import Scene
from tests import scenes

STRIP = """
dimension: 2
bodies:
- name: b
  material: {poisson: 0.3, young: 1000}
  mesh: {box: {lower: [0, 0], upper: [30, 3], cells: [3, 6]}}
  boundaries: {part: {where: "y < 1e-9 and x < 20 + 1e-9"}}
conditions:
- {on: b.x+, displacement: [0, 0]}
- {on: b.part, pressure: 1}
contacts:
- {on: b.y+, obstacle: {plane: {normal: [0, -1], point: [0, 3]}}}
"""
"""Six cells across, three along: 14 % by the estimate of the start, 27.7 % by its energy."""

BLOCK = """
dimension: 2
bodies:
- name: b
  material: {poisson: 0.3, young: 1000}
  mesh: {box: {lower: [0, 0], upper: [4, 1], cells: [2, 4]}}
  boundaries: {part: {where: "y > 1 - 1e-9 and x < 2 + 1e-9"}}
conditions:
- {on: b.x+, displacement: [0, 0]}
- {on: b.part, pressure: 1}
contacts:
- {on: b.y-, obstacle: {plane: {normal: [0, 1], point: [0, 0]}}}
"""
"""16 % by the estimate of the start, 37 % by its energy."""

BEAM = """
dimension: plane_stress
bodies:
- name: b0
  material: {poisson: 0.45, young: 1}
  mesh: {box: {cell: quadrilateral, cells: [3, 3], lower: [0.749, -0.648], upper: [30.749, 2.352]}}
  boundaries: {part: {where: "abs(x - 0.749) < 1e-9 and y < 1.352 + 1e-9"}}
conditions:
- {on: b0.x+, displacement: [0, 0]}
- {on: b0.part, pressure: 2.1264056294419435e-05}
- {on: b0.y-, pressure: -0.0005509436145772304}
contacts:
- {on: b0.x-, obstacle: {plane: {normal: [1, 0], point: [0.7492940048397999, -0.648]}}}
- {on: b0.y-, obstacle: {plane: {normal: [0, 1], point: [0.749, -0.6483057901016093]}}}
- {on: b0.y+, obstacle: {plane: {normal: [0, -1], point: [0.749, 2.352]}}}
"""
"""34 % by its estimate, 194 % by its energy."""

COLUMN = """
dimension: plane_stress
bodies:
- name: b0
  material: {poisson: 0.49, young: 1000}
  mesh: {box: {cell: quadrilateral, cells: [2, 2], lower: [-0.906, 0.443], upper: [0.094, 3.443]}}
  boundaries: {part: {where: "abs(x - 0.094) < 1e-9 and y < 1.943 + 1e-9"}}
conditions:
- {on: b0.y-, displacement: [-0.0008572268722909389, 0.00026273441229373185]}
- {on: b0.x-, pressure: 0.7700236338017097}
- {on: b0.part, pressure: -0.5536847684326909}
contacts:
- {on: b0.x+, obstacle: {plane: {normal: [-1, 0], point: [0.094, 0.443]}}}
- {on: b0.y+, obstacle: {plane: {normal: [0, -1], point: [-0.906, 3.442857467228982]}}}
"""
"""29 % by its estimate, 57 % by its energy."""


def built(text: str, accuracy: float | None = None) -> Scene:
    """The scene of a text, as the command line reads it."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "scene.yaml"
        path.write_text(text, encoding="utf-8")
        return scenes.read(path, [] if accuracy is None else [f"accuracy={accuracy}"])


def fine_energy(text: str) -> float:
    """J on a mesh of degree 2 whose cells are 16 times finer than the start's."""
    scene = built(text)
    (body,) = scene.bodies
    assert isinstance(body.mesh, Box)
    cells = tuple(16 * n for n in body.mesh.cells)
    fine = replace(body, degree=2, mesh=replace(body.mesh, cells=cells))
    found = solve_scene(replace(scene, bodies=(fine,))).summary["solution"]["energy"]
    return float(found)


def measured(found: Refined, energy: float) -> float:
    excess = found.solved.summary["solution"]["energy"] - energy
    return math.sqrt(max(2.0 * excess, 0.0) / found.solved.accuracy.square)


@pytest.mark.parametrize(("text", "target"), [(STRIP, 0.15), (STRIP, 0.3), (BLOCK, 0.2)])
def test_a_start_of_a_few_cells_is_no_basis_for_a_claim(text: str, target: float) -> None:
    found = solve_to_accuracy(built(text, target), solve_scene)
    assert not found.missed
    assert len(found.levels) > 1
    assert found.levels[-1].error <= target
    assert measured(found, fine_energy(text)) <= 1.05 * target


def test_unconfirmed_targets_are_not_met() -> None:
    """A run that may not refine reports that its estimate is not accepted, and the reason."""
    found = solve_to_accuracy(built(STRIP, 0.15), solve_scene, limits=Limits(levels=1))
    assert found.levels[-1].error <= 0.15
    assert "no other mesh confirms its estimate" in found.missed


def test_a_fine_start_is_confirmed_by_a_coarse_mesh() -> None:
    """The answer is that of the first mesh; a mesh with a quarter of its cells confirms it."""
    text = STRIP.replace("cells: [3, 6]", "cells: [48, 12], cell: quadrilateral")
    found = solve_to_accuracy(built(text, 0.1), solve_scene)
    assert not found.missed
    assert [level.cells for level in found.levels] == [24 * 6, 48 * 12]
    assert found.solved.summary["mesh"]["cells"] == 48 * 12


@pytest.mark.parametrize("text", [BEAM, COLUMN])
def test_few_cells_cause_a_warning_on_a_single_mesh(text: str) -> None:
    certificate = solve_scene(built(text)).summary["certificate"]
    (warning,) = [w for w in certificate["warnings"] if "its cells are few" in w]
    assert "lock" in warning
    assert "accuracy:" in warning


def test_enough_cells_cause_no_warning() -> None:
    scene = built(COLUMN.replace("cells: [2, 2]", "cells: [4, 4]"))
    assert few_cells(scene.bodies, 0.3) == []
    few = built(COLUMN)
    assert few_cells(few.bodies, 0.3)
    assert few_cells(few.bodies, 0.01) == [], "nearly exact"
    assert few_cells(few.bodies, float("nan")) == [], "nothing is estimated"


def test_a_run_to_an_accuracy_does_not_warn_of_few_cells() -> None:
    """Two meshes have to agree there."""
    certificate = solve_scene(built(COLUMN, 0.1)).summary["certificate"]
    assert not [w for w in certificate["warnings"] if "its cells are few" in w]


@pytest.mark.parametrize("text", [BEAM, COLUMN])
def test_few_cells_to_an_accuracy(text: str) -> None:
    found = solve_to_accuracy(built(text, 0.15), solve_scene)
    assert not found.missed
    assert measured(found, fine_energy(text)) <= 1.05 * 0.15


def test_an_obstacle_between_the_nodes_of_a_start_is_found() -> None:
    """The stress of the start is uniform, its estimate zero; the body swells into a disc."""
    text = """
dimension: 2
bodies:
- name: b
  material: {poisson: 0.342, young: 1000}
  mesh: {box: {lower: [0, 0], upper: [1.444, 0.671], cells: [5, 1]}}
conditions:
- {on: b.x+, displacement: [0, null]}
- {on: b.y-, displacement: [null, 0]}
- {on: b.x-, pressure: 0.55}
contacts:
- {on: b.y+, obstacle: {sphere: {center: [0.722, 4.0136645], radius: 3.343}}}
"""
    assert solve_scene(built(text)).accuracy.total < 1e-6
    found = solve_to_accuracy(built(text, 0.15), solve_scene)
    assert not found.missed
    assert found.solved.summary["solution"]["active_contacts"] > 0


def test_a_mesh_file_of_enough_cells_needs_no_second_mesh() -> None:
    """After refinement the polygons of a round body do not fit into the bore any more."""
    scene = scenes.read("press_fit", ["accuracy=0.001"])
    found = solve_to_accuracy(scene, solve_scene)
    assert not found.missed
    assert len(found.levels) == 1


def test_interference_between_the_nodes_is_found() -> None:
    """A disc stands in a straight side before anything moves, between two nodes."""
    text = """
dimension: 2
bodies:
- name: b
  material: {poisson: 0.19, young: 1000}
  mesh: {box: {lower: [0, 0], upper: [0.75, 1.1], cells: [3, 6], cell: triangle}}
  degree: 1
conditions:
- {on: b.x-, displacement: [0, null]}
- {on: b.y-, displacement: [null, 0]}
- {in: b, force: [0.38, -0.37]}
contacts:
- {on: b.y+, obstacle: {sphere: {center: [0.375, 2.64745], radius: 1.548}}}
"""
    alone = solve_scene(built(text))
    assert any("between the nodes" in w for w in alone.summary["certificate"]["warnings"])
    found = solve_to_accuracy(built(text, 0.3), solve_scene)
    assert not found.missed
    assert found.solved.summary["contacts"][0]["force"][1] < -0.05


def test_meshes_that_are_both_exact_agree() -> None:
    config = """
dimension: 3
bodies:
- {name: b, mesh: {box: {lower: [0, 0, 0], upper: [1, 1, 3], cells: [2, 2, 3]}},
   material: {poisson: 0.1, young: 1000}}
conditions:
- {on: b.x-, displacement: [0, null, null]}
- {on: b.y-, displacement: [null, 0, null]}
- {on: b.z-, displacement: [null, null, 0]}
- {on: b.z+, pressure: 0.9}
contacts:
- {on: b.y+, obstacle: {cylinder: {point: [0, 4, 1], axis: [1, 0, 0], radius: 2}}}
"""
    found = solve_to_accuracy(built(config, 0.3), solve_scene)
    assert not found.missed
    assert len(found.levels) <= 2


def test_where_nothing_is_strained_no_accuracy_is_claimed() -> None:
    """A block is pulled onto a wall that takes all of the load: its strains are rounding errors."""
    text = """
dimension: plane_stress
bodies:
- name: b
  material: {poisson: 0.39, young: 1000}
  mesh: {box: {lower: [0, 0], upper: [0.6, 1.4], cells: [8, 8]}}
  degree: 2
conditions:
- {on: b.y-, displacement: [0, 0]}
- {on: b.y+, pressure: -0.7}
contacts:
- {on: b.y+, obstacle: {plane: {point: [0, 1.4], normal: [0, -1]}}}
"""
    found = solve_to_accuracy(built(text, 0.3), solve_scene)
    assert "not strained" in found.missed
    assert all(level.as_dict()["discretisation"] is None for level in found.levels)
