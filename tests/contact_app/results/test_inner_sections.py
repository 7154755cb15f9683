"""Section forces on named inner surfaces, against statics, of mesh files and of boxes."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

import contact_app
from contact_app.errors import ConfigurationError
from meshes.bisect import bisected
from meshes.refine import refined
from meshes.repair import load_mesh
from meshes.unstructured import FACETS, CellMesh
from tests import meshfiles, scenes
from tests.rows import covering
from tests.scenes_on_ranks import one_and_two

CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
PULL = np.array([1.5, 0.7, -1.0])
SHEET = 77


def with_sheet(mesh: meshio.Mesh, cell: str, front: np.ndarray) -> meshio.Mesh:
    """A mesh file with the group `sheet`: the facets between the cells in front and others."""
    cells = mesh.cells[0].data[:, : int(np.max(FACETS[cell])) + 1]
    facets = np.sort(cells[:, np.array(FACETS[cell])], axis=2)
    sides = [{tuple(f) for f in facets[mask].reshape(-1, facets.shape[2])}
             for mask in (front, ~front)]  # fmt: skip
    sheet = np.array(sorted(sides[0] & sides[1]))
    kind = meshfiles.FACET[cell]
    data = {key: [*values, np.full(len(sheet), SHEET)] for key, values in mesh.cell_data.items()}
    names = mesh.field_data | {"sheet": np.array([SHEET, meshfiles.dimension(cell) - 1])}
    blocks = [*((b.type, b.data) for b in mesh.cells), (kind, sheet)]
    return meshio.Mesh(mesh.points, blocks, cell_data=data, field_data=names)


def uneven(cell: str, n: int = 4) -> meshio.Mesh:
    """A block of distorted cells whose sheet is a staircase about an oblique plane."""
    mesh = meshfiles.block(cell, n)
    middles = mesh.points[mesh.cells[0].data].mean(axis=1)
    return with_sheet(mesh, cell, middles @ [1.0, 0.3, -0.2] > 0.55)


def held_block(file: Path, cell: str, degree: int) -> scenes.Config:
    d = scenes.dimension(cell)
    return {
        "dimension": d,
        "bodies": [{"name": "b", "degree": degree, "mesh": {"file": str(file)},
                    "material": {"young": 1000, "poisson": 0.3}}],
        "conditions": [{"on": "b.x-", "displacement": [0] * d},
                       {"on": "b.x+", "traction": PULL[:d].tolist()}],
        "solver": {"tolerance": 1e-12},
        "output": {"sections": {"cut": {"on": "b.sheet", "behind": [0.01, *[0.5] * (d - 1)]},
                                "back": {"on": "b.sheet", "behind": [0.99, *[0.5] * (d - 1)]}}},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("subdomains", "degree", "cell"), covering([1, 3], [1, 2], CELLS, together=2)
)
def test_a_staircase_of_facets_carries_the_load(
    cell: str, degree: int, subdomains: int, tmp_path: Path
) -> None:
    made = held_block(meshfiles.write(uneven(cell), tmp_path / "b.msh"), cell, degree)
    made["decomposition"] = {"subdomains": subdomains}
    answer = contact_app.solve(made).summary["sections"]
    d = scenes.dimension(cell)
    pull = np.array([*PULL[:d], *[0.0] * (3 - d)])
    arm = np.array([1.0, 0.5, 0.5 if d == 3 else 0.0]) - answer["cut"]["point"]
    for name, sign in (("cut", 1.0), ("back", -1.0)):
        found, moment = answer[name], sign * np.cross(arm, pull)
        np.testing.assert_allclose(found["force"], sign * pull, atol=1e-8)
        np.testing.assert_allclose(found["moment"], moment[2] if d == 2 else moment, atol=1e-8)
        assert found["area"] > 1.0  # longer than the straight way


@pytest.mark.parametrize(("cell", "name", "degree"), [
    ("tetrahedron", "tetra10", 2), ("hexahedron", "hexahedron27", 2), ("hexahedron",) * 2 + (1,),
])  # fmt: skip
def test_area_and_centroid_of_a_curved_surface(
    cell: str, name: str, degree: int, tmp_path: Path
) -> None:
    """By facets and by a plane: an eighth of a ring in the middle of a tube, curved at degree 2."""
    mesh = meshfiles.block(cell, 4, 0.0)
    front = mesh.points[mesh.cells[0].data].mean(axis=1)[:, 2] > 0.5
    flat = with_sheet(mesh, cell, front)
    if degree == 2:
        flat = meshfiles.second_order(flat, cell, name, meshfiles.bend)
    else:
        flat.points = meshfiles.bend(flat.points)
    made = held_block(meshfiles.write(flat, tmp_path / "b.msh"), cell, degree)
    made["conditions"] = [{"on": "b.z-", "displacement": [0, 0, 0]},
                          {"on": "b.z+", "total_force": [3, 2, 1], "total_moment": [0, 0, 5],
                           "at": [0, 0, 1]}]  # fmt: skip
    plane = {"point": [0, 0, 0.5], "normal": [0, 0, 1]}
    made["output"] = {"sections": {"sheet": {"on": "b.sheet", "behind": [1.2, 0.4, 0.1]},
                                   "plane": {"in": "b", "plane": plane}}}  # fmt: skip
    radius = (8 - 1) / 3 * 2 * np.sin(np.pi / 8) / (3 * np.pi / 8)
    centre = radius * np.array([np.cos(np.pi / 8), np.sin(np.pi / 8)])
    for name, found in contact_app.solve(made).summary["sections"].items():
        np.testing.assert_allclose(found["force"], [3, 2, 1], atol=1e-8)
        moment = np.array([0, 0, 5.0]) + np.cross(np.array([0, 0, 1]) - found["point"], [3, 2, 1])
        np.testing.assert_allclose(found["moment"], moment, atol=1e-8)
        error = 0.02  # four chords of 11 degrees
        if degree == 2:
            error = 1e-4 if name == "sheet" else 2e-3
        assert found["area"] == pytest.approx(3 * np.pi / 8, rel=error)
        np.testing.assert_allclose(found["point"], [*centre, 0.5], rtol=error)


def on_two_feet(degree: int, cell: str) -> scenes.Config:
    """A heavy beam on two planes, loaded off its middle: each part of it is in balance."""
    floor = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}
    return {
        "dimension": 3,
        "bodies": [{
            **scenes.box("b", [4, 1, 1], [8, 2, 2], cell=cell, degree=degree),
            "boundaries": {"left": {"where": "z < 1e-9 and x < 1.01"},
                           "right": {"where": "z < 1e-9 and x > 2.99"},
                           "post": {"where": "abs(x - 1.5) < 1e-9"},
                           "load": {"where": "z > 1 - 1e-9 and x > 2.99"},
                           "half": {"where": "abs(x - 1.5) < 1e-9 and y < 0.6"}},
        }],
        "conditions": [
            {"on": "b.x-", "displacement": [0, None, None]},
            {"on": "b.y-", "displacement": [None, 0, None]},
            {"on": "b.load", "traction": [0, 0, -2]},
            {"in": "b", "force": [0, 0, -0.5]},
        ],
        "contacts": [{"on": "b.left", "obstacle": floor}, {"on": "b.right", "obstacle": floor}],
        "solver": {"tolerance": 1e-11},
        "output": {"sections": {"post": {"on": "b.post", "behind": [0.1, 0.5, 0.5]}}},
    }  # fmt: skip


@pytest.mark.parametrize(("degree", "cell"), [(1, "hexahedron"), (2, "tetrahedron")])
def test_force_and_moment_are_in_balance_with_contact_support_and_weight(
    degree: int, cell: str
) -> None:
    """The part of a box behind facets that an expression names."""
    summary = contact_app.solve(on_two_feet(degree, cell)).summary
    found, foot, end = summary["sections"]["post"], summary["contacts"][0], summary["reactions"][0]
    assert foot["on"] == "b.left"
    assert foot["force"][2] > 0.3
    at, weight = np.array(found["point"]), np.array([0, 0, -0.5 * 1.5])
    np.testing.assert_allclose(at, [1.5, 0.5, 0.5], atol=1e-12)
    force = np.array(found["force"]) + foot["force"] + end["force"] + weight
    moment = np.array(found["moment"]) + np.cross(np.array([0.75, 0.5, 0.5]) - at, weight)
    for part in (foot, end):
        moment = moment + part["moment"] + np.cross(np.array(part["point"]) - at, part["force"])
    np.testing.assert_allclose(force[[0, 2]], 0, atol=1e-8)  # y- holds both parts along y
    assert abs(found["moment"][1]) > 0.05
    np.testing.assert_allclose(moment[1], 0, atol=1e-8)


@pytest.mark.mpi
def test_ranks_agree(tmp_path: Path) -> None:
    file = meshfiles.write(uneven("tetrahedron"), tmp_path / "b.msh")
    one, two = one_and_two(held_block(file, "tetrahedron", 2), tmp_path, 5)
    assert set(one["sections"]) == {"cut", "back"}
    for name, found in one["sections"].items():
        for key, value in found.items():
            np.testing.assert_allclose(two["sections"][name][key], value, atol=1e-8)


def area_between(mesh: CellMesh) -> float:
    """Area of the triangles between the two sides of the sheet."""
    side = np.zeros(mesh.total_cells, bool)
    side[mesh.inner["sheet"]] = True
    one, other = mesh.topology.pairs.T
    across = side[one] != side[other]
    table = np.array(FACETS[mesh.cell])[mesh.topology.pair_facets[across, 0]]
    x = mesh.points[np.take_along_axis(mesh.cells[one[across]], table, axis=1)]
    return float(0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum())


def test_refinement_keeps_the_surface(tmp_path: Path) -> None:
    mesh = load_mesh(meshfiles.write(uneven("tetrahedron"), tmp_path / "b.msh"), 3)
    assert not mesh.notes
    assert "sheet" not in mesh.sides
    area = area_between(mesh)
    assert area > 1.0
    for finer in (refined(mesh), bisected(mesh, np.arange(0, mesh.total_cells, 5))):
        assert finer.total_cells > mesh.total_cells
        assert area_between(finer) == pytest.approx(area, rel=1e-12)


def test_two_sheets_of_one_name_have_a_middle_and_two_ends(tmp_path: Path) -> None:
    """Three parts, of which the first and the last are on one side."""
    mesh = meshfiles.block("hexahedron", 4, 0.0)
    x = mesh.points[mesh.cells[0].data].mean(axis=1)[:, 0]
    mesh = with_sheet(mesh, "hexahedron", (x > 0.25) & (x < 0.75))
    made = held_block(meshfiles.write(mesh, tmp_path / "b.msh"), "hexahedron", 1)
    answer = contact_app.solve(made).summary["sections"]
    assert answer["cut"]["area"] == pytest.approx(2.0)
    np.testing.assert_allclose(answer["cut"]["force"], 0, atol=1e-8)  # what enters also leaves
    assert answer["back"] == answer["cut"]  # both points are in the ends


def test_symmetry_leaves_a_scene_with_an_inner_surface_whole() -> None:
    made = scenes.wall("hexahedron", 2)
    made["bodies"][0]["boundaries"] = {"mid": {"where": "abs(z - 0.5) < 1e-9"}}
    made["output"] = {"sections": {"mid": {"on": "block.mid", "behind": [0.5, 0.5, 0.1]}}}
    made["symmetry"] = "allow"
    summary = contact_app.solve(made).summary
    assert "symmetry" not in summary or summary["symmetry"]["images"] == 1
    assert summary["sections"]["mid"]["area"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"on": "b.post"}, r"sections\.s\.behind is missing"),
        ({"on": "b.post", "behind": [9, 0, 0]}, r"s\.behind: the point \(9, 0, 0\) does not lie"),
        ({"on": "b.post", "behind": [0, 0]}, r"s\.behind has 2 components"),
        ({"on": "b.half", "behind": [0, 0, 0]}, r"s\.on: .* do not divide b into two sides"),
        ({"on": "b.left", "behind": [0, 0, 0]}, r"s\.on: .* do not divide b into two sides"),
        ({"on": "b.x-", "behind": [0, 0, 0]}, r"s\.on names .*; it is on the surface"),
        ({"on": "b.pst", "behind": [0, 0, 0]}, r"did you mean b\.post"),
        (
            {"on": "b.post", "in": "b", "behind": [0, 0, 0]},
            r"s\.in is an unknown key; `on` names body and surface; allowed: on, behind",
        ),
        ({"in": "b", "behind": [0, 0, 0]}, r"s\.behind .* key; it is for an inner surface"),
        ({}, r"sections\.s\.plane is missing"),
    ],
)
def test_wrong_surfaces_are_refused(section: dict[str, Any], message: str) -> None:
    made = on_two_feet(1, "hexahedron")
    made["output"] = {"sections": {"s": section}}
    with pytest.raises(ConfigurationError, match=message):
        contact_app.solve(made)


def test_an_inner_surface_is_no_boundary(tmp_path: Path) -> None:
    made = held_block(meshfiles.write(uneven("triangle"), tmp_path / "b.msh"), "triangle", 1)
    made["conditions"][1]["on"] = "b.sheet"
    with pytest.raises(ConfigurationError, match="it lies inside, for sections alone"):
        contact_app.solve(made)
