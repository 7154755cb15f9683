"""`contact_app.solve`: the answer of a file and of a mapping, as the command gives it."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import yaml
from mpi4py import MPI

import contact_app
from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.run.run import run
from tests import scenes
from tests.ranks import execute

ROOT = Path(__file__).parents[3]
CUBE = ROOT / "configs" / "cube.yaml"
EXAMPLE = ROOT / "docs" / "guide" / "hertz_in_python.py"


def test_a_file_and_its_description(tmp_path: Path) -> None:
    answer = contact_app.solve(CUBE, ["bodies.0.mesh.box.cells=[6,6,6]"])
    assert answer.certificate.passed
    assert answer.converged
    assert answer.points.shape == (343, 3)
    assert answer.displacement.shape == (343, 3)
    assert answer.stress.shape == (216, 6)
    assert answer.contact_pressure.max() == pytest.approx(
        answer.summary["solution"]["max_contact_pressure"]
    )
    assert (answer.contact_pressure[answer.points[:, 0] < 0.9] == 0.0).all()
    answer.write(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["certificate"]["passed"]
    with meshio.xdmf.TimeSeriesReader(tmp_path / "out" / "solution.xdmf") as reader:
        assert len(reader.read_points_cells()[0]) == 343


def test_a_file_read_by_pyyaml_is_a_mapping() -> None:
    """The key `on` arrives as True."""
    made = yaml.safe_load(CUBE.read_text())
    assert True in made["conditions"][0]
    made["bodies"][0]["material"]["young"] = 2e5  # the text 2.0e5 in YAML 1.1
    made["bodies"][0]["mesh"]["box"]["cells"] = [3, 3, 3]
    assert contact_app.solve(made).converged


STUDY = """
from mpi4py import MPI
import contact_app
from tests import scenes

made = scenes.wall("tetrahedron", 3)
made["conditions"][1]["traction"] = [0, 0, -50 * (1 + MPI.COMM_WORLD.rank)]
for method in ("auto", "primal"):
    made["solver"]["method"] = method
    answer = contact_app.solve(made, comm=MPI.COMM_SELF)
    print(answer.converged, len(answer.points), answer.summary["contacts"][0]["force"][0])
