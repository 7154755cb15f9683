"""Hertz's contact on the shipped meshes."""

from pathlib import Path

from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.hertz import hertz_quantities

ROOT = Path(__file__).parents[3]


def errors(scene: str) -> dict[str, float]:
    solved = solve_scene(build_scene(load(ROOT / "configs" / scene)), MPI.COMM_SELF)
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
