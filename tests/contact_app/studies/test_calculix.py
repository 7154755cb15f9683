"""This application beside CalculiX."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.calculix import COMMAND, PARTS, Mesh, compared, deck, scene_of, turns


@pytest.mark.parametrize("name", list(PARTS))
def test_the_deck_has_the_loads_and_the_surfaces_of_the_scene(name: str) -> None:
    made = scene_of(PARTS[name])
    mesh = Mesh(Path(made["bodies"][0]["mesh"]["file"]))
    lines = "\n".join(deck(made, mesh, PARTS[name].push)).split("\n")
    assert lines.count("*END STEP") == 1 + (PARTS[name].push is not None)
    for contact in made["contacts"]:
        for side in ("on", "against"):
            faces = list(mesh.faces(contact[side]))
            assert len(faces) == len(mesh.facets[contact[side].split(".")[1]])
    for condition in made["conditions"]:
        if "total_force" in condition:
            rows = list(mesh.forces(condition["on"], condition["total_force"]))
            parts = np.array([row.split(",") for row in rows], float)
            total = [parts[parts[:, 1] == axis, 2].sum() for axis in (1, 2, 3)]
            np.testing.assert_allclose(total, condition["total_force"], rtol=1e-9, atol=1e-6)


@pytest.mark.skipif(shutil.which(COMMAND) is None, reason="CalculiX is not installed")
def test_both_agree_on_a_flange(tmp_path: Path) -> None:
    found = compared("bolted_flange", tmp_path)
    assert found["force"] == pytest.approx(36000.0, rel=1e-5)
    assert found["force ccx"] == pytest.approx(found["force"], rel=0.01)
    assert found["largest"] < 0.01
    assert found["strained"] <= found["every"] < 0.01


def test_turns_are_those_of_the_first_body() -> None:
    made = scene_of(PARTS["bolted_flange"])
    mesh = Mesh(Path(made["bodies"][0]["mesh"]["file"]))
    about = np.array([1e-5, 0.0, -3e-5])
    first = np.unique(mesh.cells[made["bodies"][0]["name"]])
    still, turned = np.zeros((2, *mesh.points.shape))
    turned[first] = np.cross(about, mesh.points[first]) + 0.1
    np.testing.assert_allclose(turns(made, mesh, turned, still), (-3e-5, 0.0), atol=1e-12)
