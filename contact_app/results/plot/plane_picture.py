"""Deformed bodies of the plane coloured by fields, by matplotlib alone."""

from pathlib import Path
from typing import Any

import numpy as np

from contact_app.results.plot.arrangement import of_bodies
from contact_app.results.plot.contact_picture import sides_in_contact
from contact_app.results.plot.node_values import copies, limits, node_values, shifts, smooth_name
from contact_app.results.plot.stored import LABELS, STRESSES, Stored
from meshes.arrays import Array, Ints

EDGES_UP_TO = 5_000
"""Number of cells above which edges are not drawn."""


def draw_plane(
    stored: Stored, fields: tuple[str, ...], exaggeration: float, target: Path, caption: str
) -> Path:
    """Draw a panel for each field, the outline of the undeformed bodies behind."""
    from matplotlib.collections import LineCollection

    size = np.ptp(stored.points[:, :2], axis=0)
    ratio = float(np.clip(size[1] / max(size[0], 1e-300), 0.1, 2.0))
    figure, places, _ = of_bodies(len(fields), ratio)
    moved = stored.points[:, :2] + exaggeration * _moves(stored)
    triangles, rows = stored.triangles()
    (sides,) = stored.boundary()
    outline, rim = stored.points[sides][:, :, :2], moved[sides]
    for axes, name in zip(places, fields, strict=True):
        axes.add_collection(LineCollection(outline, colors="grey", linewidths=0.8))
        coloured = _coloured_sides(stored, name, sides, triangles)
        if coloured is not None:
            values = stored.field(name)[coloured]
            axes.tripcolor(*moved.T, triangles, np.zeros(len(moved)), cmap="Greys", vmin=-1, vmax=5)
            axes.add_collection(LineCollection(rim, colors="black", linewidths=0.5))
            shades: Any = LineCollection(
                moved[coloured], array=values.mean(axis=1), cmap="magma_r", linewidths=5
            )
            low, high = limits(values)
            shades.set_clim(min(low, 0.0) if name.endswith("contact_pressure") else low, high)
            axes.add_collection(shades)
        else:
            shades = _shades(axes, stored, name, moved, triangles, rows)
            axes.add_collection(LineCollection(rim, colors="black", linewidths=0.5))
        axes.set_aspect("equal")
        axes.autoscale_view()
        label = LABELS.get(name, name)
        bar = figure.colorbar(shades, ax=axes, location="bottom", label=label, shrink=0.8)
        bar.formatter.set_powerlimits((-3, 4))
    figure.suptitle(caption, fontsize=10)
    figure.savefig(target, dpi=150, format="png")
    return target


def _coloured_sides(stored: Stored, name: str, sides: Ints, triangles: Ints) -> Ints | None:
    """Sides that a contact pressure or a field of the boundary alone, as the gap, colours.

    None for other fields.
    """
    if name not in stored.point_data:
        return None
    values = stored.field(name)
    if name.endswith("contact_pressure"):
        return sides_in_contact(stored, sides, values)
    if np.isfinite(values[triangles]).all(axis=1).any():
        return None
    return sides[np.isfinite(values[sides]).all(axis=1)]


def _moves(stored: Stored) -> Array:
    moves = stored.point_data.get("displacement")
    return np.zeros((len(stored.points), 2)) if moves is None else moves[:, :2]


def _shades(axes: Any, stored: Stored, name: str, moved: Array, triangles: Ints, rows: Ints) -> Any:
    """Cells or nodes coloured by a field; for vectors and tensors by the magnitude."""
    colours = "viridis" if name in STRESSES else "magma_r"
    name = smooth_name(stored, name)
    if name in stored.cell_data:
        values, few = stored.field(name), len(rows) <= EDGES_UP_TO
        return axes.tripcolor(
            *moved.T, triangles, facecolors=values[rows], cmap="viridis", rasterized=not few,
            vmin=limits(values)[0], vmax=limits(values)[1],
        )  # fmt: skip
    values = node_values(stored, name)
    if values.ndim == 2:
        values = np.linalg.norm(values, axis=1)
    corners = triangles + shifts(stored, rows)[:, None]
    places = np.tile(moved, (copies(stored), 1)).T
    corners = corners[np.isfinite(values[corners]).all(axis=1)]
    if len(corners) < len(triangles):
        axes.tripcolor(*moved.T, triangles, np.zeros(len(moved)), cmap="Greys", vmin=-1, vmax=5)
    low, high = limits(values[corners])
    return axes.tripcolor(
        *places, corners, np.nan_to_num(values), shading="gouraud", cmap=colours,
        vmin=low, vmax=high,
    )  # fmt: skip
