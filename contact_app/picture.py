"""Pictures of a result: the deformed shape, coloured by fields, and the contact pressure.

Reads only what a run left (``solution.xdmf``, ``summary.json``) and draws off-screen: bodies in
space with pyvista, the extra ``plot`` of this package; bodies of the plane and the pressure over
the contact surface with matplotlib.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.contact_picture import NothingPressedError, draw_contact
from contact_app.errors import ContactError
from contact_app.plane_picture import draw_plane
from contact_app.stored import read

#: Largest displacement in the picture, as a share of the size of the bodies.
VISIBLE = 0.08
#: Cells beyond which edges would blacken the picture.
EDGES_UP_TO = 60_000

#: Relative spread below which a field counts as the same everywhere.
UNIFORM = 1e-4

#: What each field is called below its colours.
LABELS = {
    "displacement": "displacement, magnitude",
    "von_mises": "von Mises stress",
    "stress": "stress, Frobenius norm",
    "contact_pressure": "contact pressure",
    "gap": "gap to the obstacle",
}


class PictureError(ContactError):
    """No picture can be made: pyvista or the result is missing."""


def render(
    directory: Path | str,
    picture: Path | str | None = None,
    *,
    fields: tuple[str, ...] = ("von_mises", "contact_pressure"),
    exaggeration: float | None = None,
    camera: tuple[float, float, float] | None = None,
    panel: tuple[int, int] = (900, 900),
) -> Path:
    """Draw the result in a directory, one panel a field, and return the picture's path.

    Parameters
    ----------
    directory
        What a run wrote.
    picture
        PNG to write; ``picture.png`` in the directory when not given.
    fields
        What to colour by; those that the result does not hold are left out.
    exaggeration
        Factor of the displacements; when not given a round number that makes them visible.
    camera
        Direction from the bodies to the eye; when not given where contact is seen.
    panel
        Width and height of each panel in pixels.

    Raises
    ------
    PictureError
        pyvista is not installed, or there is no result with one of the fields.
    """
    pyvista = _pyvista()
    directory = Path(directory)
    source = directory / "solution.xdmf"
    if not source.is_file():
        raise PictureError(f"{source} is not there: run the scene first, with output.xdmf: true")
    grid = pyvista.read(source)
    shown = [name for name in fields if name in grid.point_data or name in grid.cell_data]
    if not shown:
        raise PictureError(
            f"{source} holds none of the fields {', '.join(fields)}; name them in output.fields"
        )
    if exaggeration is None:
        exaggeration = round_exaggeration(grid)
    target = Path(picture) if picture is not None else directory / "picture.png"
    target.parent.mkdir(parents=True, exist_ok=True)

    width, height = panel
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(1, len(shown)),
        window_size=(width * len(shown), height),
        border=False,
    )
    plotter.set_background("white")
    deformed = grid.copy()
    if "displacement" in grid.point_data:
        deformed.points = grid.points + exaggeration * grid.point_data["displacement"]
    direction, up = _view(grid)
    if camera is not None:
        direction = np.asarray(camera, dtype=float)
        if np.linalg.norm(np.cross(direction, up)) < 1e-9 * np.linalg.norm(direction):
            up = (0.0, 1.0, 0.0)
    lowered = 0.06 * grid.length * np.array(up)
    for column, name in enumerate(shown):
        plotter.subplot(0, column)
        _panel(plotter, grid, deformed, name)
        plotter.view_vector(direction, viewup=up)
        plotter.enable_parallel_projection()
        plotter.camera.zoom(0.95)
        # Room for the colours below the bodies.
        plotter.camera.focal_point = np.array(plotter.camera.focal_point) - lowered
        plotter.camera.position = np.array(plotter.camera.position) - lowered
    plotter.subplot(0, 0)
    plotter.add_text(
        _caption(directory, exaggeration), position="upper_left", font_size=13, color="black"
    )
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(target)
    plotter.close()
    return target


def plot(
    directory: Path | str,
    *,
    output: Path | str | None = None,
    fields: tuple[str, ...] = ("von_mises", "contact_pressure"),
    exaggeration: float | None = None,
    camera: tuple[float, float, float] | None = None,
) -> tuple[list[Path], list[str]]:
    """Draw the bodies (``bodies.png``) and the contact pressure (``contact_pressure.png``).

    Parameters
    ----------
    directory
        What a run wrote.
    output
        Where pictures go; the directory when not given.
    fields, exaggeration, camera
        As in `render`; in the plane there is no camera.

    Returns
    -------
    pictures, left_out
        Paths written, and sentences on what was not drawn and why.

    Raises
    ------
    ContactError
        There is no result, or nothing of it can be drawn.
    """
    directory = Path(directory)
    stored = read(directory)
    known = {*stored.point_data, *stored.cell_data}
    unknown = [name for name in fields if name not in known]
    if len(unknown) == len(fields):
        raise PictureError(
            f"the result holds none of {', '.join(unknown)}; it holds {', '.join(sorted(known))}"
        )
    left_out = [
        f"{name}: the result does not hold it, only {', '.join(sorted(known))}" for name in unknown
    ]
    shown = tuple(name for name in fields if name in known)
    target = Path(output) if output is not None else directory
    target.mkdir(parents=True, exist_ok=True)
    pictures: list[Path] = []
    try:
        if stored.plane:
            factor = exaggeration if exaggeration is not None else _round(stored)
            caption = _caption(directory, factor)
            made = draw_plane(stored, shown, LABELS, factor, target / "bodies.png", caption)
        else:
            made = render(
                directory, target / "bodies.png",
                fields=shown, exaggeration=exaggeration, camera=camera,
            )  # fmt: skip
        pictures.append(made)
    except PictureError as error:
        left_out.append(f"bodies.png: {error}")
    try:
        pictures.append(draw_contact(stored, target / "contact_pressure.png", _title(directory)))
    except NothingPressedError as error:
        left_out.append(f"contact_pressure.png: {error}")
    if not pictures:
        raise PictureError("\n".join(left_out))
    return pictures, left_out


def _round(stored: Any) -> float:
    """`round_exaggeration` of what `read` gives."""
    length = float(np.linalg.norm(np.ptp(stored.points, axis=0)))
    return round_exaggeration(SimpleNamespace(point_data=stored.point_data, length=length))


def round_exaggeration(grid: Any) -> float:
    """A factor 1, 2 or 5 times a power of ten that makes the displacements visible, not wild.

    Parameters
    ----------
    grid
        What has point data "displacement" and a length, as a pyvista dataset has.
    """
    if "displacement" not in grid.point_data:
        return 1.0
    largest = float(np.linalg.norm(grid.point_data["displacement"], axis=1).max(initial=0.0))
    if not largest > 0.0:
        return 1.0
    wanted = VISIBLE * float(grid.length) / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted) * power)


def _panel(plotter: Any, grid: Any, deformed: Any, name: str) -> None:
    """The deformed shape coloured by a field, within the outline it had."""
    plotter.add_mesh(
        grid.extract_feature_edges(feature_angle=30.0, manifold_edges=False),
        color="grey",
        line_width=2,
    )
    centre = "point" if name in deformed.point_data else "cell"
    edges = {"show_edges": deformed.n_cells <= EDGES_UP_TO, "edge_opacity": 0.25}
    thickness: dict[str, Any] = {}
    if name == "contact_pressure":
        deformed = deformed.copy()
        away = ~_touchable(grid)
        deformed.point_data[name] = np.where(away, np.nan, grid.point_data[name])
        if _flat(grid):
            # Pressure lives on the boundary: in the plane a line, drawn beside the body.
            plotter.add_mesh(deformed, color="lightgrey", lighting=False, **edges)
            deformed = deformed.extract_feature_edges(
                boundary_edges=True, feature_edges=False, manifold_edges=False
            )
            edges, thickness = {}, {"line_width": 10, "nan_opacity": 0.0}
    plotter.add_mesh(
        deformed,
        scalars=name,
        preference=centre,
        clim=_limits(deformed[name]),
        cmap="viridis" if centre == "cell" else "magma_r",
        nan_color="lightgrey",
        lighting=not _flat(grid),
        # Little shadow: the colours are to be read.
        ambient=0.55,
        diffuse=0.5,
        specular=0.0,
        **edges,
        **thickness,
        scalar_bar_args={
            "title": LABELS.get(name, name),
            "color": "black",
            "n_labels": 5,
            "fmt": "%.3g",
            "width": 0.7,
            "position_x": 0.15,
            "position_y": 0.03,
            "height": 0.09,
            "title_font_size": 26,
            "label_font_size": 22,
        },
    )


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Range of the colours; of a field that is the same everywhere, from 0, not its round-off."""
    size = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
    known = size[np.isfinite(size)]
    if not known.size:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    if high - low > UNIFORM * max(abs(low), abs(high)):
        return low, high
    return min(low, 0.0), max(high, 0.0) or 1.0


