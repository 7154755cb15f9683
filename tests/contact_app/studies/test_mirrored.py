"""What symmetry saves, as the study tells it."""

from __future__ import annotations

import pytest

from contact_app.studies.mirrored import saving
from tests import scenes
from tests.contact_app.model.test_symmetry import pressed


def test_what_it_saves() -> None:
    """The table of docs/guide/scenes.md: both solves of a scene, none of one that mirrors not."""
    found = saving(scenes.build(pressed("hexahedron", 2)))
    assert found is not None
    assert found.planes == "x = 0.5, y = 0.5"
    assert found.unknowns == (81, 36)
    assert found.energies[1] == pytest.approx(found.energies[0], rel=1e-9)
    assert saving(scenes.build(scenes.tilted_plane("hexahedron", 2))) is None
