"""Pictures of results: by matplotlib."""

import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from typer.testing import CliRunner

import contact_app
from contact_app.cli import app
from contact_app.results.plot import node_values, picture, space_picture
from contact_app.results.plot.arrangement import columns, of_patches
from contact_app.results.plot.contact_picture import (
    NothingPressedError,
    draw_contact,
    flat_patches,
    flattened,
    pressure_lines,
    profiles,
)
from contact_app.results.plot.stored import Stored, StoredError, read
from contact_app.results.report import write_summary
from contact_app.results.xdmf import cell_type_name
from meshes.quadratic import EDGES, node_vertices
from tests import scenes
from tests.stored_results import write_result


def test_a_directory_without_result_is_named(tmp_path: Path) -> None:
    with pytest.raises(StoredError, match="solution.xdmf is not there"):
        picture.plot(tmp_path)


@pytest.mark.parametrize(
    ("largest", "factor"),
    [(0.08, 1.0), (0.079, 1.0), (0.041, 1.0), (0.039, 2.0), (0.001, 50.0), (8.0, 0.01), (0.0, 1.0)],
)
def test_the_exaggeration_is_round_and_not_wild(largest: float, factor: float) -> None:
    # Moved as a whole, so that no cell is bent.
    points = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [0.0, 0.6, 0.0]])
    moves = np.broadcast_to([0.0, -largest, 0.0], points.shape)
    assert picture.round_exaggeration(triangle(points, moves)) == pytest.approx(factor)


def test_the_exaggeration_turns_no_cell_over() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 100.0, 0.0]])
    moves = np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert picture.round_exaggeration(triangle(points, moves)) == pytest.approx(5.0)


def triangle(points: np.ndarray, moves: np.ndarray) -> Stored:
    cells = {"triangle": np.array([[0, 1, 2]])}
    return Stored(points, cells, {"triangle": np.array([0])}, {"displacement": moves}, {})


