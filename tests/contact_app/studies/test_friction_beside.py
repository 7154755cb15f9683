"""Friction beside other programs: what they are given, and what they say where they are there."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.calculix_deck import PENALTY, STICK, Deck
from contact_app.studies.friction_beside import APPLICATION, CALCULIX, GETFEM, Judge, missing, run
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


def test_the_deck_has_a_penalty_and_a_stick_slope() -> None:
    unit = 1000.0 / 0.25
    lines = list(Deck(plain("block", 4, 1)).lines())
    assert f"{PENALTY * unit:.6e}" in lines
    assert f"*FRICTION\n0.3, {STICK * unit:.6e}" in lines


@pytest.mark.slow
@pytest.mark.parametrize("program", [CALCULIX, GETFEM])
@pytest.mark.parametrize(("name", "level"), [("roller", 2.0), ("block", 4)])
def test_other_programs_find_the_same(
    program: str, name: str, level: float, tmp_path: Path
) -> None:
    """On the same coarse mesh: displacements to two percent, forces to five."""
    if missing(program):
        pytest.skip(missing(program))
    application, _ = run(APPLICATION, name, (level, 1), tmp_path / "application")
    other, _ = run(program, name, (level, 1), tmp_path / "other")
    errors = Judge(name, application).errors(other)
    assert errors["displacement"] < 0.02, errors
    assert errors["along"] < 0.05, errors
    assert np.isfinite(other.force).all()
