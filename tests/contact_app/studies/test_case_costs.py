"""Cost of ten load cases compared with one."""

import pytest

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from contact_app.studies.case_costs import SCENES, with_cases


@pytest.mark.parametrize("name", list(SCENES))
def test_scenes_have_ten_different_cases(name: str) -> None:
    scene = build_scene(from_mapping(with_cases(SCENES[name], range(10))))
    assert len({case.factors for case in scene.cases}) == 10
