"""Bodies whose mesh comes from a file: patch tests, materials by group, any decomposition."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import yaml
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.outline import outline_of_scene
from contact_app.run.check import describe
from contact_app.run.solve import solve_scene
from tests import meshfiles, reference, scenes
from tests.comparison import same_displacement
from tests.scenes_on_ranks import one_and_two, same_solution

CELLS = tuple(meshfiles.MESHIO)


def patch(cell: str, file: Path, young: float = 900.0, poisson: float = 0.25) -> scenes.Config:
    """The block of the verification's contact patch test, pressed on a plane."""
    d = meshfiles.dimension(cell)
    top = scenes.up(cell)
    rollers = scenes.rollers(cell, axes="xy"[: d - 1])
    made = scenes.config(
        cell,
        [{"name": "block", "mesh": {"file": str(file)},
          "material": {"young": young, "poisson": poisson}}],
        [*rollers, {"on": f"block.{top}", "pressure": 100}],
        [scenes.on_floor(cell)],
    )  # fmt: skip
    made["solver"]["tolerance"] = 1e-11
    return made


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("subdomains", [1, 5])
def test_contact_patch_on_distorted_cells(
    cell: str, degree: int, subdomains: int, tmp_path: Path
) -> None:
    """verification.md: E = 900, ν = 0.25, q = 100: u = (1/36, 1/36, -1/9) at the free corner."""
    file = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    made = patch(cell, file)
    made["bodies"][0]["degree"] = degree
    solved = solve_scene(scenes.build(made, subdomains))
    points, u = solved.nodes.points, solved.nodes.displacement
    d = meshfiles.dimension(cell)
    if d == 3:
        slope = np.array([1 / 36, 1 / 36, -1 / 9])
    else:  # plane strain: u_y = -q (1 - ν²)/E, u_x = ν (1 + ν) q/E
        slope = np.array([0.25 * 1.25, -(1 - 0.25**2)]) * 100 / 900
    np.testing.assert_allclose(u, points[:, :d] * slope, rtol=0, atol=1e-9 * np.abs(slope).max())
    assert solved.summary["certificate"]["passed"]
    pressure = solved.nodes.contact_pressure
    assert pressure[pressure > 0.0] == pytest.approx(100.0, rel=1e-6)
    assert (pressure > 0.0).sum() == (4 * degree + 1) ** (d - 1)
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
    same_displacement(known, solved)
    assert solved.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-9)


@pytest.mark.parametrize("subdomains", [2, 3, 9, [2, 1, 2]])
def test_the_answer_does_not_depend_on_the_decomposition(
    subdomains: int | list[int], tmp_path: Path
) -> None:
    file = meshfiles.write(meshfiles.block("tetrahedron", 4), tmp_path / "block.msh")
    made = two_materials("tetrahedron", file)
    one, many = (solve_scene(scenes.build(made, n)) for n in (1, subdomains))
    assert many.model.partition.count >= np.prod(subdomains)
    for key, value in one.summary["solution"].items():
        assert many.summary["solution"][key] == pytest.approx(value, rel=1e-7, abs=1e-8), key
    (x, u), (y, v) = ((s.nodes.points, s.nodes.displacement) for s in (one, many))
    np.testing.assert_allclose(y, x, rtol=0, atol=1e-15)  # they go by the corner of a subdomain
    np.testing.assert_allclose(v, u, rtol=0, atol=1e-8 * np.abs(u).max())
    for field in ("stress", "von_mises"):
        order = [np.lexsort(np.sort(np.concatenate(s.cells.cells), axis=1).T) for s in (one, many)]
        a, b = (getattr(s.cells, field)[o] for s, o in zip((one, many), order, strict=True))
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-7 * np.abs(a).max())


def test_the_answer_does_not_depend_on_the_ranks(tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block("tetrahedron", 4), tmp_path / "block.msh")
    made = two_materials("tetrahedron", file)
    one, two = one_and_two(made, tmp_path, 5)
    assert two["mesh"] == one["mesh"]
    assert {key: two["solver"][key] for key in one["solver"]} == one["solver"]
    same_solution(one, two, 1e-9)


