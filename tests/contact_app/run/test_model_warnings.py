"""Warnings of a model that is too small for its answer; each falls silent where it is not."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

import contact_app
from contact_app.accuracy.faceted_curves import Distances
from contact_app.errors import NoEquilibriumError
from contact_app.run.solve import solve_scene
from contact_app.run.warning_texts import flat_facets
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from tests import meshfiles, rings, scenes
from tests.contact_app.model.test_two_bodies import stack


def warnings_of(made: scenes.Config, subdomains: Any = 1) -> str:
    return "\n".join(solve_scene(scenes.build(made, subdomains)).summary["certificate"]["warnings"])


@pytest.mark.parametrize("subdomains", [1, 3])
def test_stress_above_yield(subdomains: int) -> None:
    """A bar under unit stress: von Mises stress is one everywhere."""
    made = scenes.bar("quadrilateral", 4)
    made["dimension"] = "plane_stress"
    made["contacts"][0]["obstacle"] = scenes.plane("quadrilateral", (3, 0, 0), (-1, 0, 0))
    assert "yield" not in warnings_of(made, subdomains)
    made["bodies"][0]["material"]["yield"] = 0.8
    told = warnings_of(made, subdomains)
    assert "block: von Mises stress reaches 1.25 times the yield stress" in told
    assert "in 100 % of its cells" in told
    made["bodies"][0]["material"]["yield"] = 1.01
    assert "yield" not in warnings_of(made, subdomains)


def test_a_body_that_moves_farther_than_it_is_large() -> None:
    """A block above a floor whose place is in another unit."""
    made = scenes.wall("quadrilateral", 3)
    made["conditions"] = [{"in": "block", "force": [0.0, -1.0]}]
    for place, told in ((-1000.0, True), (-0.5, False)):
        floor = scenes.plane("quadrilateral", (0, 0, place), (0, 0, 1))
        made["contacts"] = [{"on": "block.y-", "obstacle": floor}]
        found = warnings_of(made)
        assert ("block moves by 1e+03, farther than it is large (1.41)" in found) == told
        assert ("compare the units" in found) == told


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_contact_that_leaves_its_boundary(cell: str) -> None:
    """A block pulled against a wide ball that is watched on a part of the face, or on all of it."""
    made = scenes.wall(cell, 6)
    ball = {"sphere": {"center": scenes.vector(cell, 0.5, 0.5, 4.0), "radius": 3.0}}
    made["conditions"][1]["traction"] = scenes.vector(cell, 0, 0, 40)
    made["bodies"][0]["boundaries"] = {
        "part": {"where": f"{scenes.up(cell)[0]} > 0.999 and x > 0.3 and x < 0.7"}
    }
    for boundary, told in (("part", True), (scenes.up(cell), False)):
        made["contacts"] = [{"on": f"block.{boundary}", "obstacle": ball}]
        found = warnings_of(made)
        assert ("the contact is wider than this boundary" in found) == told
        assert ("outside part penetrate the obstacle" in found) == told


def test_a_crack_with_nodes_on_both_sides_that_is_merged(tmp_path: Path) -> None:
    """A plate pulled across a crack that ends in its middle: as one piece it is stiffer."""
    energies = []
    for opening, reported in ((0.0, True), (1e-6, False)):
        given = meshfiles.block("quadrilateral", 8)
        points, cells = given.points, given.cells[0].data
        lips = np.flatnonzero((np.abs(points[:, 1] - 0.5) < 0.05) & (points[:, 0] < 0.45))
        upper = np.arange(len(points))
        upper[lips] = len(points) + np.arange(len(lips))
        above = points[cells][..., 1].mean(axis=1) > 0.5
        given.cells[0].data = np.where(above[:, None], upper[cells], cells)
        given.points = np.vstack([points, points[lips] + [0.0, opening, 0.0]])
        made = scenes.config("quadrilateral", [scenes.block("quadrilateral", 8)], [], [])
        made["bodies"][0]["mesh"] = {"file": str(meshfiles.write(given, tmp_path / "a.vtu", None))}
        made["bodies"][0]["boundaries"] = {
            name: {"where": f"y {sign} 1e-9"} for name, sign in (("low", "<"), ("top", "> 1 -"))
        }
        made["conditions"] = [
            {"on": "block.low", "displacement": [0, 0]},
            {"on": "block.top", "traction": [0, 1]},
        ]
        solved = solve_scene(scenes.build(made, 1))
        found = "\n".join(solved.summary["certificate"]["warnings"])
        assert ("4 nodes were merged where the mesh is connected without them" in found) == reported
        energies.append(solved.summary["solution"]["energy"])
    assert energies[1] < 1.05 * energies[0] < 0.0


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_groups_of_a_mesh_file_that_merged_nodes_join(cell: str, tmp_path: Path) -> None:
    """Two parts that were meshed alike, and a file in which each cell has nodes of its own."""
    whole = meshfiles.block(cell, 4)
    points, cells, numbers = whole.points, whole.cells[0].data, whole.cell_data["gmsh:physical"][0]
    parts = cells + len(points) * (numbers == 2)[:, None]
    own = np.arange(cells.size).reshape(cells.shape)
    made = scenes.config(cell, [scenes.block(cell, 4)], [scenes.clamp(cell, "block.left")], [])
    made["conditions"].append({"in": "block", "force": scenes.vector(cell, 1, 0, 0)})
    made["bodies"][0]["boundaries"] = {"left": {"where": "x < 1e-9"}}
    for at, of_cells, groups, reported in (
        (points, cells, {}, False),
        (np.vstack([points, points]), parts, {}, True),
        (np.vstack([points, points]), parts, {"group": ["soft", "hard"]}, False),
        (points[cells.ravel()], own, {}, False),
    ):
        whole.points, whole.cells = at, [meshio.CellBlock(whole.cells[0].type, of_cells)]
        whole.cell_data = {"gmsh:physical": [numbers], "gmsh:geometrical": [numbers]}
        file = {"file": str(meshfiles.write(whole, tmp_path / "a.msh"))}
        made["bodies"][0]["mesh"] = file | groups
        sentence = "the groups soft and hard have no common node in the file"
        assert (sentence in warnings_of(made)) == reported


@pytest.mark.parametrize(("lower", "upper"), [("quadrilateral", "triangle"), ("tetrahedron",) * 2])
def test_bodies_that_enter_each_other_without_a_contact(lower: str, upper: str) -> None:
    """A block held at its side above another one, pressed into it or lifted from it."""
    made = stack(lower, upper, (3, 3))
    side = [0.0] * scenes.dimension(lower)
    made["conditions"].append({"on": "upper.x-", "displacement": side})
    contacts = made["contacts"]
    for pressure, given, reported in ((1, [], True), (-1, [], False), (1, contacts, False)):
        made["conditions"][1]["pressure"], made["contacts"] = pressure, given
        found = "lower and upper enter each other by up to" in warnings_of(made)
        assert found == reported


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_bodies_that_enter_each_other_beyond_their_contact(cell: str) -> None:
    made = stack(cell, cell, (6, 6))
    made["bodies"][0]["boundaries"] = {
        name: {"where": f"{scenes.up(cell)[0]} > 1 - 1e-9 and x < {end} + 1e-9"}
        for name, end in (("half", 0.5), ("all", 1.0))
    }
    for boundary, reported in (("half", True), ("all", False)):
        made["contacts"][0]["against"] = f"lower.{boundary}"
        found = "where the boundaries of their contacts end" in warnings_of(made)
        assert found == reported


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_two_contacts_that_share_facets_on_both_bodies(cell: str) -> None:
    """They divide the pressure, in whatever order they name the bodies."""
    made = stack(cell, cell, (3, 3))
    ends = scenes.up(cell), scenes.down(cell)
    made["bodies"][1]["boundaries"] = {
        "foot": {"where": f"{ends[0][0]} < 1 + 1e-9 and x < 0.7"},
        "rest": {"where": f"{ends[0][0]} < 1 + 1e-9 and x > 0.6"},
    }
    for first, reported in ((ends[1], True), ("rest", False)):
        made["contacts"] = [
            {"on": f"upper.{first}", "against": f"lower.{ends[0]}"},
            {"on": f"lower.{ends[0]}", "against": "upper.foot"},
        ]
        found = warnings_of(made)
        assert ("contacts[1]: facets on both bodies belong to contacts[0]" in found) == reported


def test_a_rigid_body_that_no_contact_names() -> None:
    """A punch that is moved into a block passes through it."""
    made = scenes.wall("quadrilateral", 4)
    made["bodies"].append({"name": "punch", "rigid": scenes.ball("quadrilateral", (0.5, 0, 2), 1)})
    made["conditions"].append({"in": "punch", "displacement": [0, -0.5], "rotation": 0})
    sentence = "punch: no entry of `contacts` names this rigid body"
    assert sentence in warnings_of(made)
    made["conditions"][-1]["displacement"] = [0, -0.001]
    made["contacts"].append({"on": "block.y+", "against": "punch"})
    assert sentence not in warnings_of(made)


@pytest.mark.parametrize(("cell", "force"), [("quadrilateral", 0), ("tetrahedron", -50)])
def test_a_rigid_body_that_enters_where_no_contact_is(cell: str, force: float) -> None:
    """A plate on the higher one of two blocks, and a ball on a block; moved or pressed down."""
    made = scenes.wall(cell, 3)
    low = scenes.block(cell, 3, "low", (2, 0, 0), (3, 1, 0.999))
    plate = {"name": "plate", "rigid": scenes.plane(cell, (0.5, 0.5, 1), (0, 0, -1))}
    up, turns = scenes.up(cell), [0, 0, 0] if cell == "tetrahedron" else 0
    made["bodies"] += [low, plate]
    held = {"in": "plate", "displacement": scenes.vector(cell, 0, 0, -0.05), "rotation": turns}
    made["conditions"] += [scenes.clamp(cell, f"low.{scenes.down(cell)}"), held]
    if force:
        held["displacement"][-1] = None
        made["conditions"].append({"in": "plate", "total_force": scenes.vector(cell, 0, 0, force)})
    joined = [{"on": f"{name}.{up}", "against": "plate"} for name in ("block", "low")]
    for contacts, reported in ((joined[:1], True), (joined, False)):
        made["contacts"] = contacts
        assert ("plate and low enter each other by up to" in warnings_of(made)) == reported
    if force:
        return
    plate["rigid"] = scenes.ball(cell, (0.5, 0.5, 2), 1)
    held["displacement"][-1] = -0.3
    for on, reported in (("x+", True), (up, False)):
        made["contacts"][0]["on"] = f"block.{on}"
        assert ("nodes of block outside x+ penetrate" in warnings_of(made)) == reported


def test_a_named_condition_that_no_step_and_no_case_has() -> None:
    made = scenes.wall("quadrilateral", 3)
    for condition, name in zip(made["conditions"], ("foot", "push"), strict=False):
        condition["name"] = name
    made["conditions"].append({"name": "weight", "in": "block", "force": [0.0, -1.0]})
    sentence = "conditions[2]: no {} names 'weight'"
    for key, loadings in (("steps", [{"push": 1}]), ("cases", {"pushed": {"push": 1}})):
        scene = scenes.build({**made, key: loadings})
        assert [s.split(",")[0] for s in scene.idle] == [sentence.format(key[:-1])]
        assert scene.under(scene.loadings[0]).idle == scene.idle
    assert scenes.build(made).idle == ()
    (record,) = contact_app.solve({**made, "steps": [{"push": 1}]}).summary["steps"]
    assert sentence.format("step") in "\n".join(record["certificate"]["warnings"])


def test_a_boundary_that_faces_away_from_its_obstacle() -> None:
    """A plane whose normal points into it touches nothing."""
    made = scenes.wall("quadrilateral", 4)
    assert "faces away" not in warnings_of(made)
    plane = made["contacts"][0]["obstacle"]["plane"]
    plane["normal"] = [-x for x in plane["normal"]]
    assert "contacts[0]: the boundary faces away from the obstacle" in warnings_of(made)
    assert "and nothing touches" in warnings_of(made)


def test_an_obstacle_that_is_turned_round_and_pulls() -> None:
    """The half space holds the whole block, which hangs on it by a certified force."""
    made = scenes.floating_in_corner("hexahedron", 2)
    made["conditions"] = [{"on": "block.z+", "traction": [0, 0, 5.0]}]
    made["contacts"] = [
        {"on": "block.z-", "obstacle": scenes.plane("hexahedron", (0, 0, 0), (0, 0, -1))}
    ]
    assert "faces away from the obstacle" in warnings_of(made)
    assert "and the obstacle pulls the body" in warnings_of(made)
    made["conditions"][0]["traction"] = [0, 0, -5.0]
    with pytest.raises(NoEquilibriumError, match=r"(?s)along -z .*\[0\]: the boundary faces away"):
        warnings_of(made)


def test_one_shape_of_a_rigid_clamp_that_is_behind_the_boundary() -> None:
    made = scenes.floating_in_corner("hexahedron", 2)
    jaws = [
        scenes.plane("hexahedron", (0, 0, height), (0, 0, sign))
        for height, sign in ((0.0, 1.0), (1.5, -1.0))
    ]
    made["bodies"].append({"name": "clamp", "rigid": jaws})
    made["conditions"] = [
        {"on": "block.z+", "traction": [0, 0, -5.0]},
        {"in": "clamp", "displacement": [0, 0, 0], "rotation": [0, 0, 0]},
    ]
    made["contacts"] = [{"on": "block.z-", "against": "clamp"}]
    assert "faces away" not in warnings_of(made)


def test_a_plane_ends_where_an_expression_ends_it() -> None:
    assert "wider than this boundary" not in warnings_of(scenes.heavy("quadrilateral", 4))


def hertz(cell: str, n: int, width: float) -> scenes.Config:
    """A block under a ball that overlaps it over about a width."""
    made = scenes.wall(cell, n)
    radius = 2.0
    depth = width**2 / (2 * radius)
    center = scenes.vector(cell, 0.5, 0.5, 1 + radius - depth)
    made["conditions"][1]["traction"] = scenes.vector(cell, 0, 0, -1e-3)
    ball = {"sphere": {"center": center, "radius": radius}}
    made["contacts"] = [{"on": f"block.{scenes.up(cell)}", "obstacle": ball}]
    return made


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron"])
def test_a_pressure_that_varies_within_facets(cell: str) -> None:
    """One or two facets carry it, or ten."""
    n = 20 if scenes.dimension(cell) == 2 else 10
    assert "varies within single facets" in warnings_of(hertz(cell, n, 0.5 / n))
    assert "varies within single facets" not in warnings_of(hertz(cell, n, 0.4))


def test_a_force_below_the_tolerance_causes_no_warning() -> None:
    """A ball enters the side of a pressed block by 1e-5 or 1e-2, at a single node."""
    for depth, told in ((1e-2, True), (1e-5, False)):
        made = scenes.wall("hexahedron", 4)
        made["bodies"][0]["material"]["poisson"] = 0.0
        made["contacts"][0]["obstacle"] = scenes.ball("hexahedron", (2.0, 0.5, 0.5), 1.0)
        made["contacts"][0]["interference"] = depth
        made["solver"]["tolerance"] = 1e-4
        found = solve_scene(scenes.build(made, None)).summary
        assert found["contacts"][0]["force"][0] < 0.0
        assert told == any("single facets" in w for w in found["certificate"]["warnings"])


def test_a_constant_pressure_on_a_narrow_face_causes_no_warning() -> None:
    """The face of a column is two facets wide, and no pressure varies within them."""
    config = Path(__file__).parents[3] / "configs" / "confined_column.yaml"
    found = solve_scene(build_scene(load(config))).summary
    assert "facets" not in " ".join(found["certificate"]["warnings"])


@pytest.mark.parametrize(
    ("gap", "moved", "warned"),
    [(1e-5, 0.05, False), (1e-3, 0.05, True), (1e-2, 0.05, False), (1e-5, 2e-3, True)],
)
def test_smooth_surfaces_cause_a_warning_if_a_gap_larger_than_their_error_depends_on_them(
    gap: float, moved: float, warned: bool
) -> None:
    """Flat facets 0.016 beside the curve: a cone in its seat, two plays, and a small load."""
    text = flat_facets("plug and seat", Distances(0.016, 1.6e-4), moved, gap, is_round=True)
    assert bool(text) == warned


def test_few_facets_across_a_long_contact_cause_a_warning() -> None:
    """Hertz's ellipse of a ball in a groove, eight times as long as wide."""
    config = Path(__file__).parents[3] / "configs" / "ball_in_grooves.yaml"
    found = solve_scene(build_scene(load(config))).summary
    told = [w for w in found["certificate"]["warnings"] if "narrow side of the contact" in w]
    assert [w.split(":")[0] for w in told] == ["contacts[0]", "contacts[1]"]
    assert "about 2.6 facets lie across" in told[0]
    assert "the smoothed field may be wrong by half or more" in told[0]
    for contact in found["contacts"]:
        assert contact["max_smoothed_pressure"] == pytest.approx(2249.0, rel=0.04)
    assert found["solution"]["max_contact_pressure"] > 1.5 * 2249.0  # Hertz


