"""The same answer and the same counts on 1, 2 and 3 ranks, and output written once."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests import scenes
from tests.scenes_on_ranks import run_scene, summary_of

pytestmark = pytest.mark.mpi


def displacement(directory: Path) -> dict[tuple[float, ...], np.ndarray]:
    """Displacement at each point of solution.h5, whatever the order of the nodes."""
    import meshio

    with meshio.xdmf.TimeSeriesReader(directory / "solution.xdmf") as reader:
        points, _ = reader.read_points_cells()
        _, fields, _ = reader.read_data(0)
    u = fields["displacement"]
    return {tuple(np.round(p, 9) + 0.0): row for p, row in zip(points, u, strict=True)}


CASES = {
    "wall, regular split": ("wall", "hexahedron", [2, 2, 2]),
    "floating, graph partition": ("floating_in_corner", "tetrahedron", 5),
    "two bodies, plane": ("two_bodies", "triangle", [2, 2]),
    "no contacts": ("no_contacts", "quadrilateral", [3, 1]),
}


@pytest.mark.parametrize("case", CASES)
def test_same_answer_and_counts(case: str, tmp_path: Path) -> None:
    name, cell, subdomains = CASES[case]
    made = scenes.ALL[name](cell, 4)
    made["decomposition"] = {"subdomains": subdomains}
    if name == "wall":
        cut = {"in": "block", "plane": {"point": [0.0, 0.0, 0.4], "normal": [0.0, 0.1, 1.0]}}
        made["output"] = {"probes": {"off": [0.9, 0.2, 0.7]}, "sections": {"cut": cut}}
    one, *others = [summary_of(made, tmp_path, ranks) for ranks in (1, 2, 3)]
    assert one["environment"]["ranks"] == 1
    u = displacement(tmp_path / "out1")
    largest = one["solution"]["max_displacement"]
    for ranks, other in zip((2, 3), others, strict=True):
        assert other["environment"]["ranks"] == ranks
        assert other["mesh"] == one["mesh"]
        decomposition = {k: v for k, v in one["decomposition"].items() if "class" not in k}
        assert {k: other["decomposition"][k] for k in decomposition} == decomposition
        for key, value in one["solver"].items():
            if key != "reason":  # sums over ranks round otherwise, and a step may fall either way
                assert other["solver"][key] == pytest.approx(value, abs=2), key
        for key, value in one["solution"].items():
            assert other["solution"][key] == pytest.approx(value, rel=1e-9, abs=1e-9), key
        for record, value in zip(other["reactions"], one["reactions"], strict=True):
            np.testing.assert_allclose(record["force"], value["force"], rtol=1e-6, atol=1e-5)
        for key in ("probes", "sections") if name == "wall" else ():
            for record, value in zip(other[key].values(), one[key].values(), strict=True):
                for number, known in zip(record.values(), value.values(), strict=True):
                    np.testing.assert_allclose(number, known, rtol=1e-6, atol=1e-6)
        v = displacement(tmp_path / f"out{ranks}")
        assert u.keys() == v.keys()
        for point, value in u.items():
            np.testing.assert_allclose(v[point], value, rtol=0, atol=1e-9 * largest)


def test_output_is_written_once(tmp_path: Path) -> None:
    made = scenes.wall("quadrilateral", 4)
    made["decomposition"] = {"subdomains": [2, 2]}
    summary_of(made, tmp_path, 1)
    summary_of(made, tmp_path, 3)
    ours, theirs = ([p.name for p in sorted((tmp_path / f"out{n}").iterdir())] for n in (1, 3))
    assert ours == theirs
    rows = []
    for ranks in (1, 3):
        with (tmp_path / f"out{ranks}" / "history.csv").open(newline="") as file:
            rows.append([(row["outer"], row["step"]) for row in csv.DictReader(file)])
    assert rows[0] == rows[1]
    assert len(rows[0]) > 3


def test_more_ranks_than_subdomains(tmp_path: Path) -> None:
    """It works, or it is refused with a message that names both numbers."""
    made = scenes.wall("quadrilateral", 4)
    made["decomposition"] = {"subdomains": [2, 1]}
    path = scenes.write(made, tmp_path / "scene.yaml")
    done = run_scene(path, tmp_path / "out", 3)
    said = done.stdout + done.stderr
    assert "Traceback" not in said, said
    if done.returncode == 0:
        known = summary_of(made, tmp_path, 1)
        found = json.loads((tmp_path / "out" / "summary.json").read_text())
        assert found["solution"]["energy"] == pytest.approx(known["solution"]["energy"], rel=1e-9)
    else:
        assert done.returncode == 2, said
        assert "3" in said
        assert "2" in said


def test_no_equilibrium_ends_all_ranks(tmp_path: Path) -> None:
    """One clear message and exit code 3; no rank waits for another."""
    made = scenes.sliding("quadrilateral", 4)
    made["conditions"][0]["traction"] = [5, -50]
    made["decomposition"] = {"subdomains": [2, 2]}
    path = scenes.write(made, tmp_path / "scene.yaml")
    done = run_scene(path, tmp_path / "out", 2)
    said = done.stdout + done.stderr
    assert done.returncode == 3, said
    assert "Traceback" not in said
    assert said.count("no equilibrium") <= 1, "said once, not once a rank"