def written(made: scenes.Config, directory: Path) -> Path:
    """A scene file beside its mesh, one key a line."""
    path = directory / "part.yaml"
    path.write_text(yaml.dump(made, sort_keys=False))
    return path


def test_the_path_counts_from_the_scene_file(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    meshfiles.write(meshfiles.block("triangle", 2), tmp_path / "meshes" / "block.msh")
    made = patch("triangle", Path("meshes/block.msh"))
    scene = scenes.read(written(made, tmp_path))
    assert scene.bodies[0].mesh.nodes == 9
    assert scene.bodies[0].mesh.boundaries == ("x-", "x+", "y-", "y+")


def test_boundaries_by_expression_use_the_placed_mesh(tmp_path: Path) -> None:
    """Millimetres become metres and x becomes y: the same answer, turned."""
    file = meshfiles.write(meshfiles.block("hexahedron", 4), tmp_path / "block.msh")
    made = two_materials("hexahedron", file)
    upright = solve_scene(scenes.build(made))
    body = made["bodies"][0]
    body["mesh"].update(scale=0.5, rotate={"angle": 90, "axis": [0, 0, 1]}, translate=[0, 0, 3])
    body["boundaries"] = {"clamp": {"where": "y < 1e-9"}, "crown": {"where": "z > 3.5 - 1e-9"}}
    made["conditions"] = [
        {"on": "block.clamp", "displacement": [0, 0, 0]},
        {"on": "block.crown", "traction": [-1, 3, -60]},
    ]
    made["contacts"][0]["obstacle"]["sphere"] = {"center": [-0.2, 0.35, 1.995], "radius": 1.0}
    turned = solve_scene(scenes.build(made))
    force = np.array(upright.summary["solution"]["contact_force"])
    other = np.array(turned.summary["solution"]["contact_force"])
    np.testing.assert_allclose(other * 4, [-force[1], force[0], force[2]], rtol=1e-6, atol=1e-8)
    assert turned.summary["solution"]["energy"] * 8 == pytest.approx(
        upright.summary["solution"]["energy"], rel=1e-8
    )


def test_check_and_the_run_report_repairs(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    given.cells[0].data = given.cells[0].data[:, ::-1]
    file = meshfiles.write(given, tmp_path / "block.msh")
    scene = scenes.build(patch("triangle", file))
    expected = "8 cells were inside out (negative volume): turned"
    lines = describe(scene, outline_of_scene(scene, MPI.COMM_SELF))
    assert f"  {expected}" in lines
    assert any("block.msh of 8 cells (triangle), Young's modulus 900" in line for line in lines)
    assert f"block: {expected}" in solve_scene(scene).model.notes


WRONG = [
    ({"bodies.0.mesh.file": "none.msh"}, "part.yaml:6: bodies[0].mesh.file is ", "does not exist"),
    ({"bodies.0.mesh.file": "a" * 300 + ".msh"}, "mesh.file is ", "which cannot be read: "),
    ({"bodies.0.mesh.file": "a\0b"}, "which is no valid file name", ""),
    ({"bodies.0.mesh.file": 5}, "mesh.file is 5; text is allowed", ""),
    ({"bodies.0.mesh.scale": 0}, "bodies[0].mesh.scale is 0; it must be at least", ""),
    ({"bodies.0.mesh.rotate": {"angle": 9, "axis": [0, 0, 1]}}, "rotate.axis is not allowed", ""),
    ({"bodies.0.mesh.rotate": 90}, "a mapping is allowed, with the keys angle, axis", ""),
    ({"bodies.0.mesh.translate": [1, 2, 3]}, "has 3 components; a translation in 2D has 2", ""),
    ({"bodies.0.mesh.refine": 7}, "bodies[0].mesh.refine is 7; it must be at most 6", ""),
    ({"bodies.0.mesh.group": "sof"}, "which has no group of cells named 'sof'", "soft, hard"),
    ({"bodies.0.mesh.group": 7}, "allowed: the name of a group of cells or a list", ""),
    ({"bodies.0.mesh": {}}, "bodies[0].mesh needs `box: ", "or `file: part.msh`"),
    ({"bodies.0.material": {"soft": {"young": 1, "poisson": 0.3}}}, "bodies[0].material leaves 4 "
     "of 8 cells without a material", "(groups of cells in block.msh: soft, hard)"),
    ({"bodies.0.material": {"soft": {"young": 1}, "hard": {"young": 1, "poisson": 0.3}}},
     "bodies[0].material.soft.poisson is missing", ""),
    ({"bodies.0.material": {"soft": {"young": 1, "poisson": 0.7}, "hard": {"young": 1,
      "poisson": 0.3}}}, "bodies[0].material.soft.poisson is 0.7; an isotropic", ""),
    ({"bodies.0.boundaries": {"x-": {"where": "x < 1"}}}, "redefines x-, which the mesh", ""),
    ({"conditions.0.on": "block.side"}, "names the boundary 'side' of block", "known: x-, x+, y-"),
    ({"conditions.0.on": "block.soft"}, "'soft' of block; it is a group of cells, not", "known: "),
    ({"conditions.0.on": "block.z-"}, "names the boundary 'z-' of block; only a box has it", ""),
    ({"decomposition": {"subdomains": [9, 9]}}, "asks for 81 parts, where block has 8", ""),
    ({"decomposition": {"subdomains": 9}}, "is 9; at most one per cell is allowed, 8 here", ""),
    ({"dimension": 3}, "none of dimension 3; allowed: tetra (tetra10)", "mesh in 3D"),
]  # fmt: skip


def test_a_mesh_without_names_is_reported(tmp_path: Path) -> None:
    mesh = meshfiles.block("triangle", 2)
    bare = meshio.Mesh(mesh.points, {"triangle": mesh.cells_dict["triangle"]})
    file = meshfiles.write(bare, tmp_path / "block.msh")
    with pytest.raises(ConfigurationError, match="the body has none: name it in the mesh file"):
        scenes.read(written(patch("triangle", file), tmp_path))


@pytest.mark.parametrize(("changes", "expected", "allowed"), WRONG, ids=[w[1][:40] for w in WRONG])
def test_mistakes_are_reported_with_file_line_and_key(
    changes: dict[str, Any], expected: str, allowed: str, tmp_path: Path
) -> None:
    meshfiles.write(meshfiles.block("triangle", 2), tmp_path / "block.msh")
    made: Any = patch("triangle", Path("block.msh"))
    made = scenes.changed(made, changes)
    with pytest.raises(ConfigurationError) as caught:
        scenes.read(written(made, tmp_path))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'part.yaml'}:")
    assert expected in message
    assert allowed in message


def test_refining_more_than_memory_holds_is_refused(tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block("hexahedron", 4), tmp_path / "block.msh")
    made = patch("hexahedron", file)
    made["bodies"][0]["mesh"]["refine"] = 1
    assert scenes.build(made, memory=1e9).bodies[0].mesh.nodes == 9**3
    made["bodies"][0]["mesh"]["refine"] = 6
    with pytest.raises(ConfigurationError, match="mesh.refine makes about .* 1 GB are available"):
        scenes.build(made, memory=1e9)


@pytest.mark.parametrize("cell", CELLS)
def test_a_refined_mesh_passes_the_patch_test(cell: str, tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block(cell, 2), tmp_path / "block.msh")
    made = patch(cell, file)
    made["bodies"][0]["mesh"]["refine"] = 1
    solution = solve_scene(scenes.build(made, 3)).summary["solution"]
    assert solution["max_contact_pressure"] == pytest.approx(100.0, rel=1e-8)


def test_a_box_is_not_placed(tmp_path: Path) -> None:
    made = scenes.wall("triangle", 2)
    made["bodies"][0]["mesh"]["scale"] = 2.0
    with pytest.raises(ConfigurationError, match="scale belongs to a mesh from a file"):
        scenes.build(made)