"""


def test_a_study_is_spread_over_the_ranks() -> None:
    """Each rank solves a scene of its own; forces are those of single runs."""
    lines = [line.split() for line in execute(STUDY, ranks=2).splitlines()]
    assert [line[:2] for line in lines] == [["True", "64"]] * 4
    forces = [float(line[2]) for line in lines]
    assert forces[0] == pytest.approx(forces[1], rel=1e-5)
    assert forces[2:] == pytest.approx([2.0 * force for force in forces[:2]], rel=1e-5)


WRONG_OVERRIDES = ["solver.tolerance=1e-8", {"solver.tolerance": 1e-8}, [3], None, MPI.COMM_SELF]


@pytest.mark.parametrize("wrong", WRONG_OVERRIDES, ids=["text", "dict", "number", "none", "comm"])
def test_overrides_are_a_list(wrong: Any) -> None:
    with pytest.raises(ConfigurationError, match="overrides must be a list"):
        contact_app.solve(CUBE, wrong)


@pytest.mark.parametrize("wrong", [3, None, "world", MPI.COMM_NULL, MPI.Comm])
def test_a_communicator_is_one_of_mpi4py(wrong: Any) -> None:
    with pytest.raises(ConfigurationError, match="comm must be a communicator of mpi4py"):
        contact_app.solve(CUBE, comm=wrong)


@pytest.mark.parametrize("symmetry", ["allow", "none"])
def test_cells_are_rows_of_points(symmetry: str) -> None:
    """A plane strain block between walls, whose halves are images of each other where allowed."""
    made = scenes.wall("quadrilateral", 4)
    left = {"on": "block.x-", "obstacle": {"plane": {"point": [0, 0], "normal": [1, 0]}}}
    contacts = [*made["contacts"], left]
    answer = contact_app.solve(made | {"symmetry": symmetry, "contacts": contacts})
    assert len(answer.cells) == (2 if symmetry == "allow" else 1)
    cells = np.concatenate(answer.cells)
    assert len(cells) == len(answer.stress)
    x, y, _ = np.moveaxis(answer.points[cells], -1, 0)
    area = 0.5 * (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)
    assert np.abs(area) == pytest.approx(1.0 / 16.0)


def test_a_mapping_has_the_answer_of_a_run(tmp_path: Path) -> None:
    made = scenes.wall("quadrilateral", 6)
    answer = contact_app.solve(made)
    assert made == scenes.wall("quadrilateral", 6)  # left as it was
    assert run(scenes.build(made), tmp_path) == 0
    known = json.loads((tmp_path / "summary.json").read_text())
    assert answer.summary["solution"]["energy"] == pytest.approx(known["solution"]["energy"])


def test_tuples_arrays_and_paths_are_taken_as_lists_numbers_and_texts(tmp_path: Path) -> None:
    made = scenes.wall("quadrilateral", np.int64(4))
    box = made["bodies"][0]["mesh"]["box"]
    box["lower"], box["upper"], box["cells"] = (0.0, 0.0), np.ones(2), np.array([4, 4])
    made["bodies"][0]["material"]["young"] = np.float64(1000.0)
    assert contact_app.solve(made).converged
    with pytest.raises(ConfigurationError, match="no-part.msh"):
        contact_app.solve(
            made | {"bodies": [made["bodies"][0] | {"mesh": {"file": tmp_path / "no-part.msh"}}]}
        )


def test_a_target_is_refined_to() -> None:
    made = scenes.wall("quadrilateral", 4) | {"accuracy": 0.3}
    del made["solver"]
    summary = contact_app.solve(made).summary
    assert summary["accuracy"]["met"]
    assert len(summary["levels"]) >= 1


def test_a_symmetric_scene_has_the_arrays_of_the_whole() -> None:
    made = scenes.wall("quadrilateral", 4)
    made["contacts"] = []
    whole = contact_app.solve(made)
    half = contact_app.solve(made | {"symmetry": "allow"})
    assert "symmetry" in half.summary
    assert half.points.shape == whole.points.shape
    order = [np.lexsort(np.round(a.points, 9).T) for a in (whole, half)]
    np.testing.assert_allclose(half.displacement[order[1]], whole.displacement[order[0]], atol=1e-9)
    assert half.von_mises.sum() == pytest.approx(whole.von_mises.sum(), rel=1e-9)


def test_wrong_use_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="bodies"):
        contact_app.solve({"dimension": 3})
    with pytest.raises(ConfigurationError, match="did you mean"):
        contact_app.solve(scenes.wall("quadrilateral", 4) | {"contact": []})
    free = scenes.wall("quadrilateral", 4)
    del free["conditions"][0]
    free["contacts"] = []
    with pytest.raises(NoEquilibriumError):
        contact_app.solve(free)
    with pytest.raises(AttributeError, match="has no attribute"):
        contact_app.nothing  # noqa: B018


def test_the_example_of_the_guide_is_right() -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)], capture_output=True, text=True, check=True, cwd=ROOT,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1",
             "HOME": os.environ.get("HOME", "/tmp")},
    )  # fmt: skip
    certified, force, pressure, radius = done.stdout.splitlines()
    assert certified == "certified: True"
    assert force == "force on a quarter: 0.250000 (0.25)"
    for line, theory, off in ((pressure, 5.266, 0.1), (radius, 0.3011, 0.05)):
        assert float(line.split()[2]) == pytest.approx(theory, rel=off)
    assert len(EXAMPLE.read_text(encoding="utf-8").splitlines()) <= 45


@pytest.mark.parametrize("wrong", [5, ["configs/cube.yaml"], None])
def test_a_scene_is_a_path_or_a_mapping(wrong: object) -> None:
    with pytest.raises(ConfigurationError, match="a scene is the path of a YAML file or a mapping"):
        contact_app.solve(wrong)  # type: ignore[arg-type]
