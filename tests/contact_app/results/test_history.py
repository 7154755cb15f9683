"""history.csv has a row for each inner iteration, and keeps them when a run breaks off."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from contact_app.results.history import COLUMNS, History
from contact_app.run.run import run
from solver import MPRGP, SMALBE, BoxQP
from solver.qp.result import Step
from tests import scenes


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_one_row_for_each_inner_iteration_of_a_solve(tmp_path: Path) -> None:
    n = 20
    matrix = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    qp = BoxQP(matrix, -np.ones(n), lower=np.full(n, -3.0))
    path = tmp_path / "deep" / "history.csv"
    with History(path) as monitor:
        result = SMALBE(MPRGP(rtol=1e-8)).solve(qp, np.ones((1, n)), monitor=monitor)
    assert result.converged
    found = rows(path)
    assert tuple(found[0]) == COLUMNS
    assert len(found) == result.counts.inner > 0
    for kind in ("cg", "expansion", "proportioning"):
        assert sum(row["step"] == kind for row in found) == getattr(result.counts, kind)
    iterations = [int(row["iteration"]) for row in found]
    assert iterations == sorted(iterations)
    assert int(found[-1]["outer"]) <= result.counts.outer


def test_numbers_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "history.csv"
    with History(path) as monitor:
        monitor(Step(0, 0, "start", 1.0, 0.0, 0, 0.0))
        monitor(Step(2, 17, "expansion", 1.25e-7, 3.5e-11, 42, 0.125))
    (row,) = rows(path)
    assert list(row.values())[:3] == ["2", "17", "expansion"]
    assert float(row["projected_gradient"]) == 1.25e-7
    assert float(row["equality_residual"]) == 3.5e-11
    assert int(row["active"]) == 42
    assert float(row["seconds"]) == 0.125


def test_rows_are_on_disk_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "history.csv"
    with History(path, flush_seconds=0.0) as monitor:
        for i in range(3):
            monitor(Step(1, i, "cg", 1.0, 0.0, 0, 0.0))
            assert len(rows(path)) == i + 1


def test_other_ranks_write_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with History(None) as monitor:
        monitor(Step(1, 1, "cg", 1.0, 0.0, 0, 0.0))
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_goes_on_keeps_the_rows_before_it(tmp_path: Path) -> None:
    path = tmp_path / "history.csv"
    kept = []
    for go_on, iteration in ((True, 1), (True, 2), (False, 3)):
        with History(path, go_on) as written:
            written(Step(1, iteration, "cg", 1.0, 0.0, 0, 0.0))
        kept.append([int(row["iteration"]) for row in rows(path)])
    assert kept == [[1], [1, 2], [3]]


@pytest.mark.parametrize("method", ["active-set", "smalbe"])
def test_the_active_set_and_its_rows_are_reported(method: str, tmp_path: Path) -> None:
    """The last row has the rows that the answer closes; sets and time go up."""
    made = scenes.wall("quadrilateral", 8)
    made["solver"] = {"method": method}
    made["decomposition"] = {"subdomains": 4}
    assert run(scenes.read(scenes.write(made, tmp_path / "s.yaml")), tmp_path / "out") == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = rows(tmp_path / "out" / "history.csv")
    closed = summary["solution"]["active_contacts"]
    assert closed > 0
    assert int(found[-1]["active_rows"]) == closed
    sets = [int(row["active_set"]) for row in found]
    iterations = [int(row["iteration"]) for row in found]
    times = [float(row["total_seconds"]) for row in found]
    assert sets == sorted(sets)
    assert times == sorted(times)
    assert times[-1] >= float(found[-1]["seconds"])
    assert all(int(row["active_rows"]) <= summary["decomposition"]["contact"] for row in found)
    if method == "active-set":
        assert sets[0] == 1
        assert sets[-1] > 1
        assert iterations == list(range(1, len(found) + 1))
    else:
        assert set(sets) == {0}
