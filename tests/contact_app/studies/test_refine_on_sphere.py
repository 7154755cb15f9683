"""Refined meshes of round bodies: new nodes lie on the circle or ball."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.refine_on_sphere import refined_round
from meshes import MeshError
from meshes.quadratic import straight_middles
from meshes.repair import load_mesh
from meshes.unstructured import CellMesh

SAMPLES = Path(__file__).parents[3] / "meshes" / "samples"
CASES = {
    "coarse/disc_quarter.msh": (2, "rim", (0.0, 50.0), 50.0),
    "coarse/roller_on_block.msh": (2, "face", (0.0, 50.0), 50.0),
    "coarse/sphere_eighth.msh": (3, "sphere", (0.0, 0.0, 8.0), 8.0),
}


def sample(name: str) -> CellMesh:
    groups = ["roller"] if "roller" in name else []
    mesh = load_mesh(SAMPLES / name, CASES[name][0], groups=groups)
    assert mesh.middles is None
    return mesh


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("times", [0, 1, 2])
def test_corners_lie_on_the_circle_or_ball(name: str, times: int) -> None:
    dimension, side, centre, radius = CASES[name]
    mesh = sample(name)
    fine = refined_round(mesh, times, [side])
    assert fine.middles is None
    assert fine.total_cells == mesh.total_cells * 2 ** (dimension * times)
    on = np.unique(fine.topology.facets[fine.sides[side]])
    away = np.linalg.norm(fine.points[on] - centre, axis=1) - radius
    np.testing.assert_allclose(away, 0.0, atol=1e-9 * radius)
    # Plane sides stay plane, and nothing turns over.
    if dimension == 3:
        for axis, plane in enumerate(["x-", "y-"]):
            nodes = np.unique(fine.topology.facets[fine.sides[plane]])
            np.testing.assert_allclose(fine.points[nodes, axis], 0.0, atol=1e-12)
        corners = fine.points[fine.cells]
        assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0.0).all()


@pytest.mark.parametrize("name", CASES)
def test_round_edges_belong_to_the_side_alone(name: str) -> None:
    _, side, centre, radius = CASES[name]
    mesh = refined_round(sample(name), 1, [side], curved=True)
    assert mesh.middles is not None
    whole = mesh.shape(2)
    straight = straight_middles(mesh.points[mesh.cells], mesh.cell)
    moved = np.linalg.norm(mesh.middles - straight, axis=2)
    assert 0.0 < moved.max() < 0.1 * radius
    on = np.unique(whole.topology.facets[whole.sides[side]])
    away = np.linalg.norm(whole.points[on] - centre, axis=1) - radius
    np.testing.assert_allclose(away, 0.0, atol=1e-9 * radius)
    touching = np.isin(mesh.cells, np.unique(mesh.topology.facets[mesh.sides[side]])).any(axis=1)
    assert moved[~touching].max() < 1e-12 * radius


def test_a_side_that_is_not_round_is_refused() -> None:
    mesh = sample("coarse/disc_quarter.msh")
    with pytest.raises(MeshError, match="'equator' is no part of a circle or ball"):
        refined_round(mesh, 1, ["equator"])
