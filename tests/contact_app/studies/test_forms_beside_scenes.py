"""The study of what forms cost beside scenes: all ways have one answer."""

from __future__ import annotations

from functools import partial

import pytest

from contact_app.studies.forms_beside_scenes import FRICTION, measure, measure_bricks, measure_pair


@pytest.mark.parametrize(
    ("table", "dofs"),
    [
        (measure, 375),
        (measure_bricks, 375),
        (partial(measure, friction=FRICTION), 375),
        (measure_pair, 456),
    ],
)
def test_all_ways_have_one_answer(table: object, dofs: int) -> None:
    assert callable(table)
    found = table(4, turns=1)
    assert set(found) == {"form", "form, solved again", "scene", "scene, multigrid"}
    energies = [row["energy"] for row in found.values()]
    assert energies == pytest.approx([energies[0]] * 4, rel=1e-6)
    assert all(row["dofs"] == dofs for row in found.values())
    assert all(row["seconds"] > 0.0 for row in found.values())