def _view(grid: Any) -> tuple[NDArray[np.float64], tuple[float, float, float]]:
    """Direction from which the bodies and what touches is seen, and what is up."""
    if _flat(grid):
        return np.array([0.0, 0.0, 1.0]), (0.0, 1.0, 0.0)
    direction = np.array([1.2, -1.0, 0.6])
    centre = np.array(grid.center)
    touched = _touchable(grid)
    if touched.any():
        half = np.maximum(0.5 * np.ptp(grid.points, axis=0), 1e-12)
        side = (grid.points[touched].mean(axis=0) - centre) / half
        # Where a whole face may touch its mean is at ±1; several faces share what is left.
        beside = np.abs(side) > 0.5 * np.abs(side).max()
        direction = np.where(beside, 1.4 * np.sign(side) * np.abs(direction), direction)
    return direction, (0.0, 0.0, 1.0)


def _touchable(grid: Any) -> NDArray[np.bool_]:
    """Nodes with a contact row, or with pressure where the gap was not written."""
    if "gap" in grid.point_data:
        return np.asarray(np.isfinite(grid.point_data["gap"]))
    if "contact_pressure" in grid.point_data:
        return np.asarray(grid.point_data["contact_pressure"] > 0.0)
    return np.zeros(grid.n_points, dtype=bool)


def _flat(grid: Any) -> bool:
    return bool(np.ptp(grid.points[:, 2]) == 0.0)


def _caption(directory: Path, exaggeration: float) -> str:
    return f"{_title(directory)}\ndisplacements x {exaggeration:g}".strip()


def _title(directory: Path) -> str:
    try:
        summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        return str(summary["scene"]["title"])
    except (OSError, ValueError, KeyError):
        return ""


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise PictureError(
            "bodies in space are drawn by pyvista, which is not installed (about 800 MB): "
            "'.venv/bin/pip install -c .venv/constraints.txt pyvista' here, "
            "'pip install contact-app[plot]' elsewhere; or open solution.xdmf in ParaView"
        ) from error
    return pyvista
