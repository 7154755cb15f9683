"""Half the body where the other half is its mirror image."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from contact_app.model.symmetry import halved
from contact_app.results.plot.stored import read
from contact_app.run.run import run
from meshes.quadratic import VERTICES, node_vertices
from tests import meshfiles, scenes
from tests.comparison import same_contacts
from tests.rows import covering
from tests.scenes_on_ranks import summary_of


def pressed(cell: str, n: int, degree: int = 1) -> scenes.Config:
    """A block with its foot held, pressed on at its top under a ball, between two walls."""
    d = scenes.dimension(cell)
    sides = ["x-", "x+", *(["y-", "y+"] if d == 3 else [])]
    return scenes.config(
        cell,
        [{**scenes.block(cell, n), "degree": degree}],
        [
            scenes.clamp(cell, f"block.{scenes.down(cell)}"),
            *({"on": f"block.{side}", "pressure": -30} for side in sides[:2]),
            {"in": "block", "force": scenes.vector(cell, 0, 0, 5)},
        ],
        [
            {"on": f"block.{scenes.up(cell)}", "obstacle":
                {"sphere": {"center": scenes.vector(cell, 0.5, 0.5, 1.97), "radius": 1.0}}},
            {"on": "block.x-", "obstacle": scenes.plane(cell, (-0.01, 0, 0), (1, 0, 0.1))},
            {"on": "block.x+", "obstacle": scenes.plane(cell, (1.01, 0, 0), (-2, 0, 0.2))},
        ],
    )  # fmt: skip


def files(made: scenes.Config, directory: Path, name: str) -> tuple[dict[str, Any], Any]:
    """Summary and grid of a run."""
    path = scenes.write(made, directory / f"{name}.yaml")
    assert run(scenes.read(path), directory / name) == 0
    summary = json.loads((directory / name / "summary.json").read_text())
    return summary, read(directory / name)


def from_file(made: scenes.Config, directory: Path, axes: str = "xy") -> scenes.Config:
    """The same on a mesh file that is divided as the box is where it is cut across some axes."""
    made = copy.deepcopy(made)
    box = made["bodies"][0]["mesh"]["box"]
    axes = axes[: len(box["cells"]) - 1]
    mesh = meshfiles.mirrored(box["cell"], box["cells"][0], axes)
    made["bodies"][0]["mesh"] = {"file": str(meshfiles.write(mesh, directory / "block.msh"))}
    return made


@pytest.mark.parametrize(
    ("degree", "cell", "split"), covering([1, 2], list(meshfiles.MESHIO), [1, 3], together=2)
)
def test_the_whole_is_written(cell: str, degree: int, split: int, tmp_path: Path) -> None:
    """The same files as without: mesh, fields, totals; from a half (2D) or a quarter (3D).

    The whole that triangles and tetrahedra are held against is divided as the images are.
    """
    n = 4 if scenes.dimension(cell) == 2 else 2
    made = pressed(cell, n, degree)
    made["decomposition"] = {"subdomains": split}
    simplices = cell in ("triangle", "tetrahedron")
    whole = from_file(made, tmp_path) if simplices else made
    known, grid = files(whole, tmp_path, "known")
    same_as(known, grid, *files({**made, "symmetry": "allow"}, tmp_path, "found"), cell, degree)
    if simplices:
        found = files({**whole, "symmetry": "allow"}, tmp_path, "file")
        same_as(known, grid, *found, cell, degree)


def same_as(
    known: dict[str, Any], grid: Any, found: dict[str, Any], mirrored: Any, cell: str, degree: int
) -> None:
    """Hold the files of what was cut against those of the whole."""
    planes = ["x = 0.5", "y = 0.5"][: scenes.dimension(cell) - 1]
    assert found["symmetry"]["planes"] == planes
    assert found["symmetry"]["solved"]["cells"] * 2 ** len(planes) == known["mesh"]["cells"]
    assert found["mesh"] == known["mesh"]
    assert "symmetry" not in known
    for key in ("energy", "max_displacement", "mean_displacement", "max_contact_pressure"):
        assert found["solution"][key] == pytest.approx(known["solution"][key], rel=1e-7), key
    same_contacts(found, known, 3e-6)
    scale = np.abs(known["solution"]["contact_force"]).max()
    np.testing.assert_allclose(
        found["solution"]["contact_force"], known["solution"]["contact_force"], atol=1e-6 * scale
    )

    assert len(grid.points) == len(mirrored.points)
    distance, place = cKDTree(mirrored.points).query(grid.points)
    assert distance.max() < 1e-12
    assert len(np.unique(place)) == len(place)
    for name, values in grid.point_data.items():
        if name.startswith("nodal_"):
            continue  # beside a plane they are fitted to cells of the solved side alone
        same = np.nan_to_num(mirrored.point_data[name][place], nan=-1.0)
        values = np.nan_to_num(values, nan=-1.0)
        np.testing.assert_allclose(
            same, values, rtol=0, atol=3e-6 * np.abs(values).max(), err_msg=name
        )
    (kind,) = grid.cells
    vertices, d = VERTICES[cell], scenes.dimension(cell)
    distance, order = cKDTree(
        mirrored.points[mirrored.cells[kind][:, :vertices]].mean(axis=1)
    ).query(grid.points[grid.cells[kind][:, :vertices]].mean(axis=1))
    assert distance.max() < 1e-12
    for name, values in grid.cell_data.items():
        same = mirrored.cell_data[name][order]
        np.testing.assert_allclose(
            same, values, rtol=0, atol=3e-6 * np.abs(values).max(), err_msg=name
        )
    # cells are turned alike, and the middles lie amid their vertices
    for these in (grid, mirrored):
        corners = these.points[these.cells[kind]]
        along = {"quadrilateral": [1, 3], "hexahedron": [1, 3, 4]}.get(cell, [1, 2, 3])[:d]
        signed = np.linalg.det((corners[:, along] - corners[:, :1])[..., :d])
        if cell in ("triangle", "tetrahedron"):  # in any order
            assert np.abs(signed).sum() == pytest.approx({2: 2.0, 3: 6.0}[d])
        else:
            assert (signed > 0).all() or (d == 2 and (signed < 0).all())  # as dolfinx has it
        if degree == 2:
            for middle, on in enumerate(node_vertices(cell)[vertices:], vertices):
                away = corners[:, middle] - corners[:, list(on)].mean(axis=1)
                assert np.abs(away).max() < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("mesh", ["box", "file"])
def test_two_ranks(mesh: str, tmp_path: Path) -> None:
    made = pressed("hexahedron" if mesh == "box" else "tetrahedron", 4, 1 if mesh == "box" else 2)
    made = {**made, "symmetry": "allow", "decomposition": {"subdomains": 3}}
    if mesh == "file":
        made = from_file(made, tmp_path)
    one, two = [summary_of(made, tmp_path, ranks) for ranks in (1, 2)]
    assert one["mesh"] == two["mesh"]
    assert one["symmetry"] == two["symmetry"]
    for key in ("energy", "mean_displacement", "max_contact_pressure"):
        assert two["solution"][key] == pytest.approx(one["solution"][key], rel=1e-7), key
    first, second = read(tmp_path / "out1"), read(tmp_path / "out2")
    distance, place = cKDTree(second.points).query(first.points)
    assert distance.max() < 1e-12
    u = first.point_data["displacement"]
    same = second.point_data["displacement"][place]
    np.testing.assert_allclose(same, u, rtol=0, atol=1e-6 * np.abs(u).max())


BALL = {"sphere": {"center": [0.5, 0.4, 1.97], "radius": 1.0}}


@pytest.mark.parametrize(
    ("changed", "planes", "why"),
    [
        ({}, "xy", ""),
        ({"bodies.0.mesh.box.cells": [3, 2, 2]}, "y", "odd number of cells"),
        ({"bodies.0.mesh.box.cell": "tetrahedron"}, "xy", "tetrahedrons of block are made in"),
        ({"conditions.1.pressure": -31}, "y", "conditions[1] has no mirror image"),
        ({"conditions.3.force": [0, 1, 5]}, "x", "conditions[3] has no mirror image"),
        ({"conditions.0.displacement": [0, 0.1, 0]}, "x", "conditions[0] has no mirror image"),
        ({"conditions.0.displacement": [0, 0, 0.1]}, "xy", ""),
        ({"contacts.0.obstacle": BALL}, "x", "contacts[0] has no mirror image"),
        ({"contacts.1.obstacle.plane.normal": [1, 0, 0]}, "y", "contacts[1]"),
        ({"conditions.0.on": "block.left"}, "y", "conditions[0] has no mirror image"),
        ({"conditions.0.on": "block.middle"}, "xy", ""),
        ({"conditions.0.on": "block.deep"}, "xy", ""),
        ({"conditions.1.on": "block.left", "conditions.2.on": "block.right"}, "xy", ""),
        ({"conditions.1.on": "block.left"}, "y", "conditions[1] has no mirror image"),
    ],
)  # fmt: skip
def test_mirror_symmetry_of_scenes(changed: dict[str, Any], planes: str, why: str) -> None:
    made = scenes.changed(pressed("hexahedron", 2), changed)
    made["bodies"][0]["boundaries"] = {
        "left": {"where": "z < 1e-9 and x < 0.6"},
        "right": {"where": "z < 1e-9 and x > 0.4"},
        "middle": {"where": "z < 1e-9 and x > 0.4 and x < 0.6"},
        "deep": {"where": "z < 0.6"},
    }
    found = halved(scenes.build(made))
    assert "".join("xyz"[m.axis] for m in found.scene.mirrors) == planes
    assert why in " ".join(found.notes)


def test_check_reports_the_scene(capsys: pytest.CaptureFixture[str]) -> None:
    from contact_app.run.check import report

    made = scenes.changed(pressed("hexahedron", 2), {"conditions.3.force": [0, 1, 5]})
    report(scenes.build(made))
    assert "`symmetry: allow` would solve one of 2 equal parts" in capsys.readouterr().out
    report(scenes.build({**made, "symmetry": "allow"}))
    text = capsys.readouterr().out
    assert "the scene is symmetric about x = 0.5" in text
    assert "none across y: conditions[3] has no mirror image" in text
    assert "symmetry across x: block.x+ displaced by x = 0" in text
