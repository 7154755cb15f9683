"""A checkout compared with itself, and with a copy that solves another scene."""

from __future__ import annotations

import shutil
from pathlib import Path

from contact_app.studies.two_commits import CUBES, row, scenes_of

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


def test_its_scenes_have_no_steps() -> None:
    scenes = scenes_of(ROOT)
    assert "configs/cube.yaml" in scenes
    assert set(CUBES) < set(scenes)
    assert "configs/rod_cycle.yaml" not in scenes