def test_round_bodies_that_meet_by_flat_facets_cause_a_warning() -> None:
    """A shaft in a hub: facets at degree 1, arcs at degree 2."""
    config, told = Path(__file__).parents[3] / "configs" / "interference_fit.yaml", {}
    for degree in (1, 2):
        changes = [f"bodies.{b}.degree={degree}" for b in (0, 1)]
        found = solve_scene(build_scene(load(config, changes))).summary
        told[degree] = " ".join(found["certificate"]["warnings"])
    assert "meet by flat facets" in told[1]
    assert "meet by flat facets" not in told[2]


@pytest.mark.parametrize(
    ("counts", "overlap", "is_round", "error"),
    [
        ((8, 8), 0.001, False, 0.02), ((8, 12), 0.001, False, None),
        ((8, 12), 0.03, True, 0.03), ((8, 12), 0.001, True, None),
    ],
)  # fmt: skip
def test_flat_facets_cause_a_warning_if_the_pressure_depends_on_them(
    counts: tuple[int, int], overlap: float, is_round: bool, error: float | None, tmp_path: Path
) -> None:
    """Overlapping rings with facets up to 0.05 off the circle; Lamé's pressure or a warning.

    The gap between facets that match is constant, and smooth surfaces are as good as the overlap is
    large.
    """
    made = rings.fit(tmp_path, "plane_stress", rings.MIDDLE + overlap, counts, straight=True)
    made["contacts"][0]["round"] = is_round
    summary = solve_scene(scenes.build(made, None)).summary
    warnings = " ".join(summary["certificate"]["warnings"])
    assert ("meet by flat facets" in warnings) == (error is None)
    exact = rings.fit_pressure("plane_stress", overlap)
    contact = summary["contacts"][0]
    if error is None:
        assert abs(contact["max_pressure"] / exact - 1.0) > 0.1
    else:
        assert contact["max_smoothed_pressure"] == pytest.approx(exact, error)


