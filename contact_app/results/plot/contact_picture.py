"""The contact pressure over the contact surface, by matplotlib alone.

In the plane the picture has a line for each stretch of boundary in contact: pressure against the
position along the boundary. In space it has a patch for each connected piece of surface, flattened
(a bore is unrolled) and zoomed to the part in contact.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from contact_app.errors import ContactError
from contact_app.results.plot.arrangement import of_patches
from contact_app.results.plot.stored import Stored
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected

MARGIN = 0.15
"""Margin around the part in contact, as a share of its size."""


STATUS = "contact_status"
"""Name of the field of node statuses: open (0), stick (1) or slip (2)."""

STRAIGHT = 0.97
"""Length of the mean of unit normals below which a surface is bent: a quarter of a circle's."""

BARREL = 0.01
"""Share of normals along an axis below which a surface is bent about it alone."""

ROUND = 0.05
"""Relative variation of the radius up to which a surface counts as a cylinder."""


class NothingPressedError(ContactError):
    """The result holds no contact pressure, or none above zero."""


def draw_contact(
    stored: Stored, target: Path, title: str = "", name: str = "contact_pressure"
) -> Path:
    """Draw the contact pressure of a result and return the picture's path.

    Parameters
    ----------
    name
        Name of the field: the pressure, or the smoothed pressure.

    Raises
    ------
    NothingPressedError
        There is no pressure to draw.
    """
    pressure = stored.point_data.get(name)
    if pressure is None:
        raise NothingPressedError(
            f"the result holds no {name}; name it in output.fields and run again"
        )
    if not (pressure > 0.0).any():
        raise NothingPressedError("no contact pressure: nothing touches in this result")
    draw = pressure_lines if stored.plane else _patches
    figure = draw(stored, pressure, name.replace("_", " "))
    if title:
        figure.suptitle(title)
    figure.savefig(target, dpi=150, format="png")
    return target


def touchable(stored: Stored) -> Mask:
    """Mask (n,) of nodes with a contact row; without a written gap, of nodes in contact."""
    data = stored.point_data
    if "gap" in data:
        return np.asarray(np.isfinite(data["gap"]))
    return np.asarray(data["contact_pressure" if "contact_pressure" in data else STATUS] > 0.0)


def profiles(stored: Stored, acting: Array) -> list[tuple[Ints, Array]]:
    """Stretches of the boundary of a plane result that are candidates and partly in contact.

    Parameters
    ----------
    acting : (n,)
        Positive at nodes in contact: the contact pressure, or the status.

    Returns
    -------
    list of (nodes (k,), position (k,))
        Nodes along the boundary, from the left end (the lower one of two), and their distance
        from it along the undeformed boundary.
    """
    (sides,) = stored.boundary()
    sides = sides_in_contact(stored, sides, acting)
    profiles_of_parts = []
    for piece in connected_sides(sides, len(stored.points)):
        nodes, ends = np.unique(piece, return_inverse=True)
        if not (acting[nodes] > 0.0).any():
            continue
        ends = ends.reshape(-1, 2)
        tips = np.flatnonzero(np.bincount(ends.ravel(), minlength=len(nodes)) == 1)
        if not len(tips):  # a closed curve is opened at the least pressure
            lightest = int(np.argmin(acting[nodes]))
            opened = int(np.flatnonzero((ends == lightest).any(axis=1))[0])
            ends, tips = np.delete(ends, opened, axis=0), np.array([lightest])
        x, y = stored.points[nodes[tips]][:, :2].T
        tip = tips[np.lexsort((y, x))[0]]
        corners = stored.points[nodes[ends]]
        length = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
        graph = coo_array((length, (ends[:, 0], ends[:, 1])), shape=(len(nodes), len(nodes)))
        position = dijkstra(graph.tocsr(), directed=False, indices=int(tip))
        order = np.argsort(position)
        profiles_of_parts.append((nodes[order], position[order]))
    return profiles_of_parts


def sides_in_contact(stored: Stored, sides: Ints, acting: Array) -> Ints:
    """Candidate sides; if only a line or a node is in contact, all sides around it."""
    may = touchable(stored)[sides].all(axis=1)
    pressed = (acting[sides] > 0.0).any(axis=1)
    return sides[may if (may & pressed).any() else pressed]