def square(directory: Path, fields: bool = True, upper: tuple[float, float] = (1.0, 1.0)) -> None:
    """A rectangle of two triangles, pressed at its foot."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float) * upper
    at_nodes, in_cells = {"displacement": -0.01 * points}, {}
    if fields:
        at_nodes["contact_pressure"] = np.array([5.0, 3.0, 0.0, 0.0])
        in_cells = {"von_mises": [1.0, 2.0]}
    write_result(directory, "triangle", points, [[0, 1, 2], [0, 2, 3]], at_nodes, in_cells)
    write_summary(directory / "summary.json", {"scene": {"title": "a square"}})


def block(directory: Path) -> None:
    """Two hexahedra in a row along x, pressed at the far end."""
    axes = np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0, 2.0], indexing="ij")
    points = np.stack([axes[2], axes[1], axes[0]], axis=-1).reshape(-1, 3)
    low = np.array([0, 1, 4, 3, 6, 7, 10, 9])
    pressed = points[:, 0] > 1.5
    at_nodes = {"displacement": -0.01 * points, "contact_pressure": np.where(pressed, 3.0, 0.0),
                "gap": np.where(pressed, 0.0, np.nan)}  # fmt: skip
    in_cells = {"von_mises": [1.0, 2.0]}
    write_result(directory, "hexahedron", points, [low, low + 1], at_nodes, in_cells)
    write_summary(directory / "summary.json", {"scene": {"title": "a block"}})


def test_bodies_in_space_have_a_panel_for_each_field(tmp_path: Path) -> None:
    block(tmp_path)
    made, remarks = picture.plot(tmp_path)
    assert all("without VTK" in remark for remark in remarks)
    assert shows_two_halves(made[0])


def test_labels_below_a_tall_body_are_whole(tmp_path: Path) -> None:
    square(tmp_path, upper=(1.0, 6.0))
    (made, *_), _ = picture.plot(tmp_path)
    assert (matplotlib.image.imread(made)[-3:, :, :3] == 1.0).all()


def shows_two_halves(made: Path) -> bool:
    """Whether both panels of a picture hold more than a scale of colours and text."""
    image = matplotlib.image.imread(made)[:, :, :3]
    bodies = image[int(0.1 * len(image)) : int(0.75 * len(image))]
    halves = np.array_split(bodies, 2, axis=1)
    return all((half < 0.95).any(axis=2).mean() > 0.2 for half in halves)


def test_the_outline_of_a_block_is_its_edges(tmp_path: Path) -> None:
    """Edges of cells within flat faces are none of it: 12 edges, four of them in two pieces."""
    block(tmp_path)
    stored = read(tmp_path)
    outline = space_picture.sharp_edges(stored.points, stored.boundary())
    assert len(outline) == 16
    lengths = np.linalg.norm(np.diff(stored.points[outline], axis=1), axis=2)
    assert lengths.sum() == pytest.approx(4 * (2 + 1 + 1))


def test_shading_is_smooth_around_a_hole_and_sharp_at_its_rim() -> None:
    """Twelve facets of a tube of radius 1, and the triangles of its lid."""
    angles = np.radians(30.0) * np.arange(12)
    ring = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    points = np.concatenate([ring, ring + [0.0, 0.0, 1.0], [[0.0, 0.0, 1.0]]])
    low, high = np.arange(12), np.roll(np.arange(12), -1)
    tube = np.stack([low, high, high + 12, low + 12], axis=1)
    lid = np.stack([low + 12, high + 12, np.full(12, 24)], axis=1)
    on_tube, on_lid = space_picture.corner_normals(points, [tube, lid])
    np.testing.assert_allclose(on_tube, (points * [1.0, 1.0, 0.0])[tube], atol=1e-12)
    np.testing.assert_allclose(on_lid, np.broadcast_to([0.0, 0.0, 1.0], on_lid.shape), atol=1e-12)


@pytest.mark.parametrize("direction", [[1.2, -1.0, 0.6], [0.0, 0.0, -1.0], [-3.0, 0.1, 0.0]])
def test_a_view_shows_all_points(direction: list[float]) -> None:
    points = np.random.default_rng(3).normal(size=(50, 3))
    view = space_picture.view_from(np.array(direction), points)
    frame = np.stack([view.right, view.up, view.direction])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)  # not a mirror image
    across = np.abs((points - view.centre) @ frame[:2].T).max(axis=0)
    assert (across <= view.half).all()
    assert (across > 0.9 * view.half).all()


def test_pressure_lies_on_contact_boundaries_only(tmp_path: Path) -> None:
    block(tmp_path)
    stored = read(tmp_path)
    faces = stored.boundary()
    rows = np.concatenate([rows for _, rows in stored.skin()])
    panel = space_picture.panel_of(stored, "contact_pressure", faces, rows, True)
    assert panel.through
    np.testing.assert_array_equal(np.isfinite(panel.values), stored.points[:, 0] > 1.5)
    stress = space_picture.panel_of(stored, "von_mises", faces, rows, True)
    assert not stress.through
    middle = stored.points[np.concatenate(faces)].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(stress.values, np.where(middle > 1.0, 2.0, 1.0))


def test_a_uniform_field_is_not_coloured_by_its_round_off() -> None:
    limits = node_values.limits
    assert limits(np.array([1.0, 3.0, np.nan])) == (1.0, 3.0)
    assert limits(np.array([5.0, 5.0 + 1e-9])) == (0.0, 5.0 + 1e-9)
    assert limits(np.array([-5.0, -5.0])) == (-5.0, 1.0)
    assert limits(np.full(3, np.nan)) == (0.0, 1.0)


def plain(picture: Path) -> bool:
    """Whether an image is of next to no colours."""
    image = matplotlib.image.imread(picture)
    colours = np.rint(255 * image[:, :, :3]).astype(np.int64) @ [1, 256, 256**2]
    return len(np.unique(colours)) < 50


def test_a_field_of_the_boundary_alone_colours_its_sides(tmp_path: Path) -> None:
    """The gap has values at the foot of quadrilaterals, so that no triangle has three."""
    points = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0, 2], [1, 2]], dtype=float)
    gap = [0.0, 0.5, *[np.nan] * 4]
    cells = [[0, 1, 3, 2], [2, 3, 5, 4]]
    write_result(tmp_path, "quadrilateral", points, cells, {"gap": gap})
    (bodies, *_), _ = picture.plot(tmp_path, fields=("gap",))
    assert not plain(bodies)


def test_a_plane_result_has_two_pictures(tmp_path: Path) -> None:
    square(tmp_path)
    made, remarks = picture.plot(tmp_path, output=tmp_path / "to")
    assert made == [tmp_path / "to" / name for name in ("bodies.png", "contact_pressure.png")]
    assert not remarks
    assert not any(plain(path) for path in made)


def test_the_smoothed_pressure_is_drawn_on_request(tmp_path: Path) -> None:
    square(tmp_path)
    stored = read(tmp_path)
    stored.point_data["smoothed_contact_pressure"] = np.array([4.0, 4.0, 0.0, 0.0])
    one, other = (
        draw_contact(stored, tmp_path / f"{name}.png", name=name).read_bytes()
        for name in ("contact_pressure", "smoothed_contact_pressure")
    )
    assert one != other
    with pytest.raises(NothingPressedError, match="holds no smoothed_contact_pressure"):
        draw_contact(read(tmp_path), tmp_path / "none.png", name="smoothed_contact_pressure")


def test_a_missing_field_is_reported(tmp_path: Path) -> None:
    square(tmp_path)
    made, remarks = picture.plot(tmp_path, fields=("von_mises", "stress"), exaggeration=1.0)
    assert len(made) == 2
    assert remarks == [
        "left out: stress: the result does not hold it, "
        "only contact_pressure, displacement, von_mises"
    ]
    with pytest.raises(picture.PictureError, match="holds none of stress; it holds contact_pres"):
        picture.plot(tmp_path, fields=("stress",))


def test_pressure_lines_go_along_the_boundary(tmp_path: Path) -> None:
    """From the left end, in arc length of the undeformed sides, numbers of nodes in any order."""
    points = np.array([[2, 0], [0, 0], [1, 1], [3, 1], [1, 0], [3, 0]], dtype=float)
    cells = [[1, 4, 2], [4, 0, 2], [0, 3, 2], [0, 5, 3]]
    at_nodes = {"contact_pressure": [3.0, 1.0, 0.0, 0.0, 2.0, 4.0],
                "gap": [0.0, 0.0, np.nan, np.nan, 0.0, 0.0]}  # fmt: skip
    write_result(tmp_path, "triangle", points, cells, at_nodes)
    stored = read(tmp_path)
    ((nodes, position),) = profiles(stored, stored.point_data["contact_pressure"])
    assert nodes.tolist() == [1, 4, 0, 5]
    np.testing.assert_allclose(position, [0.0, 1.0, 2.0, 3.0])


def test_a_closed_contact_is_opened_where_it_presses_least(tmp_path: Path) -> None:
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    pressure = {"contact_pressure": [5.0, 1.0, 6.0, 7.0]}
    write_result(tmp_path, "quadrilateral", points, [[0, 1, 2, 3]], pressure)
    stored = read(tmp_path)
    ((nodes, position),) = profiles(stored, stored.point_data["contact_pressure"])
    assert nodes[0] == 1
    np.testing.assert_allclose(position, [0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("cell", "points", "sides", "area"),
    [
        ("tetrahedron", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 4, 1.5 + np.sqrt(0.75)),
        ("hexahedron", [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0],
                        [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], 6, 6.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("degree", [1, 2])
def test_the_surface_of_a_cell(
    cell: str, points: list[list[int]], sides: int, area: float, degree: int, tmp_path: Path
) -> None:
    """Sides face outwards and cover the surface, of second-order cells in four pieces each."""
    corners = np.array(points, dtype=float)
    if degree == 2:
        corners = np.array([corners[list(on)].mean(axis=0) for on in node_vertices(cell)])
    kind = cell_type_name(cell, degree)
    write_result(tmp_path, kind, corners, [np.arange(len(corners))], {})
    (found,) = read(tmp_path).boundary()
    assert len(found) == sides * (1 if degree == 1 else 4)
    a, b, c = (corners[found[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a) * (0.5 if found.shape[1] == 3 else 1.0)
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area)
    outward = a - corners[: len(points)].mean(axis=0)
    assert (np.sum(normals * outward, axis=1) > 0).all()


def test_bodies_in_space_without_displacement_or_gap(tmp_path: Path) -> None:
    points = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    pressure = {"contact_pressure": [1.0, 2.0, 3.0, 4.0, 0, 0, 0, 0]}
    write_result(tmp_path, "hexahedron", points, [np.arange(8)], pressure)
    made, remarks = picture.plot(tmp_path, fields=("contact_pressure",))
    assert [path.name for path in made] == ["bodies.png", "contact_pressure.png"]
    assert all("without VTK" in remark for remark in remarks)
    assert not any(plain(path) for path in made)


@pytest.mark.parametrize("all_round", [False, True])
def test_a_bore_is_unrolled(all_round: bool) -> None:
    """Lengths around the axis stay, its opposite is where it is cut, and nothing overlaps."""
    n, radius, axis = 60, 2.0, np.array([0.6, 0.0, 0.8])
    angles = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    e, f = np.array([0.8, 0.0, -0.6]), np.array([0.0, 1.0, 0.0])
    ring = radius * (np.cos(angles)[:, None] * e + np.sin(angles)[:, None] * f) + [1.0, 5.0, 2.0]
    points = np.concatenate([ring, ring + 3.0 * axis])
    here, there = np.arange(n), np.roll(np.arange(n), -1)
    triangles = np.concatenate(
        [np.stack([here, here + n, there], 1), np.stack([there, here + n, there + n], 1)]
    )
    outside = np.cross(*(points[triangles[0, i]] - points[triangles[0, 0]] for i in (1, 2)))
    assert outside @ (ring[0] - ring.mean(axis=0)) < 0.0  # out of the body: to the axis
    pressed = np.tile(all_round | (np.abs(angles - np.pi) < 0.9), 2)
    across, shown, names = flattened(points, triangles, pressed)
    assert names == ("around the axis", "along the axis")
    assert shown.sum() == 2 * (n - 1)
    corners = across[triangles[shown]]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert (np.sign(area) == np.sign(area[0])).all()
    np.testing.assert_allclose(np.abs(area), 0.5 * 3.0 * 2.0 * np.pi * radius / n, rtol=1e-3)
    if not all_round:
        assert abs(across[n // 2, 0]) < 0.2  # where it is pressed most


def test_hidden_facets_are_not_drawn_over_a_pressed_face(tmp_path: Path) -> None:
    """All faces of a block may touch; the picture shows those that look as the pressed one."""
    block(tmp_path)
    stored = read(tmp_path)
    (sides,) = stored.boundary()
    triangles = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    pressed = (stored.points[triangles][:, :, 0] > 1.5).all(axis=1)
    _, shown, names = flattened(stored.points, triangles, pressed)
    assert names == ("y", "z")
    np.testing.assert_array_equal(shown, pressed)


def test_pressure_on_an_edge_alone_is_drawn(tmp_path: Path) -> None:
    """No face may touch as a whole, as where a boundary is a line of nodes."""
    block(tmp_path)
    stored = read(tmp_path)
    edge = (stored.points[:, 0] > 1.5) & (stored.points[:, 2] < 0.5)
    stored.point_data["gap"][:] = np.where(edge, 0.0, np.nan)
    stored.point_data["contact_pressure"][:] = np.where(edge, 3.0, 0.0)
    assert not plain(draw_contact(stored, tmp_path / "edge.png"))


@pytest.mark.parametrize(
    ("count", "ratio", "wanted", "expected"),
    [(1, 1.0, 1.6, 1), (2, 0.9, 3.0, 2), (2, 0.05, 3.0, 1), (2, 2.0, 3.0, 2), (8, 1.0, 1.6, 4)],
)
def test_panels_are_arranged_by_their_shape(
    count: int, ratio: float, wanted: float, expected: int
) -> None:
    """Slender bodies stand above each other, many patches in rows."""
    assert columns(count, ratio, wanted) == expected


def test_patches_fill_their_picture(tmp_path: Path) -> None:
    """A patch is drawn from the left to the right."""
    block(tmp_path)
    image = matplotlib.image.imread(draw_contact(read(tmp_path), tmp_path / "patch.png"))
    inked = np.flatnonzero((image[:, :, :3] < 0.99).any(axis=(0, 2)))
    assert inked[0] < 0.1 * image.shape[1]
    assert inked[-1] > 0.9 * image.shape[1]
    assert of_patches([np.array([1.0, 4.0])])[1][0] < 5.0


def test_several_patches_have_titles_with_their_places(tmp_path: Path) -> None:
    block(tmp_path)
    stored = read(tmp_path)
    low, high = stored.points.min(axis=0), stored.points.max(axis=0)
    for places in ([low[0]], [low[0], high[0]]):
        ends = np.isin(stored.points[:, 0], places)
        stored.point_data["gap"][:] = np.where(ends, 0.0, np.nan)
        figure, flat = flat_patches(stored, np.where(ends, 3.0, 0.0))
        titles = sorted(axes.get_title() for axes, _ in flat)
        middle = 0.5 * (low + high)[1:]
        named = [f"middle at ({x:.3g}, {middle[0]:.3g}, {middle[1]:.3g})" for x in places]
        assert titles == (sorted(named) if len(places) > 1 else [""])
        assert len(figure.axes) == len(places)


def test_the_line_of_the_pressure_shows_the_part_in_contact(tmp_path: Path) -> None:
    points = np.stack([np.repeat(np.arange(41.0), 2), np.tile([0.0, 1.0], 41), np.zeros(82)], 1)
    first = 2 * np.arange(40)[:, None]
    cells = first + np.array([0, 2, 3, 1])
    pressure = np.where((points[:, 1] == 0.0) & (points[:, 0] < 3.5), 4.0 - points[:, 0], 0.0)
    gap = np.where(points[:, 1] == 0.0, 0.0, np.nan)
    data = {"contact_pressure": pressure, "gap": gap}
    stored = Stored(points, {"quadrilateral": cells}, {"quadrilateral": np.arange(40)}, data, {})
    (axes,) = pressure_lines(stored, pressure, "pressure").axes
    assert axes.get_xlim() == pytest.approx((-0.6, 4.6))


def test_bodies_that_nothing_presses_have_no_panel_of_the_pressure(tmp_path: Path) -> None:
    drawn = []
    for pressure in (5.0, 0.0):
        square(tmp_path)
        stored = read(tmp_path)
        stored.point_data["contact_pressure"][:] = pressure
        drawn.append([picture.acts(stored, name) for name in ("von_mises", "contact_pressure")])
    assert drawn == [[True, True], [True, False]]


def test_a_result_without_contact_has_no_pressure_to_draw(tmp_path: Path) -> None:
    square(tmp_path, fields=False)
    made, remarks = picture.plot(tmp_path, fields=("displacement",))
    assert [path.name for path in made] == ["bodies.png"]
    assert "holds no contact_pressure" in remarks[0]


def test_the_command_writes_into_the_directory_of_the_result(tmp_path: Path) -> None:
    square(tmp_path)
    ran = CliRunner().invoke(app, ["plot", str(tmp_path), "--field", "von_mises", "--scale", "2"])
    assert ran.exit_code == 0, ran.output
    assert (tmp_path / "bodies.png").is_file()
    assert (tmp_path / "contact_pressure.png").is_file()


@pytest.mark.slow
def test_the_view_in_paraview(tmp_path: Path) -> None:
    if not shutil.which("pvbatch") or not shutil.which("xvfb-run"):
        pytest.skip("pvbatch and xvfb-run are not installed")
    square(tmp_path)
    script = Path(__file__).parents[3] / "docs" / "guide" / "contact_view.py"
    ran = subprocess.run(
        ["xvfb-run", "-a", "pvbatch", script, tmp_path / "solution.xdmf", tmp_path / "view.png"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert not plain(tmp_path / "view.png")


def test_pictures_show_stresses_at_nodes_on_the_side_of_each_material(tmp_path: Path) -> None:
    """Two hexahedra of two materials: the shared nodes have two stresses."""
    block(tmp_path)
    stored = read(tmp_path)
    x = stored.points[:, 0]
    assert node_values.smooth_name(stored, "von_mises") == "von_mises"
    stored.point_data["nodal_von_mises"] = np.where(x < 0.5, 1.0, 2.0)
    assert node_values.smooth_name(stored, "von_mises") == "nodal_von_mises"
    assert node_values.copies(stored) == 1
    stored.cell_data["material"] = np.array([0.0, 1.0])
    stored.point_data["nodal_von_mises_material_0"] = np.where(x < 1.5, 1.0, np.nan)
    stored.point_data["nodal_von_mises_material_1"] = np.where(x > 0.5, 2.0, np.nan)
    assert node_values.copies(stored) == 2
    ((sides, rows),) = stored.skin()
    values = node_values.node_values(stored, "nodal_von_mises")
    shown = values[sides + node_values.shifts(stored, rows)[:, None]]
    np.testing.assert_array_equal(shown, np.broadcast_to(rows[:, None] + 1.0, shown.shape))
    panel = space_picture.panel_of(
        stored, "von_mises", [sides + node_values.shifts(stored, rows)[:, None]], rows, True
    )
    assert panel.limits == (1.0, 2.0)
    assert panel.colours == "viridis"
    assert not panel.through


@pytest.mark.parametrize(("direction", "hidden"), [([1.0, 0.1, 0.1], False), ([-1, 0.1, 0], True)])
def test_contact_behind_the_body_shows_through_it(
    direction: list[float], hidden: bool, tmp_path: Path
) -> None:
    """The block is pressed at its far end alone."""
    block(tmp_path)
    stored = read(tmp_path)
    view = space_picture.view_from(np.array(direction), stored.points)
    assert space_picture.mostly_hidden(stored, stored.boundary(), stored.points, view) == hidden


@pytest.mark.parametrize("camera", [(1.0, 0.2, 0.1), (-1.0, 0.2, 0.1)])
def test_the_pressed_face_has_its_colour_from_both_sides(
    camera: tuple[float, float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    block(tmp_path)
    made, _ = picture.plot(tmp_path, fields=("contact_pressure",), camera=camera)
    image = matplotlib.image.imread(made[0])[:, :, :3]
    bodies = image[int(0.1 * len(image)) : int(0.75 * len(image))]
    assert (bodies.max(axis=2) < 0.25).mean() > 0.03  # the scale ends in black


def test_edges_of_cells_of_second_order_alone_are_drawn() -> None:
    """A side of six nodes is drawn in four pieces; edges between the middle nodes are left out."""
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]], float)
    ends = np.array(EDGES["tetrahedron"])
    points = np.concatenate([points, points[ends].mean(axis=1)])
    kind = "tetrahedron10"
    stored = Stored(points, {kind: np.arange(10)[None]}, {kind: np.arange(1)}, {}, {})
    assert np.flatnonzero(stored.vertices).tolist() == [0, 1, 2, 3]
    panel = space_picture.Panel(np.zeros(10), (0.0, 1.0), False, "viridis", "", False)
    frame = space_picture.Frame.of(
        space_picture.view_from(np.array([1.0, -1.0, 0.5]), points), (1.0, 1.0), 100
    )
    sides, vertices = stored.boundary(), stored.vertices
    drawn = space_picture.skin_triangles(points, sides, panel, frame, vertices).wired
    assert drawn.shape == (16, 3)
    assert drawn.sum() == 4 * 3 * 2


def test_pictures_of_an_earlier_increment(tmp_path: Path) -> None:
    """Half of a displacement, before anything touches."""
    made = scenes.wall("quadrilateral", 3)
    del made["contacts"], made["conditions"][1:]
    made["conditions"].append({"name": "up", "on": "block.y+", "displacement": [0, 0.1]})
    made["steps"] = [{"up": 1, "increments": 2}]
    contact_app.solve(made).write(tmp_path)
    largest = [
        float(np.abs(read(tmp_path, time).point_data["displacement"][:, 1]).max())
        for time in (0.5, 1.0, None)
    ]
    assert largest == pytest.approx([0.05, 0.1, 0.1])
    pictures, _ = picture.plot(tmp_path, output=tmp_path / "half", time=0.5, fields=("von_mises",))
    assert [path.name for path in pictures] == ["bodies.png"]
    with pytest.raises(StoredError, match=r"no increment at the time 0.7; it has 0.5, 1"):
        picture.plot(tmp_path, time=0.7)
