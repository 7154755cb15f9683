"""The contact pressure over the contact surface, by matplotlib alone.

In the plane a line for each stretch of boundary in contact: pressure against the position along
the boundary. In space a patch for each connected piece of surface, laid flat along its mean
normal and zoomed to where it is pressed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from contact_app.errors import ContactError
from contact_app.stored import Stored

MARGIN = 0.15
"""Room about what is pressed, as a share of its size."""


class NothingPressedError(ContactError):
    """The result holds no contact pressure, or none above zero."""


def draw_contact(stored: Stored, target: Path, title: str = "") -> Path:
    """Draw the contact pressure of a result and return the picture's path.

    Raises
    ------
    NothingPressedError
        There is none to draw.
    """
    pressure = stored.point_data.get("contact_pressure")
    if pressure is None:
        raise NothingPressedError(
            "the result holds no contact_pressure; name it in output.fields and run again"
        )
    if not (pressure > 0.0).any():
        raise NothingPressedError("no contact pressure: nothing touches in this result")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    draw = _lines if stored.plane else _patches
    draw(figure, stored, pressure)
    if title:
        figure.suptitle(title)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=150)
    return target


def touchable(stored: Stored) -> NDArray[np.bool_]:
    """Nodes (n,) with a contact row; those with pressure where the gap was not written."""
    if "gap" in stored.point_data:
        return np.asarray(np.isfinite(stored.point_data["gap"]))
    return np.asarray(stored.point_data["contact_pressure"] > 0.0)


def profiles(stored: Stored) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Stretches of a plane result's boundary that may touch and are pressed somewhere.

    Returns
    -------
    list of (nodes (k,), position (k,))
        Nodes along the boundary, from the left end (the lower one of two), and their distance
        from it along the undeformed boundary.
    """
    may = touchable(stored)
    (sides,) = stored.boundary()
    sides = sides[may[sides].all(axis=1)]
    found = []
    for piece in _connected(sides, len(stored.points)):
        nodes, ends = np.unique(piece, return_inverse=True)
        if not (stored.point_data["contact_pressure"][nodes] > 0.0).any():
            continue
        ends = ends.reshape(-1, 2)
        tips = np.flatnonzero(np.bincount(ends.ravel(), minlength=len(nodes)) == 1)
        if not len(tips):  # a closed curve is opened where it is pressed least
            pressed = stored.point_data["contact_pressure"][nodes]
            lightest = int(np.argmin(pressed))
            opened = int(np.flatnonzero((ends == lightest).any(axis=1))[0])
            ends, tips = np.delete(ends, opened, axis=0), np.array([lightest])
        x, y = stored.points[nodes[tips]][:, :2].T
        tip = tips[np.lexsort((y, x))[0]]
        corners = stored.points[nodes[ends]]
        length = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
        graph = coo_array((length, (ends[:, 0], ends[:, 1])), shape=(len(nodes), len(nodes)))
        position = dijkstra(graph.tocsr(), directed=False, indices=int(tip))
        order = np.argsort(position)
        found.append((nodes[order], position[order]))
    return found


def _lines(figure: Any, stored: Stored, pressure: NDArray[np.float64]) -> None:
    axes = figure.subplots()
    for nodes, position in profiles(stored):
        start, end = stored.points[nodes[[0, -1]]][:, :2]
        label = f"from ({start[0]:.3g}, {start[1]:.3g}) to ({end[0]:.3g}, {end[1]:.3g})"
        axes.plot(position, pressure[nodes], marker=".", markersize=4, linewidth=1.2, label=label)
    axes.set(xlabel="position along the boundary", ylabel="contact pressure")
    axes.set_ylim(bottom=0.0)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _patches(figure: Any, stored: Stored, pressure: NDArray[np.float64]) -> None:
    may = touchable(stored)
    corners = np.concatenate(
        [sides[:, pick] for sides in stored.boundary() for pick in _CORNERS[sides.shape[1]]]
    )
    corners = corners[may[corners].all(axis=1)]
    pieces = [
        piece for piece in _connected(corners, len(stored.points)) if (pressure[piece] > 0.0).any()
    ]
    high = float(pressure.max())
    flat = []
    for axes, piece in zip(np.ravel(figure.subplots(1, len(pieces))), pieces, strict=True):
        across, names = _flattened(stored.points, piece)
        shades = axes.tripcolor(
            across[:, 0], across[:, 1], piece, pressure,
            shading="gouraud", cmap="magma_r", vmin=0.0, vmax=high,
        )  # fmt: skip
        pressed = piece[(pressure[piece] > 0.0).any(axis=1)]
        low, top = across[pressed].min(axis=(0, 1)), across[pressed].max(axis=(0, 1))
        room = MARGIN * (top - low).max()
        axes.set_xlim(low[0] - room, top[0] + room)
        axes.set_ylim(low[1] - room, top[1] + room)
        axes.set_aspect("equal")
        axes.set(xlabel=names[0], ylabel=names[1])
        flat.append(axes)
    bar = figure.colorbar(shades, ax=flat, label="contact pressure", shrink=0.8)
    bar.formatter.set_powerlimits((-3, 4))


def _flattened(
    points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], tuple[str, str]]:
    """All points (n, 2) along two directions across the mean normal, and names of those."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    # The mean of outer products: it does not matter which way round a triangle is.
    _, vectors = np.linalg.eigh(normals.T @ normals)
    normal = vectors[:, -1]
    axis = int(np.argmax(np.abs(normal)))
    if np.abs(normal[axis]) > 1.0 - 1e-3:
        first, second = (i for i in range(3) if i != axis)
        return points[:, [first, second]], ("xyz"[first], "xyz"[second])
    level = np.cross([0.0, 0.0, 1.0], normal) if axis != 2 else np.cross([0.0, 1.0, 0.0], normal)
    level /= np.linalg.norm(level)
    return points @ np.stack([level, np.cross(normal, level)], axis=1), ("across", "along")


def _connected(sides: NDArray[np.int64], n: int) -> list[NDArray[np.int64]]:
    """Sides by connected piece."""
    if not len(sides):
        return []
    others = sides[:, 1:].ravel()
    firsts = np.repeat(sides[:, 0], sides.shape[1] - 1)
    graph = coo_array((np.ones(len(firsts)), (firsts, others)), shape=(n, n))
    piece = connected_components(graph, directed=False)[1][sides[:, 0]]
    return [sides[piece == number] for number in np.unique(piece)]


_CORNERS = {3: ([0, 1, 2],), 4: ([0, 1, 2], [0, 2, 3])}
