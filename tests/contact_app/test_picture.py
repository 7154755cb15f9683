"""Pictures of results; the drawing itself needs pyvista, which most machines lack."""

import builtins
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from typer.testing import CliRunner

from contact_app import picture
from contact_app.cli import app
from contact_app.contact_picture import profiles
from contact_app.report import write_summary
from contact_app.stored import read
from contact_app.xdmf import XDMFWriter, cell_type_name
from meshes.quadratic import node_vertices


def test_without_pyvista_the_message_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: object, **options: object) -> object:
        if name == "pyvista":
            raise ImportError(name)
        return real(name, *rest, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(picture.PictureError, match="pip install -c .* pyvista"):
        picture.render(tmp_path)


def test_a_directory_without_result_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "_pyvista", lambda: None)
    with pytest.raises(picture.PictureError, match="solution.xdmf is not there"):
        picture.render(tmp_path)


@pytest.mark.parametrize(
    ("largest", "factor"),
    [(0.08, 1.0), (0.079, 1.0), (0.041, 1.0), (0.039, 2.0), (0.001, 50.0), (8.0, 0.01), (0.0, 1.0)],
)
def test_the_exaggeration_is_round_and_not_wild(largest: float, factor: float) -> None:
    displacement = np.array([[0.0, 0.0, 0.0], [0.0, -largest, 0.0]])
    grid = SimpleNamespace(point_data={"displacement": displacement}, length=1.0)
    assert picture.round_exaggeration(grid) == pytest.approx(factor)


