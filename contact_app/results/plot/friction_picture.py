"""Picture of a contact with friction: open, sticking and slipping parts, and friction traction.

In the plane a curve for each stretch of boundary in contact: the friction traction along the
boundary, above a strip coloured by the status of the nodes. In space a patch for each connected
piece of surface, laid flat as in the picture of the contact pressure: each node colours the part
of the surface that is nearest to it in its triangles, and arrows show the friction traction.
"""

from pathlib import Path
from typing import Any

import numpy as np

from contact_app.results.plot.contact_picture import (
    STATUS,
    NothingPressedError,
    flat_patches,
    profiles,
    touchable,
)
from contact_app.results.plot.stored import Stored
from meshes.arrays import Array, Ints

COLOURS = {"open": "#bbbbbb", "stick": "#0072b2", "slip": "#e69f00"}
"""Names of the status 0, 1 and 2 and their colours, which the colour-blind tell apart.

Blue and orange of Okabe and Ito, Color Universal Design (2008), and a grey."""

STRIP = 0.06
"""Height of the strip of colours, as a share of the picture's."""

ARROWS = 400
"""Approximate number of arrows in a patch."""


def draw_friction(stored: Stored, target: Path, title: str = "") -> Path:
    """Draw the status of contact nodes of a result with friction; return the picture's path.

    Raises
    ------
    NothingPressedError
        Nothing touches.
    """
    status = status_shown(stored)
    if not (status > 0.0).any():
        raise NothingPressedError("no node sticks or slips: nothing touches in this result")
    from matplotlib.patches import Patch

    draw = _strips if stored.plane else _zones
    figure = draw(stored, status)
    names = [Patch(color=colour, label=name) for name, colour in COLOURS.items()]
    figure.legend(handles=names, loc="outside lower center", ncols=len(names))
    if title:
        figure.suptitle(title)
    figure.savefig(target, dpi=150, format="png")
    return target


def status_shown(stored: Stored) -> Array:
    """Status (n,) of nodes that may touch, NaN at others.

    A node inside a facet in contact at which the contact law is not enforced has the status of its
    neighbours: slip if one of them slips.
    """
    status = np.where(touchable(stored) | (stored.point_data[STATUS] > 0.0), 0.0, np.nan)
    np.maximum(status, stored.point_data[STATUS], out=status)
    pressure = stored.point_data.get("contact_pressure", np.zeros(len(status)))
    without = (pressure > 0.0) & ~(status > 0.0)
    if without.any():
        around = np.zeros(len(status))
        for sides in stored.boundary():
            most = np.nan_to_num(status[sides]).max(axis=1)
            np.maximum.at(around, sides.ravel(), np.repeat(most, sides.shape[1]))
        status[without] = around[without]
    return status


def parts_of_nodes(across: Array, triangles: Ints) -> Array:
    """The third of each triangle at each of its corners, bounded by its medians, (m, 3, 4, 2)."""
    corners = across[triangles]
    after, before = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
    centre = np.broadcast_to(corners.mean(axis=1, keepdims=True), corners.shape)
    parts = [corners, 0.5 * (corners + after), centre, 0.5 * (corners + before)]
    return np.stack(parts, axis=2)


def laid_flat(points: Array, across: Array, triangles: Ints, vectors: Array) -> Array:
    """Means of vectors (n, 3) over triangles, in the coordinates of the flattened piece (m, 2)."""
    edges = np.diff(points[triangles], axis=1).transpose(0, 2, 1)
    flat = np.diff(across[triangles], axis=1).transpose(0, 2, 1)
    means = vectors[triangles].mean(axis=1)
    return np.asarray(np.einsum("mij,mjk,mk->mi", flat, np.linalg.pinv(edges), means))


def _strips(stored: Stored, status: Array) -> Any:
    """Figure of status and traction along each boundary in the plane, one strip for each."""
    from matplotlib.figure import Figure

    strips = profiles(stored, np.nan_to_num(status))
    traction = stored.point_data.get("friction_traction")
    figure = Figure(figsize=(8.0, 1.5 + 3.5 * len(strips)), layout="constrained")
    places = np.ravel(figure.subplots(len(strips), 1))
    for axes, (nodes, position) in zip(places, strips, strict=True):
        ends = np.r_[position[0], 0.5 * (position[1:] + position[:-1]), position[-1]]
        colour = [_colour(status[node]) for node in nodes]
        axes.bar(
            ends[:-1], STRIP, np.diff(ends), align="edge", color=colour, linewidth=0,
            transform=axes.get_xaxis_transform(), zorder=3,
        )  # fmt: skip
        start, end = stored.points[nodes[[0, -1]]][:, :2]
        label = f"from ({start[0]:.3g}, {start[1]:.3g}) to ({end[0]:.3g}, {end[1]:.3g})"
        axes.set(xlabel=f"position along the boundary, {label}", ylabel="status")
        axes.set_xlim(ends[0], ends[-1])
        if traction is None:
            axes.set_yticks([])
            continue
        tangent = np.gradient(stored.points[nodes], axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
        along = np.sum(traction[nodes] * tangent, axis=1)
        axes.plot(position, along, color="black", linewidth=1.0)
        axes.scatter(position, along, color=colour, s=14, zorder=4)
        low, high = min(along.min(), 0.0), max(along.max(), 0.0)
        room = (high - low) or 1.0
        axes.set_ylim(low - (0.05 + 1.5 * STRIP) * room, high + 0.05 * room)
        axes.set_ylabel("friction traction along the boundary")
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
        axes.grid(alpha=0.3)
    return figure


def _zones(stored: Stored, status: Array) -> Any:
    """Figure of status and traction on each patch of facets in space, laid flat."""
    from matplotlib.collections import PolyCollection

    traction = stored.point_data.get("friction_traction")
    figure, flat = flat_patches(stored, np.nan_to_num(status))
    for axes, patch in flat:
        has_status = np.isfinite(status[patch.seen])
        colour = [_colour(value) for value in status[patch.seen][has_status]]
        parts = parts_of_nodes(patch.across, patch.seen)[has_status]
        axes.add_collection(PolyCollection(parts, facecolors=colour, edgecolors="face", lw=0.3))
        if traction is not None:
            some = patch.pressed[:: max(len(patch.pressed) // ARROWS, 1)]
            arrows = laid_flat(stored.points, patch.across, some, traction)
            middle = patch.across[some].mean(axis=1)
            if arrows.any():
                axes.quiver(*middle.T, *arrows.T, color="black", pivot="mid", width=0.003)
                titles = filter(None, (axes.get_title(), "arrows: friction traction"))
                axes.set_title("; ".join(titles), fontsize=9)
    return figure


def _colour(status: float) -> str:
    return list(COLOURS.values())[int(np.nan_to_num(status))]
