"""Hertz's contact on the meshes shipped, and on finer ones where Gmsh is at hand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.hertz import hertz_quantities

ROOT = Path(__file__).parents[3]


def errors(scene: str, mesh: Path | None = None) -> dict[str, float]:
    changes = [f"bodies.0.mesh.file={mesh}"] if mesh else []
    solved = solve_scene(build_scene(load(ROOT / "configs" / scene, changes)), MPI.COMM_SELF)
    return {quantity.name: abs(quantity.error) for quantity in hertz_quantities(solved)}


def test_the_disc() -> None:
    """verification.md, rigid plane: a = 3.107, p0 = 7171; by 775 nodes."""
    found = errors("hertz_disc.yaml")
    assert max(found.values()) < 0.005, found


def test_the_ball() -> None:
    """verification.md: a = 0.3011, p0 = 5.266, δ = 0.01133; by 1300 nodes."""
    found = errors("hertz_sphere.yaml")
    assert found["half-width a"] < 0.005
    assert found["peak pressure p0"] < 0.02
    assert found["approach"] < 0.04


@pytest.mark.slow
def test_a_finer_ball(tmp_path: Path) -> None:
    """All within 2 % by 21,000 nodes."""
    pytest.importorskip("gmsh", reason="makes the mesh")
    script = ROOT / "meshes" / "samples" / "make.py"
    subprocess.run(
        [sys.executable, script, "sphere_eighth", "--size", "0.7", "--to", tmp_path], check=True
    )
    found = errors("hertz_sphere.yaml", tmp_path / "sphere_eighth.msh")
    assert max(found.values()) < 0.02, found
