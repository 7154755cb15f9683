"""A polygon in a round hole, of the verification study."""

from __future__ import annotations

import pytest

from contact_app.studies.verification import find, study


def test_a_polygon_in_a_round_hole_touches_with_its_corners() -> None:
    """Its pressure is 110.4 in the mean, not the three times as much of forces over shares."""
    (case,) = find(["thick_ring_straight"])
    (row,) = study(case, case.levels[:1])
    mean = next(q for q in row.quantities if q.name == "mean pressure")
    assert mean.ours == pytest.approx(110.41, rel=1e-3)
