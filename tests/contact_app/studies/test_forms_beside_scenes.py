"""The study of what forms cost beside scenes: all ways have one answer."""

from collections.abc import Callable
from functools import partial

import pytest

from contact_app.studies.forms_beside_scenes import FRICTION, measure, measure_bricks


@pytest.mark.parametrize("table", [measure, measure_bricks, partial(measure, friction=FRICTION)])
def test_all_ways_have_one_answer(table: Callable[..., dict[str, dict[str, float]]]) -> None:
    found = table(4, turns=1)
    assert set(found) == {"form", "form, solved again", "scene", "scene, multigrid"}
    energies = [row["energy"] for row in found.values()]
    assert energies == pytest.approx([energies[0]] * 4, rel=1e-6)
    assert all(row["dofs"] == 375 for row in found.values())
    assert all(row["seconds"] > 0.0 for row in found.values())