def pressure_lines(stored: Stored, pressure: Array, label: str) -> Any:
    """Figure of the pressure along the boundary, from one end of the contact to the other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes, pressed = figure.subplots(), []
    for nodes, position in profiles(stored, pressure):
        around = np.flatnonzero(pressure[nodes] > 0.0)[[0, -1]] + [-1, 1]
        pressed.append(position[np.clip(around, 0, len(nodes) - 1)])
        start, end = stored.points[nodes[[0, -1]]][:, :2]
        ends = f"from ({start[0]:.3g}, {start[1]:.3g}) to ({end[0]:.3g}, {end[1]:.3g})"
        axes.plot(position, pressure[nodes], marker=".", markersize=4, linewidth=1.2, label=ends)
    low, high = np.min(pressed), np.max(pressed)
    room = MARGIN * (high - low)
    axes.set_xlim(low - room, high + room)
    axes.set(xlabel="position along the boundary", ylabel=label)
    axes.set_ylim(bottom=0.0)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def _patches(stored: Stored, pressure: Array, label: str) -> Any:
    """Figure of the pressure on each patch of facets, laid flat, with one colour bar."""
    high = float(pressure.max())
    figure, flat = flat_patches(stored, pressure)
    for axes, patch in flat:
        shades = axes.tripcolor(
            *patch.across.T, patch.seen, pressure, shading="gouraud", cmap="magma_r",
            vmin=0.0, vmax=high,
        )  # fmt: skip
    bar = figure.colorbar(shades, ax=[axes for axes, _ in flat], label=label, shrink=0.8)
    bar.formatter.set_powerlimits((-3, 4))
    return figure


@dataclass(frozen=True, eq=False)
class Patch:
    """A connected piece of surface, laid flat."""

    across: Array  # (n, 2)
    """Coordinates of all points of the result."""
    seen: Ints
    pressed: Ints
    """Triangles that are shown, and those in contact among them. Shapes (m, 3), (k, 3)."""
    names: tuple[str, str]
    middle: Array  # (3,)
    """Middle of the triangles in contact."""

    @classmethod
    def of(cls, stored: Stored, piece: Ints, acting: Array) -> "Patch":
        """A piece (m, 3), in contact where a field (n,) is positive."""
        pressed = (acting[piece] > 0.0).any(axis=1)
        across, shown, names = flattened(stored.points, piece, pressed)
        some = piece[pressed & shown]
        size = float(np.ptp(stored.points, axis=0).max())
        middle = np.round(stored.points[np.unique(some)].mean(axis=0) / size, 6) * size
        return cls(across, piece[shown], some, names, middle + 0.0)

    @property
    def box(self) -> Array:
        """Lower and upper corner (2, 2) of the surroundings of the part in contact."""
        corners = self.across[self.pressed.ravel()]
        low, top = corners.min(axis=0), corners.max(axis=0)
        room = MARGIN * (top - low).max()
        return np.stack([low - room, top + room])


def flat_patches(stored: Stored, acting: Array) -> tuple[Any, list[tuple[Any, Patch]]]:
    """A figure with axes for each patch that is partly in contact, zoomed to that part.

    Several patches have titles with their places.
    """
    from matplotlib.figure import Figure

    flat = [Patch.of(stored, piece, acting) for piece in patches(stored, acting)]
    shape, inches = of_patches([np.ptp(patch.box, axis=0) for patch in flat])
    figure = Figure(figsize=inches, layout="compressed")
    places = np.ravel(figure.subplots(*shape))
    for axes in places[len(flat) :]:
        axes.set_axis_off()
    for axes, patch in zip(places, flat, strict=False):
        axes.set(xlim=patch.box[:, 0], ylim=patch.box[:, 1], aspect="equal")
        axes.set(xlabel=patch.names[0], ylabel=patch.names[1])
        if len(flat) > 1:
            place = ", ".join(f"{value:.3g}" for value in patch.middle)
            axes.set_title(f"middle at ({place})", fontsize=9)
    return figure, list(zip(places, flat, strict=False))


def patches(stored: Stored, acting: Array) -> list[Ints]:
    """Connected pieces of surface in space that are partly in contact, as triangles (m, 3)."""
    corners = np.concatenate(
        [sides[:, pick] for sides in stored.boundary() for pick in _CORNERS[sides.shape[1]]]
    )
    pieces = connected_sides(sides_in_contact(stored, corners, acting), len(stored.points))
    return [piece for piece in pieces if (acting[piece] > 0.0).any()]


def flattened(points: Array, triangles: Ints, pressed: Mask) -> tuple[Array, Mask, tuple[str, str]]:
    """Flatten a piece of surface.

    If the part in contact is curved about an axis, as in a bore, the surface is unrolled; otherwise
    it is projected along the mean normal of the part in contact.

    Parameters
    ----------
    points : (n, 3)
    triangles : (m, 3)
        Triangles of one connected piece, anticlockwise seen from outside.
    pressed : (m,)

    Returns
    -------
    across : (n, 2)
        Coordinates of all points.
    shown : (m,)
        Mask of triangles that are not reversed and not across the cut of an unrolled bore.
    names
        Names of the coordinates.
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)  # twice the area in length
    area = np.linalg.norm(normals, axis=1)[pressed]
    mean = normals[pressed].sum(axis=0)
    normal = mean / max(float(np.linalg.norm(mean)), 1e-300)
    if np.linalg.norm(mean) < STRAIGHT * area.sum():
        units = normals[pressed] / np.sqrt(np.maximum(area, 1e-300))[:, None]
        spread, vectors = np.linalg.eigh(units.T @ units)
        if spread[0] < BARREL * spread.sum():
            unrolled = _unrolled(points, triangles, pressed, vectors[:, 0], normal)
            if unrolled is not None:
                return unrolled
    shown = normals @ normal > 0.0
    axis = int(np.argmax(np.abs(normal)))
    if np.abs(normal[axis]) > 1.0 - 1e-3:
        first, second = (i for i in range(3) if i != axis)
        return points[:, [first, second]], shown, ("xyz"[first], "xyz"[second])
    level = np.cross([0.0, 0.0, 1.0], normal) if axis != 2 else np.cross([0.0, 1.0, 0.0], normal)
    level /= np.linalg.norm(level)
    across = points @ np.stack([level, np.cross(normal, level)], axis=1)
    return across, shown, ("across", "along")


