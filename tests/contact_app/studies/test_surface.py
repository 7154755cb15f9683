"""The answer on the surface alone is the answer, and its files can be read."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.surface import (
    SurfaceFields,
    surface_fields,
    write_surface,
)

CONFIGS = Path(__file__).parents[3] / "configs"


def solved_scene(name: str, *overrides: str) -> tuple[SolvedScene, SurfaceFields]:
    solved = solve_scene(build_scene(load(CONFIGS / f"{name}.yaml", overrides)))
    return solved, surface_fields(solved.model, solved.solution)


@pytest.fixture(scope="module")
def cube() -> tuple[SolvedScene, SurfaceFields]:
    return solved_scene(
        "cube", "bodies.0.mesh.box.cells=[6,6,6]", "decomposition.subdomains=[2,3,2]"
    )


def test_it_agrees_with_the_fields_at_all_nodes(cube: tuple[SolvedScene, SurfaceFields]) -> None:
    solved, surface = cube
    nodes, found = solved.nodes, solved.summary["solution"]
    assert surface.largest_displacement == pytest.approx(found["max_displacement"], rel=1e-5)
    assert surface.mean_displacement == pytest.approx(found["mean_displacement"], rel=1e-5)
    np.testing.assert_allclose(surface.contact_force, found["contact_force"], rtol=1e-9)
    assert surface.contact_pressure.max() == pytest.approx(found["max_contact_pressure"], rel=1e-9)
    at = {tuple(np.round(p, 9)): i for i, p in enumerate(nodes.points)}
    same = np.array([at[tuple(np.round(p, 9))] for p in surface.points])
    tolerance = 1e-5 * found["max_displacement"]
    np.testing.assert_allclose(
        surface.displacement, nodes.displacement[same], rtol=0, atol=tolerance
    )
    np.testing.assert_allclose(surface.contact_pressure, nodes.contact_pressure[same], rtol=1e-9)


def test_surface_file(cube: tuple[SolvedScene, SurfaceFields], tmp_path: Path) -> None:
    _, surface = cube
    write_surface(surface, tmp_path / "surface.xdmf", MPI.COMM_SELF)
    read = meshio.read(tmp_path / "surface.xdmf")
    (quads,) = (c for c in read.cells if c.type == "quad")
    assert len(quads.data) == 6 * 36
    corners = read.points[quads.data]
    area = np.linalg.norm(
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1
    )
    assert area.sum() / 2 == pytest.approx(6.0)  # vertices in order, or quads would fold
    np.testing.assert_array_equal(read.point_data["displacement"], surface.displacement)
    assert read.point_data["contact_pressure"].max() > 0
