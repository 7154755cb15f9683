"""A shrink fit of polygons with `round: true`, refined: Lamé's pressure on every mesh."""

from pathlib import Path

import pytest

import contact_app
from tests import rings, scenes

OVERLAP = 0.03


def fit(directory: Path) -> scenes.Config:
    """Two rings of straight edges, up to 0.048 beside the circle."""
    radius = rings.MIDDLE + OVERLAP
    made = rings.fit(directory, "plane_stress", radius, (8, 12), straight=True)
    made["contacts"][0]["round"] = True
    return made


@pytest.mark.parametrize("times", [0, 1, 2])
def test_refined_files_have_lames_pressure(times: int, tmp_path: Path) -> None:
    made = fit(tmp_path)
    for body in made["bodies"]:
        body["mesh"]["refine"] = times
    (contact,) = contact_app.solve(made).summary["contacts"]
    exact = rings.fit_pressure("plane_stress", OVERLAP)
    assert contact["max_smoothed_pressure"] == pytest.approx(exact, rel=0.06)
    assert contact["max_pressure"] == pytest.approx(exact, rel=0.08)


def test_a_run_to_an_accuracy_reaches_it(tmp_path: Path) -> None:
    """It begins at 14 %; on polygons the pressure doubles with each level."""
    answer = contact_app.solve({**fit(tmp_path), "accuracy": 0.06})
    assert answer.summary["accuracy"]["total"] < 0.06
    assert not any("flat facets" in w for w in answer.certificate.warnings)
    exact = rings.fit_pressure("plane_stress", OVERLAP)
    (contact,) = answer.summary["contacts"]
    assert contact["max_smoothed_pressure"] == pytest.approx(exact, rel=0.06)
