"""PETSc's solvers beside this application, each in a process of its own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from contact_app.studies import processes
from contact_app.studies.parts import CUBE
from contact_app.studies.peers import solve
from contact_app.studies.perturbed import MOVE, write_box
from contact_app.studies.tables import fill
from contact_app.studies.undecomposed import assemble
from tests import meshfiles, scenes
from tests.contact_app.model.test_curved import bent_scene


def test_a_process_out_of_time_or_in_error_is_reported() -> None:
    with pytest.raises(processes.RunError, match=r"not done after 0\.5 s"):
        processes.python("-c", "import time; time.sleep(30)", limit=0.5)
    with pytest.raises(processes.RunError, match="ValueError: of this"):
        processes.python("-c", "raise ValueError('of this')")
    with pytest.raises(processes.RunError, match="no result"):
        processes.python("-c", "print('text')")
    assert processes.python("-c", "print(1); print('{\"a\": 2}')") == {"a": 2}


def cube(mesh: dict[str, Any], *overrides: str) -> Scene:
    given = (f"bodies.0.mesh={json.dumps(mesh)}", "decomposition=auto", "solver.tolerance=1e-9")
    return scenes.read(CUBE, [*given, *overrides])


def test_the_cube_in_the_file_is_moved_inside_and_whole(tmp_path: Path) -> None:
    n = 7
    write_box(tmp_path / "cube.vtu", n)
    mesh = meshio.read(tmp_path / "cube.vtu")
    cells = mesh.cells_dict["tetra"]
    assert cells.shape == (6 * n**3, 4)
    volume = np.abs(np.linalg.det(np.diff(mesh.points[cells], axis=1))) / 6.0
    assert volume.min() > 0.1 / (6 * n**3)
    assert volume.sum() == pytest.approx(1.0, rel=1e-12)  # more if a cell were turned over
    away = n * mesh.points - np.round(n * mesh.points)
    surface = (np.abs(mesh.points - 0.5) > 0.5 - 1e-9).any(axis=1)
    assert surface.sum() == (n + 1) ** 3 - (n - 1) ** 3
    assert np.abs(away[surface]).max() < 1e-12
    assert (np.abs(away[~surface]) > 1e-9).all()
    assert 0.9 * MOVE < np.abs(away).max() <= MOVE


def test_peers_agree_on_the_tetrahedra(tmp_path: Path) -> None:
    write_box(tmp_path / "cube.vtu", 5)
    faces = {"z-": "z < 1e-9", "z+": "z > 1 - 1e-9", "x+": "x > 1 - 1e-9"}
    boundaries = json.dumps({name: {"where": where} for name, where in faces.items()})
    mesh, overrides = {"file": str(tmp_path / "cube.vtu")}, [f"bodies.0.boundaries={boundaries}"]
    scene = cube(mesh, *overrides)
    summary = solve_scene(scene).summary
    rows = [solve(scene, "snes-vi-cholmod", 1e-10)[0]]
    if shutil.which("mpirun"):
        overrides += [f"bodies.0.mesh={json.dumps(mesh)}", "decomposition=auto"]
        given = [part for override in overrides for part in ("--set", override)]
        program = "-m", "contact_app.studies.single_run", str(CUBE), "--method", "tao-bnls", *given
        rows.append(processes.python(*program, ranks=2))
        assert rows[1]["ranks"] == 2
    for row, error in zip(rows, (1e-9, 1e-8), strict=False):  # bnls of PETSc 3.22 stalls at 2e-9
        assert row["dofs"] == summary["mesh"]["dofs"] == 3 * 6**3
        assert row["energy"] == pytest.approx(summary["solution"]["energy"], rel=error)


@pytest.mark.parametrize(("cell", "degree"), [("tetrahedron", 1), ("hexahedron", 2)])
def test_peers_take_the_groups_of_a_file(tmp_path: Path, cell: str, degree: int) -> None:
    path = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    scene = cube({"file": str(path)}, f"bodies.0.degree={degree}")
    assert set(scene.bodies[0].mesh.boundaries) >= {"z-", "z+", "x+"}
    row, _, _ = solve(scene, "snes-vi-cholmod", 1e-10)
    summary = solve_scene(scene).summary
    assert row["dofs"] == summary["mesh"]["dofs"]
    assert row["energy"] == pytest.approx(summary["solution"]["energy"], rel=1e-8)


@pytest.mark.parametrize(
    ("cell", "name"), [("quadrilateral", "quad9"), ("hexahedron", "hexahedron20")]
)
def test_peers_take_curved_cells(cell: str, name: str, tmp_path: Path) -> None:
    """With two materials, two loads and a round obstacle."""
    scene = scenes.build(bent_scene(cell, name, tmp_path))
    row, _, _ = solve(scene, "snes-vi-cholmod", 1e-10)
    summary = solve_scene(scene).summary
    assert summary["solution"]["active_contacts"] > 0
    assert row["energy"] == pytest.approx(summary["solution"]["energy"], rel=1e-8)


def test_linear_peers_take_curved_tetrahedra(tmp_path: Path) -> None:
    made = bent_scene("tetrahedron", "tetra10", tmp_path) | {"contacts": []}
    for degree, nodes in ((2, 5**3), (1, 3**3)):
        made["bodies"][0]["degree"] = degree
        scene = scenes.build(made)
        row, _, _ = solve(scene, "linear-gamg", 1e-10)
        summary = solve_scene(scene).summary
        assert row["dofs"] == 3 * nodes
        assert row["energy"] == pytest.approx(summary["solution"]["energy"], rel=1e-8)


def _leaning_planes(tmp_path: Path, last: float) -> Scene:
    """A block beside three planes that lean and a fourth one that is parallel to the first."""
    path = meshfiles.write(meshfiles.block("hexahedron", 4), tmp_path / "block.msh")
    planes = [([1, 0, 0], [-1, 0, 0]), ([0.998, 0, 1], [-1, 0, -0.3]), ([1, 1, 1], [-1, -0.3, 0]),
              ([last, 0, 0], [-1, 0, 0])]  # fmt: skip
    contacts = [
        {"on": "cube.x+", "obstacle": {"plane": {"point": point, "normal": normal}}}
        for point, normal in planes
    ]
    overrides = "bodies.0.degree=1", f"contacts={json.dumps(contacts)}"
    return cube({"file": str(path)}, *overrides)


@pytest.mark.parametrize("method", ["snes-vi-cholmod", "tao-bnls"])
def test_peers_take_nodes_with_several_contact_rows(method: str, tmp_path: Path) -> None:
    scene = _leaning_planes(tmp_path, last=1.01)
    row, system, x = solve(scene, method, 1e-9, nodal=True)
    answer = solve_scene(scene)
    assert row["energy"] == pytest.approx(answer.summary["solution"]["energy"], rel=1e-7)
    assert row["penetration"] <= 1e-9
    assert np.bincount(system.contact // 3).max() == 3
    forces = [np.abs(contact["force"]).max() for contact in answer.summary["contacts"]]
    assert min(forces[:3]) > 0.0


def test_penetration_of_rows_that_are_no_bounds_is_reported(tmp_path: Path) -> None:
    """The fourth plane lies close behind the first one, which is the bound."""
    system = assemble(_leaning_planes(tmp_path, last=1.0 + 1e-6), nodal=True)
    assert len(system.checked.nodes) == 20  # of 25, five are held
    at_rest = system.load.duplicate()
    at_rest.set(0.0)
    assert system.penetration(at_rest) == pytest.approx(2e-3 / np.hypot(1.0, 0.3))
    entered = replace(system.checked, gaps=np.full(20, -1.0))
    assert replace(system, checked=entered).penetration(at_rest) == pytest.approx(1.0)


def test_tables_go_into_the_sections_of_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    head, end = "# Page\n\n## One\n\nText.\n\n", "\n| kept |\n\n## Two\n\nMore.\n\n"
    page.write_text(f"{head}| a |\n|---|\n| 1 |\n{end}")
    fill(page, {"One": "| a |\n|---|\n| 2 |\n", "Two": "| b |\n", "Three": "| c |\n"})
    assert page.read_text() == f"{head}| a |\n|---|\n| 2 |\n{end}| b |\n\n## Three\n\n| c |\n"