def test_a_second_order_file_at_the_default_degree_causes_a_warning(tmp_path: Path) -> None:
    """It causes none where the scene names the degree."""
    config = Path(__file__).parents[3] / "configs" / "thick_ring.yaml"
    text = config.read_text().replace("../", f"{config.parents[1]}/")
    for degree, told in (("", True), ("degree: 1", False), ("degree: 2", False)):
        file = tmp_path / "ring.yaml"
        file.write_text(text.replace("degree: 2\n", f"{degree}\n"))
        found = solve_scene(build_scene(load(file))).summary["certificate"]["warnings"]
        assert any("ring: its mesh file is of second order" in line for line in found) == told


def test_the_residual_of_multigrid_is_no_rounding_error() -> None:
    """A loose answer of a body that is moved by 10 and squeezed by 0.1 has all of its digits."""
    cell = "tetrahedron"
    moved = {"on": "block.z+", "displacement": [0, 0, -10]}
    floor = {"on": "block.z-", "obstacle": scenes.plane(cell, (0, 0, -9.9), (0, 0, 1))}
    made = scenes.config(cell, [scenes.block(cell, 4)], [moved], [floor])
    made["solver"] = {"method": "primal", "tolerance": 0.01}
    summary = contact_app.solve(made).summary
    assert summary["solver"]["method"] == "primal"
    assert summary["accuracy"]["algebraic"] > 1e-3
    assert summary["accuracy"]["round_off"] < 1e-9
    assert not [w for w in summary["certificate"]["warnings"] if "rounding" in w]
