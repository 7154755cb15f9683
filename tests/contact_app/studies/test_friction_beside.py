"""Friction beside other programs: what they are given, and what they say where they are there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.calculix_deck import Deck
from contact_app.studies.friction_beside import CALCULIX, GETFEM, OURS, Judge, missing, run
from contact_app.studies.rough_increments import rows
from contact_app.studies.rough_scenes import plain


@pytest.mark.parametrize(("name", "level"), [("roller", 4.0), ("block", 4)])
@pytest.mark.parametrize("degree", [1, 2])
def test_solids_have_the_volume_and_the_sides_of_the_scene(
    name: str, level: float, degree: int
) -> None:
    scene = plain(name, level, degree)
    deck = Deck(scene)
    for solid, body in zip(deck.solids, scene.bodies, strict=True):
        assert solid.cells.shape[1] == {("wedge", 1): 6, ("wedge", 2): 15, ("hexahedron", 1): 8,
                                        ("hexahedron", 2): 20}[solid.kind, degree]  # fmt: skip
        for side, facets in body.sides.items():
            assert len(solid.faces(side)) == len(facets)
    steps = len(scene.factors) + (name == "roller")
    assert sum(line.endswith("*END STEP") for line in deck.lines()) == steps


def test_the_deck_has_the_chosen_penalty_and_stick_slope() -> None:
    scene = plain("block", 4, 1)
    unit = 1000.0 / 0.25
    numbers = [
        [line for line in Deck(scene, *tuning).lines() if line.startswith("*FRICTION")]
        + [line for line in Deck(scene, *tuning).lines() if line == f"{5.0 * unit:.6e}"]
        for tuning in ((5.0, 0.5), (50.0, 5.0))
    ]
    assert numbers[0] == [f"*FRICTION\n0.3, {0.5 * unit:.6e}", f"{5.0 * unit:.6e}"]
    assert numbers[1] == [f"*FRICTION\n0.3, {5.0 * unit:.6e}"]


@pytest.mark.slow
@pytest.mark.parametrize("program", [CALCULIX, GETFEM])
@pytest.mark.parametrize(("name", "level"), [("roller", 2.0), ("block", 4)])
def test_other_programs_find_the_same(
    program: str, name: str, level: float, tmp_path: Path
) -> None:
    """On the same coarse mesh: displacements to two percent, forces to five."""
    if missing(program):
        pytest.skip(missing(program))
    ours, _ = run(OURS, name, (level, 1), tmp_path / "ours")
    theirs, _ = run(program, name, (level, 1), tmp_path / "theirs")
    errors = Judge(name, ours).errors(theirs)
    assert errors["displacement"] < 0.02, errors
    assert errors["along"] < 0.05, errors
    assert np.isfinite(theirs.force).all()


def test_more_increments_come_closer_to_a_gradual_load() -> None:
    lines = list(rows(sizes=(4.0, 2.0), counts=(1, 2, 8)))
    assert lines[0].startswith("| increments |")
    numbers = [[word.strip() for word in line.strip("|").split("|")] for line in lines[2:]]
    assert [row[0] for row in numbers] == ["1", "2", "8"]
    one, two = (float(row[2].rstrip(" %")) for row in numbers[:2])
    assert one > two > 0.0
