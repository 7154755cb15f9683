"""This application beside CalculiX."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.calculix import PARTS, compared, differences, plain, scene_of
from contact_app.studies.calculix_deck import COMMAND, Deck


@pytest.mark.parametrize("name", list(PARTS))
def test_the_deck_has_the_loads_and_the_surfaces_of_the_scene(name: str) -> None:
    made = scene_of(PARTS[name])
    scene = plain(PARTS[name], made)
    deck = Deck(scene)
    ends = [line for line in deck.lines() if line.endswith("*END STEP")]
    assert len(ends) == 1 + (PARTS[name].push is not None)
    assert scene.against is not None
    for body, side in (scene.on, scene.against):
        assert len(deck.solids[body].faces(side)) == len(scene.bodies[body].sides[side])
    assert len(scene.forces) == sum("total_force" in c for c in made["conditions"])
    for body, side, wanted in scene.forces:
        rows = [row.split(",") for row in deck.solids[body].forces(side, wanted)]
        parts = np.array(rows, float)
        total = [parts[parts[:, 1] == axis, 2].sum() for axis in (1, 2, 3)]
        np.testing.assert_allclose(total, wanted, rtol=1e-9, atol=1e-6)


@pytest.mark.skipif(shutil.which(COMMAND) is None, reason="CalculiX is not installed")
def test_both_agree_on_a_flange(tmp_path: Path) -> None:
    found = compared("bolted_flange", tmp_path)
    assert found["force"] == pytest.approx(36000.0, rel=1e-5)
    assert found["force ccx"] == pytest.approx(found["force"], rel=0.01)
    assert found["largest"] < 0.01
    assert found["strained"] <= found["every"] < 0.01


def test_differences_leave_out_the_rigid_motions_of_loose_bodies() -> None:
    points = np.random.default_rng(0).standard_normal((2, 20, 3))
    u = [1e-2 * x[:, [1, 0, 2]] for x in points]
    moved = [u[0] + np.cross([0.0, 0.0, 1e-2], points[0]), u[1]]
    assert differences(points, u, moved, [0]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    _, every, strained = differences(points, u, moved)
    assert every > 0.1
    assert strained < 1e-12
