"""Bodies whose mesh comes from a file: patch tests, materials by group, any decomposition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.run import solve_scene
from tests import meshfiles, reference, scenes
from tests.comparison import in_order_of

CELLS = tuple(meshfiles.MESHIO)


def patch(cell: str, file: Path, young: float = 900.0, poisson: float = 0.25) -> scenes.Config:
    """The block of the verification's contact patch test, pressed on a plane."""
    d = meshfiles.dimension(cell)
    top, bottom = scenes.up(cell), scenes.down(cell)
    rollers = [
        {"on": f"block.{'xyz'[axis]}-",
         "displacement": [0 if a == axis else None for a in range(d)]}
        for axis in range(d - 1)
    ]  # fmt: skip
    made = scenes.config(
        cell,
        [{"name": "block", "mesh": {"file": str(file)},
          "material": {"young": young, "poisson": poisson}}],
        [*rollers, {"on": f"block.{top}", "pressure": 100}],
        [{"on": f"block.{bottom}", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1))}],
    )  # fmt: skip
    made["solver"]["tolerance"] = 1e-11
    return made


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("subdomains", [1, 5])
def test_contact_patch_on_distorted_cells(cell: str, subdomains: int, tmp_path: Path) -> None:
    """verification.md: E = 900, ν = 0.25, q = 100: u = (1/36, 1/36, -1/9) at the free corner."""
    file = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    solved = solve_scene(scenes.build(patch(cell, file), subdomains))
    points, u = solved.displacement_at_nodes()
    d = meshfiles.dimension(cell)
    if d == 3:
        slope = np.array([1 / 36, 1 / 36, -1 / 9])
    else:  # plane strain: u_y = -q (1 - ν²)/E, u_x = ν (1 + ν) q/E
        slope = np.array([0.25 * 1.25, -(1 - 0.25**2)]) * 100 / 900
    np.testing.assert_allclose(u, points[:, :d] * slope, rtol=0, atol=1e-9 * np.abs(slope).max())
    assert solved.summary["certificate"]["passed"]
    assert solved.summary["solution"]["max_contact_pressure"] == pytest.approx(100.0, rel=1e-8)
    stress = solved.cells.stress
    np.testing.assert_allclose(stress[:, d - 1], -100.0, rtol=1e-8)
    assert np.abs(stress[:, 3:]).max() < 1e-6


def two_materials(cell: str, file: Path) -> dict[str, Any]:
    """Two materials, a bending load, a sphere below: nothing cancels."""
    made = patch(cell, file)
    made["bodies"][0]["material"] = {
        "soft": {"young": 500.0, "poisson": 0.2},
        "hard": {"young": 4000.0, "poisson": 0.35},
    }
    made["conditions"] = [
        scenes.clamp(cell, "block.x-"),
        {"on": f"block.{scenes.up(cell)}", "traction": scenes.vector(cell, 3, 1, -60)},
    ]
    centre = scenes.vector(cell, 0.7, 0.4, -2.01)
    made["contacts"] = [
        {"on": f"block.{scenes.down(cell)}",
         "obstacle": {"sphere": {"center": centre, "radius": 2.0}}}
    ]  # fmt: skip
    made["solver"]["tolerance"] = 1e-10
    return made


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("subdomains", [None, 6])
def test_two_materials_against_the_reference(
    cell: str, subdomains: int | None, tmp_path: Path
) -> None:
    file = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    scene = scenes.build(two_materials(cell, file), subdomains)
    known = reference.solve(scene)
    assert known.active > 0
    solved = solve_scene(scene)
    u = in_order_of(known, solved)
    np.testing.assert_allclose(u, known.u, rtol=0, atol=1e-7 * np.abs(known.u).max())
    assert solved.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-9)