def _unrolled(
    points: Array, triangles: Ints, pressed: Mask, axis: Array, middle: Array
) -> tuple[Array, Mask, tuple[str, str]] | None:
    """Unroll a piece of a cylinder along an axis, cut opposite to `middle`.

    None for other shapes.
    """
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    out = middle - (middle @ axis) * axis
    if np.linalg.norm(out) < 1e-6:  # in contact all around: cut anywhere
        out = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    out /= np.linalg.norm(out)
    plane = points @ np.stack([out, np.cross(axis, out)], axis=1)
    on = np.unique(triangles[pressed])
    rim = plane[on]
    fit, *_ = np.linalg.lstsq(
        np.column_stack([2.0 * rim, np.ones(len(rim))]), (rim**2).sum(axis=1), rcond=None
    )
    centre, radius = fit[:2], np.sqrt(max(fit[2] + fit[:2] @ fit[:2], 0.0))
    if not np.allclose(np.linalg.norm(rim - centre, axis=1), radius, rtol=ROUND):
        return None
    x, y = (plane - centre).T
    # Normals of a bore point to its axis.
    inwards = -1.0 if (rim - centre)[:, 0].mean() < 0.0 else 1.0
    angle = np.arctan2(inwards * y, inwards * x)
    shown = np.ptp(angle[triangles], axis=1) < np.pi
    # Only what lies on the cylinder, not faces at its ends.
    distance = np.linalg.norm(plane[triangles] - centre, axis=2)
    shown &= (np.abs(distance - radius) < ROUND * radius).all(axis=1)
    across = np.column_stack([radius * angle, points @ axis])
    along = "xyz"[int(np.argmax(axis))] if axis.max() > 1.0 - 1e-3 else "along the axis"
    return across, shown, ("around the axis", along)


def connected_sides(sides: Ints, n: int) -> list[Ints]:
    """Sides by connected piece."""
    if not len(sides):
        return []
    others = sides[:, 1:].ravel()
    firsts = np.repeat(sides[:, 0], sides.shape[1] - 1)
    piece = connected((firsts, others), n)[sides[:, 0]]
    return [sides[piece == number] for number in np.unique(piece)]


_CORNERS = {3: ([0, 1, 2],), 4: ([0, 1, 2], [0, 2, 3])}
