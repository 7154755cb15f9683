"""A checkout compared with itself, and with a copy that solves another scene."""

import shutil
from pathlib import Path

from contact_app.studies.two_commits import CUBES, grouped, paper_rows, row, scenes_of

ROOT = Path(__file__).parents[3]


def test_both_checkouts_are_run(tmp_path: Path) -> None:
    for name in ("contact_app", "solver", "meshes"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "configs").mkdir()
    shutil.copy(ROOT / "configs/rough_rod.yaml", tmp_path / "configs/block_2d.yaml")
    same, other = (
        row("configs/block_2d.yaml", (ROOT, checkout), 1).strip("| ").split(" | ")
        for checkout in (ROOT, tmp_path)
    )
    assert same[2] == "0e+00"
    assert same[3] == same[4]
    assert float(other[2]) > 1e-3
    assert other[3] != other[4]


def test_a_run_that_fails_is_reported() -> None:
    assert "no_such_key" in row("configs/block_2d.yaml;no_such_key=1", (ROOT, ROOT), 1)


def test_load_cases_and_histories_are_compared_by_their_last_energy_and_all_applications() -> None:
    line = row("configs/load_cases.yaml", (ROOT, ROOT), 1).strip("| ").split(" | ")
    assert float(line[1]) < 0.0
    assert int(line[4]) > 30  # three cases, the first of them 9


def test_its_scenes_are_those_of_both_checkouts(tmp_path: Path) -> None:
    (tmp_path / "configs").mkdir()
    shutil.copy(ROOT / "configs/rod_cycle.yaml", tmp_path / "configs")
    assert scenes_of((ROOT, tmp_path)) == ["configs/rod_cycle.yaml", *CUBES]


def test_rows_of_the_paper_are_compared_by_expansion(tmp_path: Path) -> None:
    counts = [("fixed", 10), ("fixed", 12), ("fixed", 30), ("opt", 50)]
    lines = [f"cube,{expansion},{count}" for expansion, count in counts]
    (tmp_path / "counts.csv").write_text("\n".join(["benchmark,expansion,hessian", *lines]))
    old = grouped(tmp_path / "counts.csv")
    assert old == {"cube fixed": [10, 12, 30], "cube opt": [50]}
    assert list(paper_rows(old, {"cube fixed": [10, 15, 31], "cube opt": [50]})) == [
        "| cube fixed | 1 of 3 | 12 | 15 | +25.0 % |",
        "| cube opt | 1 of 1 | 50 | 50 | +0.0 % |",
    ]
