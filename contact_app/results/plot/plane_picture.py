"""Deformed bodies of the plane coloured by fields, by matplotlib alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.results.plot.stored import Stored

EDGES_UP_TO = 5_000
"""Cells beyond which their edges would blacken the picture."""


def draw_plane(
    stored: Stored,
    fields: tuple[str, ...],
    labels: dict[str, str],
    exaggeration: float,
    target: Path,
    caption: str,
) -> Path:
    """Draw a panel for each field, the outline of the undeformed bodies behind."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    size = np.ptp(stored.points[:, :2], axis=0)
    tall = min(max(size[1] / max(size[0], 1e-300), 0.4), 2.0)
    figure = Figure(figsize=(6.0 * len(fields), 6.0 * tall + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    moved = stored.points[:, :2] + exaggeration * _moves(stored)
    triangles, rows = stored.triangles()
    (sides,) = stored.boundary()
    outline, rim = stored.points[sides][:, :, :2], moved[sides]
    for axes, name in zip(np.ravel(figure.subplots(1, len(fields))), fields, strict=True):
        axes.add_collection(LineCollection(outline, colors="grey", linewidths=0.8))
        if name == "contact_pressure":
            pressure = stored.point_data[name]
            axes.tripcolor(*moved.T, triangles, np.zeros(len(moved)), cmap="Greys", vmin=-1, vmax=5)
            axes.add_collection(LineCollection(rim, colors="black", linewidths=0.5))
            pressed = sides[(pressure[sides] > 0.0).any(axis=1)]
            shades: Any = LineCollection(
                moved[pressed], array=pressure[pressed].mean(axis=1), cmap="magma_r", linewidths=5
            )
            shades.set_clim(0.0, float(pressure.max(initial=0.0)) or 1.0)
            axes.add_collection(shades)
        else:
            shades = _shades(axes, stored, name, moved, triangles, rows)
            axes.add_collection(LineCollection(rim, colors="black", linewidths=0.5))
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set_axis_off()
        bar = figure.colorbar(
            shades, ax=axes, location="bottom", label=labels.get(name, name), shrink=0.8
        )
        bar.formatter.set_powerlimits((-3, 4))
    figure.suptitle(caption, fontsize=10)
    figure.savefig(target, dpi=150, format="png")
    return target


def _moves(stored: Stored) -> NDArray[np.float64]:
    moves = stored.point_data.get("displacement")
    return np.zeros((len(stored.points), 2)) if moves is None else moves[:, :2]


def _shades(
    axes: Any,
    stored: Stored,
    name: str,
    moved: NDArray[np.float64],
    triangles: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> Any:
    """Cells or nodes coloured by a field; of vectors and tensors the magnitude."""
    at_cells = name in stored.cell_data
    values = stored.cell_data[name] if at_cells else stored.point_data[name]
    if values.ndim == 2:
        values = np.linalg.norm(values, axis=1)
    if at_cells:
        few = len(rows) <= EDGES_UP_TO
        return axes.tripcolor(
            *moved.T, triangles, facecolors=values[rows], cmap="viridis", rasterized=not few
        )
    known = np.isfinite(values[triangles]).all(axis=1)
    axes.tripcolor(*moved.T, triangles, np.zeros(len(moved)), cmap="Greys", vmin=-1, vmax=5)
    return axes.tripcolor(
        *moved.T, triangles[known], np.nan_to_num(values), shading="gouraud", cmap="magma_r"
    )
