"""The answer on the surface alone is the answer, and its files can be read."""

from __future__ import annotations

from pathlib import Path

import h5py
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
    write_all_nodes,
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


@pytest.mark.parametrize(
    "overrides",
    [
        ("cube", "bodies.0.mesh.box.cells=[6,6,6]", "decomposition.subdomains=[2,3,2]"),
        ("cube", "bodies.0.mesh.box.cells=[4,4,4]", "bodies.0.mesh.box.cell=tetrahedron"),
        ("block_2d", "decomposition.subdomains=[2,2]"),
        ("block_2d", "decomposition.subdomains=[2,2]", "bodies.0.degree=2"),
        (
            "sphere",
            "bodies.0.mesh.box.cells=[6,6,3]",
            "bodies.0.degree=2",
            "decomposition.subdomains=[2,1,1]",
        ),
    ],
    ids=["hexahedra", "tetrahedra", "plane", "plane of degree 2", "hexahedra of degree 2"],
)
def test_it_agrees_with_the_fields_at_all_nodes(overrides: tuple[str, ...]) -> None:
    solved, surface = solved_scene(*overrides)
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


@pytest.mark.parametrize(("cell", "name"), [("hexahedron", "quad9"), ("tetrahedron", "triangle6")])
def test_surface_file_of_degree_2(cell: str, name: str, tmp_path: Path) -> None:
    """All nodes belong to facets, in VTK's order: middles amid their corners."""
    _, surface = solved_scene(
        "cube", "bodies.0.mesh.box.cells=[2,2,2]", f"bodies.0.mesh.box.cell={cell}",
        "bodies.0.degree=2",
    )  # fmt: skip
    write_surface(surface, tmp_path / "surface.xdmf", MPI.COMM_SELF)
    read = meshio.read(tmp_path / "surface.xdmf")
    (block,) = read.cells
    assert block.type == name
    assert len(np.unique(block.data)) == len(read.points)
    x, v = read.points[block.data], 4 if name == "quad9" else 3
    edges = 0.5 * (x[:, :v] + np.roll(x[:, :v], -1, axis=1))
    np.testing.assert_allclose(x[:, v : 2 * v], edges, atol=1e-12)


def test_lattice_file_holds_all_displacements_and_no_mesh(
    cube: tuple[SolvedScene, SurfaceFields], tmp_path: Path
) -> None:
    solved, _ = cube
    write_all_nodes(solved.model, solved.solution, tmp_path / "all.xdmf")
    text = (tmp_path / "all.xdmf").read_text()
    assert text.count("3DCoRectMesh") == 12
    known = {
        tuple(np.round(p, 6)): u
        for p, u in zip(solved.nodes.points, solved.nodes.displacement, strict=True)
    }
    with h5py.File(tmp_path / "all.h5") as file:
        blocks = file["displacement"]
        assert sum(b.size for b in blocks.values()) == 12 * 4 * 3 * 4 * 3
        u = blocks["0"][()]
    for k, j, i in ((0, 0, 0), (3, 2, 3), (1, 2, 3)):
        expected = known[tuple(np.round(np.array([i, j, k]) / 6, 6))]
        np.testing.assert_allclose(u[k, j, i], expected, rtol=1e-3, atol=1e-8)


def test_tetrahedra_need_a_mesh(tmp_path: Path) -> None:
    solved, _ = solved_scene(
        "cube", "bodies.0.mesh.box.cells=[2,2,2]", "bodies.0.mesh.box.cell=tetrahedron"
    )
    with pytest.raises(ValueError, match="boxes of hexahedra"):
        write_all_nodes(solved.model, solved.solution, tmp_path / "all.xdmf")
