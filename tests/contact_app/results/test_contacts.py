"""Each contact alone: force, moment, area, nodes and pressure, also of half a scene."""

import copy
import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from contact_app.model.symmetry import halved
from contact_app.results.plot.stored import read
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes
from tests.boundary_integrals import WEIGHTS, Where, facets, integral, pressure_of
from tests.comparison import same_contacts, solve
from tests.rows import covering
from tests.scenes_on_ranks import one_and_two

BETWEEN_WALLS: scenes.Config = {
    "dimension": 2,
    "bodies": [scenes.box("b", [1, 1], [4, 4])],
    "conditions": [{"on": "b.y+", "pressure": 10}],
    "contacts": [
        {"on": "b.y-", "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}},
        {"on": "b.x-", "obstacle": {"plane": {"point": [0, 0], "normal": [1, 0]}}},
        {"on": "b.x+", "obstacle": {"plane": {"point": [1, 0], "normal": [-1, 0]}}},
    ],
}  # fmt: skip
"""A block pressed from above between a floor and two walls: its stress is uniform."""

WALL = 10 * 0.3 / (1 - 0.3)
"""Pressure on the walls in plane strain."""

CELLS = [(cell, degree) for cell in (*scenes.CELLS_2D, *scenes.CELLS_3D) for degree in (1, 2)]


def plane_at(axis: int, at: float) -> Where:
    """Points across an axis."""
    return lambda points: np.abs(points[..., axis] - at) < 1e-9


def file_with_rows(directory: Path, made: scenes.Config) -> tuple[dict[str, Any], Any]:
    """Summary and grid of a run."""
    path = scenes.write(made, directory / "scene.yaml")
    assert run(scenes.read(path), directory / "out") == 0
    return json.loads((directory / "out" / "summary.json").read_text()), read(directory / "out")


def test_at_a_node_of_two_contacts_the_larger_pressure_counts(tmp_path: Path) -> None:
    """10 on the floor and 4.286 on the walls, not 14.29 in the corners."""
    summary, grid = file_with_rows(tmp_path, BETWEEN_WALLS)
    assert summary["solution"]["max_contact_pressure"] == pytest.approx(10.0, rel=1e-6)
    floor, *walls = summary["contacts"]
    assert floor["on"] == "b.y-"
    assert floor["force"] == pytest.approx([0, 10, 0], abs=1e-6)
    assert floor["max_pressure"] == pytest.approx(10.0, rel=1e-6)
    for wall, side, sign in zip(walls, ("b.x-", "b.x+"), (1, -1), strict=True):
        assert wall["on"] == side
        assert wall["force"] == pytest.approx([sign * WALL, 0, 0], abs=1e-6)
        assert wall["max_pressure"] == pytest.approx(WALL, rel=1e-6)
    for contact in summary["contacts"]:
        assert contact["with"] == "plane"
        assert contact["moment"] == pytest.approx(0.0, abs=1e-6)
        assert contact["area"] == pytest.approx(1.0)
        assert contact["nodes"] == {"open": 0, "stick": 0, "slip": 5}
    assert [c["point"] for c in summary["contacts"]] == [
        pytest.approx(p) for p in ([0.5, 0, 0], [0, 0.5, 0], [1, 0.5, 0])
    ]
    x, y, _ = grid.points.T
    on = [np.abs(y) < 1e-9, np.abs(x) < 1e-9, np.abs(x - 1) < 1e-9]
    known = [np.where(at, p, 0.0) for at, p in zip(on, (10.0, WALL, WALL), strict=True)]
    for number, values in enumerate(known, 1):
        found = grid.point_data[f"contact_pressure_{number}"]
        np.testing.assert_allclose(found, values, rtol=0, atol=1e-5)
    found = grid.point_data["contact_pressure"]
    np.testing.assert_allclose(found, np.max(known, axis=0), rtol=0, atol=1e-5)


def in_corner(cell: str, degree: int) -> scenes.Config:
    """A free body in a corner of planes, under loads that have moments."""
    n = 4 if scenes.dimension(cell) == 2 else 3 - (degree == 2)
    made = scenes.floating_in_corner(cell, n)
    made["bodies"][0]["degree"] = degree
    made["solver"]["tolerance"] = 1e-10
    return made


def load_of(solved: Any, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about a point of the loads of `in_corner`, by plane integrals."""
    d = solved.model.scene.dimension
    weight, middle = np.zeros(3), np.full(3, 0.5) * (np.arange(3) < d)
    force, moment = np.zeros(3), np.zeros(3)
    loads = [
        ([0, 0, -30], d - 1), ([-10, 0, -25], 0), ([-2, -4, -8], None),
    ]  # fmt: skip
    for vector, axis in loads:
        weight = np.array(vector if d == 3 else [vector[0], vector[2], 0.0], float)
        at = middle.copy()
        if axis is not None:
            at[axis] = 1.0
        force += weight  # the block has sides of one
        moment += np.cross(at - point, weight)
    return force, moment


@pytest.mark.parametrize(
    ("subdomains", "cell", "degree"),
    covering([1, 3], scenes.CELLS_2D + scenes.CELLS_3D, (1, 2), together=2),
)
def test_a_free_body_is_in_balance(cell: str, degree: int, subdomains: int) -> None:
    """Forces and moments of the contacts and the loads; each pressure is its force."""
    solved = solve(in_corner(cell, degree), subdomains)
    d, contacts = solved.model.scene.dimension, solved.summary["contacts"]
    total = np.sum([c["force"] for c in contacts], axis=0)
    np.testing.assert_allclose(solved.summary["solution"]["contact_force"], total, atol=1e-9)
    origin = np.array([0.3, -2.0, 0.7]) * (np.arange(3) < d)
    force, moment = load_of(solved, origin)
    np.testing.assert_allclose(total, -force, atol=1e-6)
    for c in contacts:
        own = np.array(c["moment"]) if d == 3 else np.array([0, 0, c["moment"]])
        moment += own + np.cross(np.array(c["point"]) - origin, c["force"])
    np.testing.assert_allclose(moment, 0.0, atol=1e-6)
    for number, (c, axis) in enumerate(zip(contacts, [d - 1, 0, 1], strict=False)):
        where = plane_at(axis, 0.0)
        pressure = pressure_of(solved, number)
        normal = integral(solved, where, pressure)
        assert normal == pytest.approx(c["force"][axis], rel=1e-8)
        assert c["max_pressure"] == pressure.max() == pressure[on(solved, where)].max()
    assert solved.summary["solution"]["max_contact_pressure"] == max(
        c["max_pressure"] for c in contacts
    )


def on(solved: Any, where: Where) -> np.ndarray:
    """Nodes of the facets there."""
    return np.unique(np.concatenate([nodes.ravel() for nodes, _, _ in facets(solved, where)]))


@pytest.mark.parametrize(("cell", "degree"), CELLS)
def test_area_point_and_nodes(cell: str, degree: int) -> None:
    """Against sums over the facets; a part of the boundary stays open."""
    made = scenes.tilted_plane(cell, 4 if scenes.dimension(cell) == 2 else 3)
    made["bodies"][0]["degree"] = degree
    solved = solve(made, 2)
    d, (contact,) = solved.model.scene.dimension, solved.summary["contacts"]
    where = plane_at(d - 1, 0.0)
    ones = np.ones(len(solved.nodes.points))
    assert contact["point"] == pytest.approx([0.5] * (d - 1) + [0.0] * (4 - d))
    assert contact["nodes"]["stick"] == 0
    vertices = cell == "tetrahedron" and degree == 2
    every = on(solved, where)
    if vertices:
        every = np.unique(np.concatenate([n[:, :3].ravel() for n, *_ in facets(solved, where)]))
    active = solved.summary["solution"]["active_contacts"]
    assert contact["nodes"] == {"open": len(every) - active, "stick": 0, "slip": active}
    assert 0 < active < len(every)
    share = np.zeros(len(ones))
    for nodes, _, area in facets(solved, where):
        weight = np.array([1 / 3] * 3 if vertices else WEIGHTS[d, nodes.shape[1]])
        np.add.at(share, nodes[:, : len(weight)], area[:, None] * weight)
    closed = np.zeros(len(ones), bool)
    found = solved.nodes.contacts[0]
    closed[found.nodes] = found.closed
    assert contact["area"] == pytest.approx(share[closed].sum())
    assert share.sum() == pytest.approx(1.0)


def test_on_a_round_obstacle() -> None:
    """A bore of degree 2: rows are means about vertices with normals that turn.

    The block lies in it with two edges, its load is larger at one end.
    """
    for cell in scenes.CELLS_3D:
        made = scenes.config(
            cell,
            [{**scenes.block(cell, 2, lower=(-0.5, 0, -0.5), upper=(0.5, 1, 0.5)), "degree": 2}],
            [{"in": "block", "force": [0, 0, -20]}, {"on": "block.y+", "traction": [0, 0, -5]}],
            [{"on": f"block.{side}", "obstacle": {"cylinder": {
                "point": [0, 0, 0], "axis": [0, 1, 0], "radius": 0.7072, "hollow": True}}}
             for side in ("z-", "x+", "x-")],
        )  # fmt: skip
        solved = solve(made, 1, tolerance=1e-10)
        contacts = solved.summary["contacts"]
        assert {c["with"] for c in contacts} == {"cylinder"}
        total = np.sum([c["force"] for c in contacts], axis=0)
        np.testing.assert_allclose(total, [0, 0, 25], atol=1e-5)
        moment = np.cross([0, 0.5, 0], [0, 0, -20]) + np.cross([0, 1, 0], [0, 0, -5])
        for c in contacts:
            moment = moment + c["moment"] + np.cross(c["point"], c["force"])
        np.testing.assert_allclose(moment, 0.0, atol=1e-5)


STACKS = [("quadrilateral", 1), ("triangle", 2), ("hexahedron", 1), ("tetrahedron", 2)]


@pytest.mark.parametrize(("cell", "degree"), STACKS)
def test_action_and_reaction(cell: str, degree: int) -> None:
    """A body on another in a corner: the pair's force and moment are those of the upper's loads.

    The upper one reaches over the lower one: facets are covered in part.
    """
    d, lower = scenes.dimension(cell), in_corner(cell, degree)
    upper = scenes.block(cell, 3, "upper", lower=(0.4, 0.4, 1), upper=(1.3, 1.3, 1.5))
    upper["degree"] = degree
    lower["bodies"].append(upper)
    lower["contacts"].append({"on": f"upper.{scenes.down(cell)}", "against":
                              f"block.{scenes.up(cell)}"})  # fmt: skip
    push = scenes.vector(cell, 0.0, 0.0, -40.0)
    lower["conditions"] += [
        {"in": "upper", "force": push},
        {"on": "upper.x-", "traction": scenes.vector(cell, -0.0, 0, -3)},
    ]
    solved = solve(lower, 1)
    *walls, pair = solved.summary["contacts"]
    name = ["block.y+", "block.z+"][d - 2]
    assert (pair["on"], pair["with"]) == (f"upper.{scenes.down(cell)}", name)
    key = f"contacts[{len(walls)}]"
    np.testing.assert_allclose(
        solved.summary["solution"]["pair_forces"][key], pair["force"], atol=1e-9
    )
    wide = 0.9 if d == 2 else 0.81
    middle = np.array([0.85, 0.85, 1.25] if d == 3 else [0.85, 1.25, 0])
    side = middle.copy()
    side[0] = 0.4
    down = np.eye(3)[d - 1]
    body, face = -40.0 * 0.5 * wide * down, -3.0 * 0.5 * (0.9 if d == 3 else 1.0) * down
    np.testing.assert_allclose(pair["force"], -body - face, atol=1e-6)
    point = np.array(pair["point"])
    own = np.array(pair["moment"]) if d == 3 else np.array([0, 0, pair["moment"]])
    moment = own + np.cross(middle - point, body) + np.cross(side - point, face)
    np.testing.assert_allclose(moment, 0.0, atol=1e-6)
    force, turn = load_of(solved, point)  # and the reaction is in balance on the lower one
    for c in walls:
        force = force + c["force"]
        its = np.array(c["moment"]) if d == 3 else np.array([0, 0, c["moment"]])
        turn = turn + its + np.cross(np.array(c["point"]) - point, c["force"])
    np.testing.assert_allclose(force, pair["force"], atol=1e-6)
    np.testing.assert_allclose(turn, own, atol=1e-6)


@pytest.mark.parametrize(("cell", "degree"), STACKS)
def test_pressure_of_a_pair_is_its_force(cell: str, degree: int) -> None:
    """On the part that the other body covers, here whole facets."""
    d = scenes.dimension(cell)
    lower = scenes.block(cell, 4, "lower", upper=(2, 1, 1))
    upper = scenes.block(cell, 2, "upper", lower=(0.5, 0, 1), upper=(1.5, 1, 2), young=300.0)
    for body in (lower, upper):
        body["degree"] = degree
    made = scenes.config(
        cell,
        [lower, upper],
        [scenes.clamp(cell, f"lower.{scenes.down(cell)}"),
         {"on": "upper.x-", "displacement": [0.0] + [None] * (d - 1)},
         {"on": f"upper.{scenes.up(cell)}", "pressure": 12},
         *([{"on": "upper.y-", "displacement": [None, 0.0, None]}] if d == 3 else [])],
        [{"on": f"lower.{scenes.up(cell)}", "against": f"upper.{scenes.down(cell)}"}],
    )  # fmt: skip
    solved = solve(made, 1)
    (contact,) = solved.summary["contacts"]
    assert contact["force"][d - 1] == pytest.approx(-12, rel=1e-6)
    level = plane_at(d - 1, 1.0)
    first = solved.model.partition.first_node
    pressure = pressure_of(solved, 0)
    assert not pressure[first[1] :].any(), "it stands on the side of `on`"

    def covered(points: np.ndarray) -> np.ndarray:
        return level(points) & (points[..., 0] > 0.5 - 1e-9) & (points[..., 0] < 1.5 + 1e-9)

    assert integral(solved, covered, pressure) == pytest.approx(12, rel=1e-6)


@pytest.mark.parametrize(("cell", "degree"), CELLS)
def test_half_a_scene_reports_the_whole(cell: str, degree: int, tmp_path: Path) -> None:
    """Walls of which one is left out, a ball in the middle; nodes on the plane count once."""
    d = scenes.dimension(cell)
    body = {**scenes.block(cell, 4), "degree": degree}
    if cell in ("triangle", "tetrahedron"):  # boxes of these do not mirror
        mesh = meshfiles.mirrored(cell, 4 // degree, "x")
        body["mesh"] = {"file": str(meshfiles.write(mesh, tmp_path / "block.msh"))}
        high = "y+" if d == 2 else "z+"
    else:
        body["mesh"]["box"]["cells"] = [4 // degree] * d
        high = scenes.up(cell)
    body["boundaries"] = {
        "left": {"where": f"x < 0.5 + 1e-9 and {'xyz'[d - 1]} < 1e-9"},
        "right": {"where": f"x > 0.5 - 1e-9 and {'xyz'[d - 1]} < 1e-9"},
    }
    made = scenes.config(
        cell,
        [body],
        [{"on": f"block.{high}", "pressure": 30}, {"in": "block", "force": [0.0] * (d - 1) + [-9]},
         *([{"on": "block.y-", "displacement": [None, 0, None]}] if d == 3 else [])],
        [{"on": "block.x+", "obstacle": scenes.plane(cell, (1, 0, 0), (-1, 0, 0.1))},
         {"on": "block.right", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1))},
         {"on": "block.x-", "obstacle": scenes.plane(cell, (0, 0, 0), (2, 0, 0.2))},
         {"on": "block.left", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 3))},
         {"on": f"block.{high}", "obstacle":
             {"sphere": {"center": scenes.vector(cell, 0.5, 0.5, 2.0), "radius": 1.1}}}],
    )  # fmt: skip
    scene = scenes.build(made, 2)
    half = halved(scene).scene
    assert [m.axis for m in half.mirrors][:1] == [0]
    assert len(half.touching) < len(scene.touching), "a wall and a floor are images"
    known, found = solve_scene(scene), solve_scene(half)
    assert [c["on"] for c in known.summary["contacts"]] == [c["on"] for c in made["contacts"]]
    assert all(np.abs(known.summary["contacts"][i]["force"]).max() > 0.1 for i in (1, 3, 4))
    same_contacts(found.summary, known.summary, 1e-5)


def test_half_a_scene_writes_the_fields_of_the_whole(tmp_path: Path) -> None:
    """Two floors that meet on the plane of symmetry overlap there, though one is left out."""
    body = scenes.block("quadrilateral", 4, boundaries={
        "left": "x < 0.5 + 1e-9 and y < 1e-9", "right": "x > 0.5 - 1e-9 and y < 1e-9",
    })  # fmt: skip
    floor = scenes.plane("quadrilateral", (0, 0, 0), (0, 0, 1))
    made = scenes.config(
        "quadrilateral",
        [body],
        [{"on": "block.y+", "pressure": 10}],
        [{"on": f"block.{side}", "obstacle": copy.deepcopy(floor)} for side in ("right", "left")],
    )
    fields = []
    for name, symmetry in (("whole", "none"), ("half", "allow")):
        (tmp_path / name).mkdir()
        summary, grid = file_with_rows(tmp_path / name, {**made, "symmetry": symmetry})
        assert ("symmetry" in summary) == (symmetry == "allow")
        order = np.lexsort(np.round(grid.points, 9).T)
        x, y, _ = grid.points[order].T
        for number, inside in ((1, x > 0.5 - 1e-9), (2, x < 0.5 + 1e-9)):
            values = grid.point_data[f"contact_pressure_{number}"][order]
            expected = np.where(inside & (np.abs(y) < 1e-9), 10.0, 0.0)
            np.testing.assert_allclose(values, expected, atol=1e-5)
        fields.append(sorted(grid.point_data))
    assert fields[0] == fields[1]


@pytest.mark.parametrize(
    ("contacts", "names"),
    [
        ([0], []),
        ([1, 2], []),
        ([0, 1], ["contact_pressure_1", "contact_pressure_2"]),
        ([1, 2, 0], ["contact_pressure_1", "contact_pressure_2", "contact_pressure_3"]),
    ],
)
def test_fields_of_contacts_are_written_where_they_overlap(
    contacts: list[int], names: list[str], tmp_path: Path
) -> None:
    chosen = [BETWEEN_WALLS["contacts"][i] for i in contacts]
    made = {**BETWEEN_WALLS, "contacts": chosen}
    made["conditions"] = [
        *made["conditions"], {"on": "b.y-", "displacement": [0, 0]}
    ] if 0 not in contacts else made["conditions"]  # fmt: skip
    _, grid = file_with_rows(tmp_path, made)
    found = sorted(n for n in grid.point_data if n.startswith("contact_pressure_"))
    assert found == names
    assert "contact_pressure" in grid.point_data


def test_fields_of_contacts_are_written_on_request_only(tmp_path: Path) -> None:
    made = {**BETWEEN_WALLS, "output": {"fields": ["displacement", "gap"]}}
    _, grid = file_with_rows(tmp_path, made)
    assert sorted(grid.point_data) == ["displacement", "gap"]


def test_in_the_order_of_the_file() -> None:
    """Pairs and obstacles in turn, and the side `on` of each."""
    made = scenes.config(
        "quadrilateral",
        [scenes.block("quadrilateral", 2, "low"),
         scenes.block("quadrilateral", 3, "high", lower=(0, 0, 1), upper=(1, 1, 2))],
        [{"on": "high.y+", "pressure": 10}, {"on": "high.x-", "displacement": [0, None]},
         {"on": "low.x-", "displacement": [0, None]}],
        [{"on": "high.y-", "against": "low.y+"},
         {"on": "low.y-", "obstacle": scenes.plane("quadrilateral", (0, 0, 0), (0, 0, 1))}],
    )  # fmt: skip
    first, second = solve(made).summary["contacts"]
    assert (first["on"], first["with"]) == ("high.y-", "low.y+")
    assert (second["on"], second["with"]) == ("low.y-", "plane")
    assert first["force"][1] == pytest.approx(10)
    assert second["force"][1] == pytest.approx(10)
    assert second["point"] == pytest.approx([0.5, 0, 0])


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 1), ("tetrahedron", 2)])
def test_two_ranks(cell: str, degree: int, tmp_path: Path) -> None:
    made = in_corner(cell, degree)
    one, two = one_and_two(made, tmp_path, 4)
    same_contacts(two, one, 1e-7)
    first, second = (meshio_fields(tmp_path / f"out{ranks}") for ranks in (1, 2))
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_allclose(second[name], values, rtol=0, atol=1e-6 * np.abs(values).max())


def meshio_fields(directory: Path) -> dict[str, np.ndarray]:
    """Pressures of contacts in an order of nodes that does not depend on the ranks."""
    with meshio.xdmf.TimeSeriesReader(directory / "solution.xdmf") as reader:
        points, _ = reader.read_points_cells()
        _, fields, _ = reader.read_data(0)
    order = np.lexsort(np.round(points, 9).T)
    return {name: v[order] for name, v in fields.items() if name.startswith("contact_pressure")}
