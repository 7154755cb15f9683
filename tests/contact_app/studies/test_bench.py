"""The benchmark's methods solve one problem, each in a process of its own."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.outline import partition_scene
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.studies import bench, processes
from contact_app.studies.bench import CONTACT, LINEAR, OURS, SERIES
from contact_app.studies.peers import solve
from contact_app.studies.perturbed import MOVE, write_cube
from contact_app.studies.tables import fill, read
from tests import meshfiles


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, dict]]:
    output = tmp_path_factory.mktemp("bench")
    found: dict[str, dict[str, dict]] = {}
    for row in bench.bench(output, [4], [3], limit=60.0):
        found.setdefault(row["series"], {})[row["method"]] = row
    with (output / "bench.csv").open() as file:
        assert len(list(csv.DictReader(file))) == sum(len(f) for f in found.values())
    assert (output / "bench.png").stat().st_size > 10_000
    return found


@pytest.mark.slow
@pytest.mark.parametrize("series", ["hexahedra", "tetrahedra"])
def test_all_methods_reach_one_energy(rows: dict, series: str) -> None:
    found = rows[series]
    assert set(found) == {OURS, *CONTACT, *LINEAR}
    assert not any(row["note"] for row in found.values())
    energy = found[OURS]["energy"]
    for method in CONTACT:
        assert found[method]["energy"] == pytest.approx(energy, rel=1e-8)
        assert found[method]["penetration"] < 1e-8
    for method in LINEAR:
        assert found[method]["energy"] == pytest.approx(found["linear-cholmod"]["energy"], rel=1e-9)
        assert found[method]["energy"] < energy * 1.005
        assert found[method]["penetration"] > 1e-3
    assert found["one-factor"]["subdomains"] == 1
    assert found[OURS]["subdomains"] >= (1 if series == "hexahedra" else 2)
    assert max(row["energy_error"] for row in found.values()) < 1e-8


def test_a_method_that_takes_too_long_is_left_out_from_then_on(tmp_path: Path) -> None:
    asked = []

    def run(method, series, mesh, dofs, tolerance, limit):
        n = round((dofs / 3) ** (1 / 3)) - 1
        asked.append((method, n))
        if method == "tao-bnls" and n > 4:
            raise processes.RunError("not done after 1 s")
        return {"energy": -1.0, "seconds": 1.0, "peak_rss_gb": 1.0}

    found = list(bench.bench(tmp_path, [4, 6, 8], [], methods=[OURS, "tao-bnls"], run=run))
    notes = [row["note"] for row in found if row["method"] == "tao-bnls"]
    assert notes == ["", "not done after 1 s", "left out after a smaller mesh"]
    assert ("tao-bnls", 8) not in asked
    assert (OURS, 8) in asked
    assert bench.line(found[-1]).endswith("left out after a smaller mesh")

    def faster(*_):
        return {"energy": -1.0, "seconds": 0.5, "peak_rss_gb": 1.0}

    list(bench.bench(tmp_path, [6], [], methods=["tao-bnls"], run=faster))
    rows = {(row["cells"], row["method"]): row for row in read(tmp_path / "bench.csv", bench.TEXTS)}
    assert len(rows) == 6
    assert rows[6, "tao-bnls"]["seconds"] == 0.5
    assert rows[6, "tao-bnls"]["energy_error"] == 0.0
    assert rows[6, OURS]["seconds"] == 1.0
    table = (tmp_path / "bench.md").read_text()
    assert "| 1,029 | 1 s, 1 GB | 0.5 s, 1 GB |" in table
    assert "| 2,187 | 1 s, 1 GB | left out after a smaller mesh |" in table


def test_a_process_out_of_time_or_in_error_is_reported() -> None:
    with pytest.raises(processes.RunError, match=r"not done after 0\.5 s"):
        processes.python("-c", "import time; time.sleep(30)", limit=0.5)
    with pytest.raises(processes.RunError, match="ValueError: of this"):
        processes.python("-c", "raise ValueError('of this')")
    with pytest.raises(processes.RunError, match="no result"):
        processes.python("-c", "print('text')")
    assert processes.python("-c", "print(1); print('{\"a\": 2}')") == {"a": 2}


def test_energies_are_compared_within_their_family() -> None:
    rows = [
        {"method": OURS, "energy": -1.0, "note": ""},
        {"method": "snes-vi", "energy": -1.1, "note": ""},
        {"method": "linear-gamg", "energy": -3.0, "note": ""},
        {"method": "linear-cholmod", "note": "out of time"},
    ]
    ours, snes, gamg, cholmod = bench.with_energy_error(rows)
    assert ours["energy_error"] == pytest.approx(1 - 1.0 / 1.1)
    assert snes["energy_error"] == 0.0
    assert gamg["energy_error"] == 0.0
    assert "energy_error" not in cholmod


def _scene(*overrides: str) -> Scene:
    return build_scene(load(bench.config(), [*overrides, "solver.tolerance=1e-9"]))


def test_the_cube_in_the_file_is_moved_inside_and_whole(tmp_path: Path) -> None:
    n = 7
    write_cube(tmp_path / "cube.vtu", n)
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


def test_no_parts_of_the_tetrahedra_are_alike(tmp_path: Path) -> None:
    mesh = SERIES[1].mesh(8, tmp_path)
    parts = partition_scene(_scene(*mesh, "decomposition={subdomains: 8}"), MPI.COMM_SELF)
    assert len({id(s.reference) for s in parts.subdomains}) == len(parts.subdomains) == 8


def test_peers_agree_on_the_tetrahedra(tmp_path: Path) -> None:
    overrides = (*SERIES[1].mesh(5, tmp_path), "decomposition={subdomains: 4}")
    scene = _scene(*overrides)
    ours = solve_scene(scene).summary
    rows = [solve(scene, "snes-vi-cholmod", 1e-10)[0]]
    if shutil.which("mpirun"):
        given = [part for override in overrides for part in ("--set", override)]
        config = str(bench.config())
        rows += [
            processes.python("-m", "contact_app.studies.peers", "tao-bnls", config, *given, ranks=2)
        ]
        assert rows[1]["ranks"] == 2
    for row, error in zip(rows, (1e-9, 1e-8), strict=False):  # bnls of PETSc 3.22 stalls at 2e-9
        assert row["dofs"] == ours["mesh"]["dofs"] == 3 * 6**3
        assert row["energy"] == pytest.approx(ours["solution"]["energy"], rel=error)


@pytest.mark.parametrize(("cell", "degree"), [("tetrahedron", 1), ("hexahedron", 2)])
def test_peers_take_the_groups_of_a_file(tmp_path: Path, cell: str, degree: int) -> None:
    path = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    scene = _scene(f"bodies.0.mesh={{file: {path}}}", f"bodies.0.degree={degree}",
                   "decomposition=auto")  # fmt: skip
    assert set(scene.bodies[0].mesh.boundaries) >= {"z-", "z+", "x+"}
    row, _, _ = solve(scene, "snes-vi-cholmod", 1e-10)
    ours = solve_scene(scene).summary
    assert row["dofs"] == ours["mesh"]["dofs"]
    assert row["energy"] == pytest.approx(ours["solution"]["energy"], rel=1e-8)


def test_tables_go_into_the_sections_of_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    head, end = "# Page\n\n## One\n\nText.\n\n", "\n| kept |\n\n## Two\n\nMore.\n\n"
    page.write_text(f"{head}| a |\n|---|\n| 1 |\n{end}")
    fill(page, {"One": "| a |\n|---|\n| 2 |\n", "Two": "| b |\n", "Three": "| c |\n"})
    assert page.read_text() == f"{head}| a |\n|---|\n| 2 |\n{end}| b |\n\n## Three\n\n| c |\n"
