"""Pictures of what sticks and slips: areas of the three colours, counted in pixels."""

import ast
import json
import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from typer.testing import CliRunner

from contact_app.cli import app
from contact_app.results.plot import friction_picture, picture
from contact_app.results.plot.stored import read
from solver.vectors import Ints
from tests.stored_results import write_result

SCENE = """
title: a block pressed and pushed
dimension: plane_strain
bodies:
  - name: block
    mesh: {box: {lower: [0, 0], upper: [4, 2], cells: [16, 4], cell: quadrilateral}}
    material: {young: 10, poisson: 0.45}
conditions:
  - {name: press, on: block.y+, displacement: [null, -0.02]}
  - {name: push, on: block.y+, displacement: [0.02, null]}
contacts:
  - {on: block.y-, obstacle: {plane: {point: [0, 0], normal: [0, 1]}}, friction: {coulomb: 0.5}}
steps: [{press: 1}, {push: 1}]
"""


def counted(made: Path) -> Ints:
    """Pixels of each colour by rows of the picture (rows, 3), without its legend."""
    image = np.rint(255 * matplotlib.image.imread(made)[:, :, :3]).astype(int)
    image = image[: int(0.9 * len(image))]
    wanted = [np.rint(255 * np.array(to_rgb(c))) for c in friction_picture.COLOURS.values()]
    return np.stack([(image == colour).all(axis=2).sum(axis=1) for colour in wanted], axis=1)


def test_the_strip_shows_the_last_increment(tmp_path: Path) -> None:
    """Each node colours half a cell to either side of it."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, ["run", str(tmp_path / "scene.yaml"), "--output", str(out)])
    assert ran.exit_code == 0, ran.output
    stored = read(out)
    made = friction_picture.draw_friction(stored, out / "zones.png")
    foot = np.flatnonzero(stored.points[:, 1] == 0.0)
    status = stored.point_data["contact_status"][foot].astype(int)
    nodes = json.loads((out / "summary.json").read_text())["contacts"][0]["nodes"]
    assert np.bincount(status, minlength=3).tolist() == [nodes[k] for k in friction_picture.COLOURS]
    assert min(nodes["stick"], nodes["slip"]) > 0
    ends = np.isin(stored.points[foot, 0], [0.0, 4.0])
    widths = np.bincount(status, np.where(ends, 0.5, 1.0), minlength=3)
    rows = counted(made)
    strip = rows[rows.sum(axis=1).argmax()]
    np.testing.assert_allclose(strip / strip.sum(), widths / widths.sum(), atol=0.005)


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A cube on a floor: two nodes of its foot are open, one sticks, one slips."""
    points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    at_nodes = {"displacement": 0.0 * points, "gap": np.where(points[:, 2] == 0.0, 0.0, np.nan),
                "contact_status": [0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]}  # fmt: skip
    write_result(tmp_path, "hexahedron", points, [[0, 1, 3, 2, 4, 5, 7, 6]], at_nodes)
    return tmp_path


def test_nodes_colour_their_parts_of_a_face(block: Path) -> None:
    """A face is two triangles: nodes at its diagonal have a third of it, the others a sixth."""
    made = friction_picture.draw_friction(read(block), block / "zones.png")
    areas = counted(made).sum(axis=0)
    found = areas / areas.sum()
    either = ([2 / 3, 1 / 6, 1 / 6], [1 / 3, 1 / 3, 1 / 3])
    assert any(np.allclose(found, expected, atol=0.01) for expected in either), found


def square(directory: Path) -> None:
    """A square of the plane with the status of its nodes and nothing else of contact."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    at_nodes = {"displacement": 0.0 * points, "contact_status": [1.0, 2.0, 0.0, 0.0]}
    write_result(directory, "quadrilateral", points, [[0, 1, 2, 3]], at_nodes)


def test_the_status_alone_is_drawn(tmp_path: Path) -> None:
    square(tmp_path)
    made, remarks = picture.plot(tmp_path, fields=("displacement",))
    rows = counted(made[1])
    open_, stick, slip = rows[rows[:, 1].argmax()]
    assert open_ == 0
    assert stick == pytest.approx(slip, abs=4)
    assert [path.name for path in made] == ["bodies.png", "contact_status.png"]
    assert "holds no contact_pressure" in remarks[0]


def test_an_open_contact_is_reported(block: Path) -> None:
    stored = read(block)
    stored.point_data["contact_status"][:] = 0.0
    with pytest.raises(friction_picture.NothingPressedError, match="no node sticks or slips"):
        friction_picture.draw_friction(stored, block / "zones.png")


def test_a_pressed_node_without_a_law_of_its_own_has_its_neighbours(block: Path) -> None:
    stored = read(block)
    stored.point_data["contact_pressure"] = np.where(np.arange(8) == 3, 1.0, 0.0)
    shown = friction_picture.status_shown(stored)
    np.testing.assert_array_equal(shown, [0.0, 1.0, 2.0, 2.0, *[np.nan] * 4])


def test_arrows_are_turned_with_the_surface() -> None:
    """In a quarter of a bore, the direction around it becomes the first coordinate, that along it
    the second."""
    angle = np.linspace(0.0, 0.5 * np.pi, 200)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points = np.concatenate([rim, rim + [0.0, 0.0, 1.0]])
    around = np.tile(np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1), (2, 1))
    here = np.arange(199)
    triangles = np.stack([here, here + 1, here + 200], axis=1)
    across = np.stack([np.tile(angle, 2), points[:, 2]], axis=1)
    tractions = 3.0 * around + [0.0, 0.0, 2.0] + 5.0 * points * [1.0, 1.0, 0.0]
    found = friction_picture.laid_flat(points, across, triangles, tractions)
    np.testing.assert_allclose(found, np.tile([3.0, 2.0], (199, 1)), atol=0.02)


SCRIPT = Path(__file__).parents[3] / "docs" / "guide" / "contact_view.py"


def test_paraview_has_the_same_names_and_colours() -> None:
    (rows,) = (
        ast.literal_eval(line.value)
        for line in ast.parse(SCRIPT.read_text()).body
        if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "STATUSES"
    )
    assert [(int(value), name) for value, name, _ in rows] == [*enumerate(friction_picture.COLOURS)]
    expected = [to_rgb(colour) for colour in friction_picture.COLOURS.values()]
    np.testing.assert_allclose([shares for *_, shares in rows], expected, atol=1e-3)


@pytest.mark.slow
def test_the_status_in_paraview(tmp_path: Path) -> None:
    if not shutil.which("pvbatch") or not shutil.which("xvfb-run"):
        pytest.skip("pvbatch and xvfb-run are not installed")
    square(tmp_path)
    files = [tmp_path / "solution.xdmf", tmp_path / "view.png"]
    ran = subprocess.run(
        ["xvfb-run", "-a", "pvbatch", SCRIPT, *files, "contact_status"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    image = matplotlib.image.imread(files[1])[:, :, :3]
    assert (image[:, :, 2] > image[:, :, 0] + 0.3).any()  # blue: a node that sticks
    assert (image[:, :, 0] > image[:, :, 2] + 0.3).any()  # orange: one that slips
