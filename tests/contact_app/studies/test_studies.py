"""The studies' commands, on a small cube and without the data sets."""

import csv
import json

import pytest
import typer
from typer.testing import CliRunner

from contact_app.studies.commands import register
from contact_app.studies.paper import COLUMNS, paper_rows

application = typer.Typer()
register(application)


@pytest.mark.ratchet
def test_cube_rows_leave_counts_figure_and_summaries(tmp_path):
    cube = pytest.importorskip("contact_app.studies.cube", exc_type=ImportError)
    rows = [r for r in paper_rows("contact") if r.expansion in ("projcg", "gfgf-opt")][-4:]
    said = list(cube.run_rows(tmp_path, cube.cube_scene(6, 2), rows))
    assert len(said) == len(rows) + 3
    with (tmp_path / "cube_counts.csv").open() as file:
        found = list(csv.DictReader(file))
    assert list(found[0])[: len(COLUMNS)] == list(COLUMNS)
    for row, paper in zip(found, rows, strict=True):
        each = 3 if row["expansion"].endswith("-opt") else 2
        outer, hessian, cg, expansion, proportioning = (int(row[name]) for name in COLUMNS[3:])
        assert hessian == outer + cg + each * expansion + proportioning
        assert int(row["paper_hessian"]) == paper.hessian
    summaries = sorted(tmp_path.glob("*/summary.json"))
    assert len(summaries) == len(rows) + 1
    for path in summaries:
        summary = json.loads(path.read_text())
        assert summary["certificate"]["max_penetration"] < 1e-4
        assert summary["decomposition"]["subdomains"] == 8
    default = json.loads((tmp_path / "default" / "summary.json").read_text())["solver"]
    assert default["hessian_multiplications"] < min(int(row["hessian"]) for row in found)
    assert (tmp_path / "figure3_cube.png").stat().st_size > 10_000


def test_unknown_expansion_lists_the_papers(tmp_path):
    cube = pytest.importorskip("contact_app.studies.cube", exc_type=ImportError)
    with pytest.raises(ValueError, match="projcg"):
        list(cube.reproduce_cube(tmp_path, expansion="nothing"))


def test_svm_command_prints_json(tmp_path):
    data = tmp_path / "data.libsvm"
    data.write_text("1 1:1 2:0.5\n-1 1:-1\n1 1:0.7 2:-0.1\n-1 1:-0.2 2:0.3\n", encoding="utf-8")
    done = CliRunner().invoke(application, ["svm", str(data), "--C", "2", "--rtol", "1e-6"])
    assert done.exit_code == 0
    report = json.loads(done.stdout)
    assert report["training_accuracy"] == 1.0
    assert report["relative_duality_gap"] < 1e-5
    assert {"hessian", "cg", "expansion", "proportioning"}.issubset(report["counts"])


@pytest.mark.parametrize(
    "arguments", [["svm", "no-such-file"], ["reproduce", "svm", "--data", "no-such-directory"]]
)
def test_bad_input_is_exit_code_2_with_a_message(tmp_path, arguments, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(application, arguments)
    assert done.exit_code == 2
    assert "error: no-such" in done.output
