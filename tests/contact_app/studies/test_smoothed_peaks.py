"""The study of smoothed peaks: facets across the contact, and how far the peak is off."""

from __future__ import annotations

from pathlib import Path

import pytest

from contact_app.studies.smoothed_peaks import SCENES, peaks

CONFIGS = Path(__file__).parents[3] / "configs"


def test_hertz_with_more_than_six_facets_across_is_within_5_percent() -> None:
    (found,) = peaks(SCENES[0], 0.0, CONFIGS)
    assert found.across > 6.0
    assert abs(found.off) < 0.05
    assert found.off == pytest.approx(found.smoothed / SCENES[0].right - 1.0)
    assert found.largest > found.smoothed


@pytest.mark.slow
def test_a_shrink_fit_hardly_depends_on_how_facets_meet() -> None:
    hub = SCENES[1]
    found = [p.smoothed for angle in (0.0, 40.0, 73.0) for p in peaks(hub, angle, CONFIGS)]
    assert max(found) < 1.05 * min(found)
    assert min(found) > 0.9 * hub.right
