"""Images by VTK beside those of the depth buffer, and what follows if VTK does not draw."""

import os
from pathlib import Path

import numpy as np
import pytest

from contact_app.results.plot import picture, space_picture, vtk_images
from tests.contact_app.results.test_picture import block, shows_two_halves

DIES = "import os\nos.abort()\n"
HANGS = "import time\ntime.sleep(60.0)\n"
LACKS = "raise ImportError('libGL.so.1: cannot open shared object file')\n"


@pytest.mark.parametrize("veil", [1.0, 0.12])
def test_both_renderers_show_the_same(veil: float) -> None:
    """A cube with one coloured face, its outline beside it."""
    drawing, own = images_of_a_cube(veil)
    drawn, reason = vtk_images.images([drawing])
    if drawn is None:
        assert "ended with 1 " not in reason or "ImportError" in reason, reason
        pytest.skip(f"VTK does not draw here: {reason or 'it is not installed'}")
    assert drawn[0].shape == own.shape
    background = (drawn[0] == 1.0).all(axis=2), (own == 1.0).all(axis=2)
    assert (background[0] != background[1]).mean() < 0.04
    assert np.abs(drawn[0] - own).mean() < 0.01
    # A picture upside down or seen from behind is far from the other.
    assert np.abs(drawn[0][::-1] - own).mean() > 0.03


def images_of_a_cube(veil: float) -> tuple[dict, np.ndarray]:
    x = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), -1).reshape(-1, 3)
    faces = [
        np.array(
            [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        )
    ]
    values = np.where(x[:, 0] > 0.5, x[:, 1], np.nan)
    panel = space_picture.Panel(values, (0.0, 1.0), False, "magma_r", "", veil < 1.0)
    frame = space_picture.Frame.of(
        space_picture.view_from(np.array([1.0, -0.7, 0.5]), np.concatenate([x, 1.3 * x])),
        (2.0, 2.0), 400,
    )  # fmt: skip
    skin = space_picture.skin_triangles(x, faces, panel, frame, np.ones(8, bool))
    outline = frame.places(1.3 * x[space_picture.sharp_edges(x, faces)])
    drawing = space_picture.drawing_of(
        skin, panel, space_picture.triangle_nodes(faces), outline, frame
    )
    assert drawing["veil"] == veil
    return drawing, space_picture.image_of(skin, panel, outline, frame)


@pytest.mark.parametrize(
    ("module", "reason"), [(DIES, "ended with -6"), (LACKS, "libGL.so.1: cannot open")]
)
def test_a_vtk_that_does_not_draw_costs_one_line(
    module: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module in VTK's name aborts, as Debian's without a display, or cannot be loaded."""
    stands_in_for_vtk(module, tmp_path, monkeypatch)
    block(tmp_path)
    made, remarks = picture.plot(tmp_path)
    assert len(remarks) == 1
    assert remarks[0].startswith("bodies are drawn without VTK")
    assert reason in remarks[0]
    assert [path.name for path in made] == ["bodies.png", "contact_pressure.png"]
    assert shows_two_halves(made[0])


def test_a_vtk_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stands_in_for_vtk(HANGS, tmp_path, monkeypatch)
    drawing, _ = images_of_a_cube(1.0)
    assert vtk_images.images([drawing], seconds=1.0) == (None, "it took more than 1 s")


def stands_in_for_vtk(module: str, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = path / "vtkmodules"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "vtkRenderingOpenGL2.py").write_text(module)
    monkeypatch.syspath_prepend(path)
    monkeypatch.setenv("PYTHONPATH", str(path), prepend=os.pathsep)


def test_without_vtk_no_process_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("subprocess.run", None)
    assert vtk_images.images([{}]) == (None, "")
