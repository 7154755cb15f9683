"""Pictures of results; the drawing itself needs pyvista, which most machines lack."""

import builtins
from pathlib import Path
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest

from contact_app import picture
from contact_app.report import write_summary
from contact_app.xdmf import XDMFWriter


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
    pytest.importorskip("pyvista", reason="pyvista (extra 'picture') is not installed")
    square(tmp_path)
    made = picture.render(tmp_path, panel=(300, 200))
    assert made == tmp_path / "picture.png"
    image = matplotlib.image.imread(made)
    assert image.shape[:2] == (200, 600)
    for half in (image[:, :300], image[:, 300:]):
        assert len(np.unique(half.reshape(-1, half.shape[2]), axis=0)) > 100, "nothing drawn"


def test_a_result_without_the_fields_is_said(tmp_path: Path) -> None:
    pytest.importorskip("pyvista", reason="pyvista (extra 'picture') is not installed")
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
