"""Newton's method, the fallback of Total FETI, on several ranks."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scenes_on_ranks import summary_of
from tests.stability.feature_scenes import feature_scene


def test_a_rigid_body_with_held_components_on_two_ranks(tmp_path: Path) -> None:
    """Its held components are on the interface, but no unknowns: PETSc refused their columns."""
    made, _ = feature_scene(61458)
    made["solver"]["method"] = "smalbe"
    one, two = (summary_of(made, tmp_path, ranks) for ranks in (1, 2))
    assert one["solver"]["method"] == two["solver"]["method"] == "newton"
    assert two["solution"]["energy"] == pytest.approx(one["solution"]["energy"], rel=1e-6)
