"""Cost of ten load cases compared with one."""

from pathlib import Path

import pytest

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from contact_app.studies.case_costs import SCENES, table, with_cases


@pytest.mark.parametrize("name", list(SCENES))
def test_scenes_have_ten_different_cases(name: str) -> None:
    scene = build_scene(from_mapping(with_cases(SCENES[name], range(10))))
    assert len({case.factors for case in scene.cases}) == 10


@pytest.mark.slow
def test_ten_cases_of_a_post_cost_less_than_ten_runs(tmp_path: Path) -> None:
    rows = list(table(["remote_load"], tmp_path))
    assert len(rows) == 3
    cells = [cell.strip() for cell in rows[2].split("|")[1:-1]]
    assert cells[0] == "remote_load"
    one, ten = float(cells[6]), float(cells[7])
    assert one < ten < 8 * one