def square(directory: Path, fields: bool = True) -> None:
    """A unit square of two triangles, pressed at its foot."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    with XDMFWriter(directory / "solution.xdmf", "triangle", 4, 2) as file:
        file.points(0, points)
        file.cells(0, [[0, 1, 2], [0, 2, 3]])
        file.point_data("displacement", 0, -0.01 * points)
        if fields:
            file.cell_data("von_mises", 0, [1.0, 2.0])
            file.point_data("contact_pressure", 0, [5.0, 3.0, 0.0, 0.0])
    write_summary(directory / "summary.json", {"scene": {"title": "a square"}})


def test_a_result_becomes_a_picture_with_a_panel_a_field(tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="pyvista (extra 'plot') is not installed")
    square(tmp_path)
    made = picture.render(tmp_path, panel=(300, 200))
    assert made == tmp_path / "picture.png"
    image = matplotlib.image.imread(made)
    assert image.shape[:2] == (200, 600)
    for half in (image[:, :300], image[:, 300:]):
        assert len(np.unique(half.reshape(-1, half.shape[2]), axis=0)) > 100, "nothing drawn"


def test_a_result_without_the_fields_is_said(tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="pyvista (extra 'plot') is not installed")
    square(tmp_path, fields=False)
    with pytest.raises(picture.PictureError, match="none of the fields von_mises"):
        picture.render(tmp_path)


def test_a_uniform_field_is_not_coloured_by_its_round_off() -> None:
    limits = picture._limits
    assert limits(np.array([1.0, 3.0, np.nan])) == (1.0, 3.0)
    assert limits(np.array([5.0, 5.0 + 1e-9])) == (0.0, 5.0 + 1e-9)
    assert limits(np.array([-5.0, -5.0])) == (-5.0, 1.0)
    assert limits(np.full(3, np.nan)) == (0.0, 1.0)
    assert limits(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])) == (1.0, 5.0)


def plain(picture: Path) -> bool:
    """Whether an image is of next to no colours."""
    image = matplotlib.image.imread(picture)
    return len(np.unique(image.reshape(-1, image.shape[2]), axis=0)) < 50


def test_plane_pictures_need_no_pyvista(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    square(tmp_path)
    made, left_out = picture.plot(tmp_path, output=tmp_path / "to")
    assert made == [tmp_path / "to" / name for name in ("bodies.png", "contact_pressure.png")]
    assert not left_out
    assert not any(plain(path) for path in made)


def test_a_field_the_result_lacks_is_told(tmp_path: Path) -> None:
    square(tmp_path)
    made, left_out = picture.plot(tmp_path, fields=("von_mises", "stress"), exaggeration=1.0)
    assert len(made) == 2
    assert left_out == [
        "stress: the result does not hold it, only contact_pressure, displacement, von_mises"
    ]
    with pytest.raises(picture.PictureError, match="holds none of stress; it holds contact_pres"):
        picture.plot(tmp_path, fields=("stress",))


def test_pressure_lines_go_along_the_boundary(tmp_path: Path) -> None:
    """From the left end, in arc length of the undeformed sides, numbers of nodes in any order."""
    points = np.array([[2, 0], [0, 0], [1, 1], [3, 1], [1, 0], [3, 0]], dtype=float)
    with XDMFWriter(tmp_path / "solution.xdmf", "triangle", 6, 4) as file:
        file.points(0, points)
        file.cells(0, [[1, 4, 2], [4, 0, 2], [0, 3, 2], [0, 5, 3]])
        file.point_data("contact_pressure", 0, [3.0, 1.0, 0.0, 0.0, 2.0, 4.0])
        file.point_data("gap", 0, [0.0, 0.0, np.nan, np.nan, 0.0, 0.0])
    ((nodes, position),) = profiles(read(tmp_path))
    assert nodes.tolist() == [1, 4, 0, 5]
    np.testing.assert_allclose(position, [0.0, 1.0, 2.0, 3.0])


def test_a_closed_contact_is_opened_where_it_presses_least(tmp_path: Path) -> None:
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    with XDMFWriter(tmp_path / "solution.xdmf", "quadrilateral", 4, 1) as file:
        file.points(0, points)
        file.cells(0, [[0, 1, 2, 3]])
        file.point_data("contact_pressure", 0, [5.0, 1.0, 6.0, 7.0])
    ((nodes, position),) = profiles(read(tmp_path))
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
    with XDMFWriter(
        tmp_path / "solution.xdmf", cell_type_name(cell, degree), len(corners), 1
    ) as file:
        file.points(0, corners)
        file.cells(0, [np.arange(len(corners))])
    (found,) = read(tmp_path).boundary()
    assert len(found) == sides * (1 if degree == 1 else 4)
    a, b, c = (corners[found[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a) * (0.5 if found.shape[1] == 3 else 1.0)
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area)
    outward = a - corners[: len(points)].mean(axis=0)
    assert (np.sum(normals * outward, axis=1) > 0).all()


def test_a_patch_in_space_is_drawn_and_bodies_left_out_without_pyvista(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    points = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    with XDMFWriter(tmp_path / "solution.xdmf", "hexahedron", 8, 1) as file:
        file.points(0, points)
        file.cells(0, [np.arange(8)])
        file.point_data("contact_pressure", 0, [1.0, 2.0, 3.0, 4.0, 0, 0, 0, 0])
    made, left_out = picture.plot(tmp_path, fields=("contact_pressure",))
    assert [path.name for path in made] == ["contact_pressure.png"]
    assert "pip install" in left_out[0]
    assert not plain(made[0])


def test_what_does_not_touch_has_no_pressure_to_draw(tmp_path: Path) -> None:
    square(tmp_path, fields=False)
    made, left_out = picture.plot(tmp_path, fields=("displacement",))
    assert [path.name for path in made] == ["bodies.png"]
    assert "holds no contact_pressure" in left_out[0]


def test_the_command_writes_beside_the_result(tmp_path: Path) -> None:
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
    script = Path(__file__).parents[2] / "docs" / "paraview" / "contact_view.py"
    ran = subprocess.run(
        ["xvfb-run", "-a", "pvbatch", script, tmp_path / "solution.xdmf", tmp_path / "view.png"],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert not plain(tmp_path / "view.png")
