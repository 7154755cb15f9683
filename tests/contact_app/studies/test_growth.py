"""The study of growth: runs of its own, summaries of others, the slope."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from contact_app.errors import ConfigurationError
from contact_app.studies import growth


def test_runs_and_summaries_share_a_table_and_a_figure(tmp_path: Path) -> None:
    first = list(growth.growth(tmp_path / "first", [3]))
    assert [row["dofs"] for row in first] == [192]
    summary = {
        "mesh": {"dofs": 81_812_703},
        "decomposition": {"subdomains": 1000},
        "solver": {"outer_iterations": 10, "hessian_multiplications": 292},
        "solution": {"energy": -0.51},
        "certificate": {"passed": True, "max_penetration": 1e-9},
        "timings": {"setup": 1.0, "assembly": 2.0, "factorization": 3.0, "solve": 4.0, "total": 99},
        "environment": {"ranks": 1, "peak_rss_gb": 12.5},
    }
    place = tmp_path / "paper" / "default"
    place.mkdir(parents=True)
    (place / "summary.json").write_text(json.dumps(summary))
    failed = {**summary, "certificate": {"passed": False, "max_penetration": 1.0}}
    (place.parent / "summary.json").write_text(json.dumps(failed))
    rows = list(growth.growth(tmp_path / "second", [4], [tmp_path / "paper"]))
    assert first[0]["energy"] > rows[0]["energy"] > -0.52
    assert [(row["dofs"], row["seconds"]) for row in rows[1:]] == [(81_812_703, 10.0)]
    with (tmp_path / "second" / "growth.csv").open() as file:
        written = list(csv.DictReader(file))
    assert [row["dofs"] for row in written] == ["375", "81812703"]
    assert (tmp_path / "second" / "growth.png").stat().st_size > 10_000


def test_what_is_no_summary_is_refused(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(ConfigurationError, match="no summary"):
        growth.read_summaries([tmp_path])
    with pytest.raises(ConfigurationError, match="no summary"):
        growth.read_summaries([tmp_path / "missing.json"])


def test_slope_of_a_power() -> None:
    assert growth.slope([10, 100, 1000], [3.0, 3 * 10**1.2, 3 * 10**2.4]) == pytest.approx(1.2)
