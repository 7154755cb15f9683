"""Results of two versions side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from contact_app.studies.two_versions import compare


def test_rows_of_the_paper_are_compared_by_expansion(tmp_path: Path) -> None:
    for name, counts in {"before": (100, 40), "after": (100, 50)}.items():
        (tmp_path / name).mkdir()
        rows = [f"svm,fixed,{count}" for count in counts]
        (tmp_path / name / "svm_counts.csv").write_text(
            "\n".join(["benchmark,expansion,hessian", *rows])
        )
    last = list(compare(tmp_path / "before", tmp_path / "after"))[-1]
    assert last == "| svm | `fixed` | 2 | 1 | 70 | 75 | 25 % |"


def test_runs_are_compared_by_name(tmp_path: Path) -> None:
    for name, energy in {"before": -2.0, "after": -2.2}.items():
        (tmp_path / name / "cube").mkdir(parents=True)
        summary = {"solver": {"hessian_multiplications": 16}, "solution": {"energy": energy}}
        (tmp_path / name / "cube" / "summary.json").write_text(json.dumps(summary))
    last = list(compare(tmp_path / "before", tmp_path / "after"))[-1]
    assert last == "| cube | 16 | 16 | -2 | 1.0e-01 |"


def test_load_cases_are_compared_one_by_one(tmp_path: Path) -> None:
    """The summary above those of the cases has no counts of its own."""
    one = {"solver": {"hessian_multiplications": 9}, "solution": {"energy": -1.0}}
    for name in ("before", "after"):
        (tmp_path / name / "parts" / "east").mkdir(parents=True)
        (tmp_path / name / "parts" / "summary.json").write_text(
            json.dumps({"cases": {"east": one}})
        )
        (tmp_path / name / "parts" / "east" / "summary.json").write_text(json.dumps(one))
    _, _, *rows = compare(tmp_path / "before", tmp_path / "after")
    assert rows == ["| parts/east | 9 | 9 | -1 | 0 |"]


def test_results_of_different_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no results of the same kind"):
        list(compare(tmp_path, tmp_path))
