"""Deformed bodies in space coloured by fields, one panel per field, with undeformed edges.

The picture shows the skin of the cells, seen along one direction without perspective
(`contact_app.results.plot.raster`, or VTK where it is installed). Surfaces are shaded smoothly but
for sharp edges. Titles and scales are matplotlib's.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.results.plot import vtk_images
from contact_app.results.plot.arrangement import of_bodies
from contact_app.results.plot.contact_picture import touchable
from contact_app.results.plot.node_values import copies, limits, node_values, shifts, smooth_name
from contact_app.results.plot.raster import (
    WIRE,
    DepthBuffer,
    Triangles,
    drawn_edges,
    visible_share,
    wires,
)
from contact_app.results.plot.stored import LABELS, STRESSES, Stored
from meshes.arrays import Array, Ints, Mask

#: Number of faces above which edges are not drawn.
EDGES_UP_TO = 40_000
#: Angle between faces, in degrees, from which the edge between them is drawn as an outline. A hole
#: of eight facets has 45 between them and is shown by its rims.
SHARP = 50.0
#: Share of the faces with extreme values that the colour scale may leave out.
EXTREME = 0.01
#: Pixels along the picture in the test for hidden parts.
COARSE = 300
#: Dots an inch: twice those of the picture, which smooths edges.
SHARPNESS = 300
#: Light that falls on every face, and what comes from one side.
AMBIENT, DIFFUSE = 0.72, 0.30
#: Direction to the light: right, up, towards the eye.
LIGHT = (-0.35, 0.7, 1.0)
BARE, GREY = (0.82, 0.82, 0.82), (0.5, 0.5, 0.5)
#: Opacity of translucent faces.
VEIL = 0.12


@dataclass(frozen=True, eq=False)
class Panel:
    """The field that colours one picture of the skin."""

    values: Array  # (nodes,) or (faces,)
    """NaN where the body is left bare."""
    limits: tuple[float, float]
    """Ends of the scale."""
    exceeds: bool
    """Whether values leave the scale at its upper end."""
    colours: str
    """Name of matplotlib's colour map."""
    label: str
    through: bool
    """Whether bare faces are translucent, because coloured ones lie behind them."""


@dataclass(frozen=True, eq=False)
class View:
    """A look along -`direction` without perspective."""

    direction: Array
    up: Array
    right: Array
    """Unit vectors; `direction` points to the camera. Shape (3,)."""
    centre: Array  # (3,)
    half: Array  # (2,)
    """Half the width and height of the view, in lengths of the bodies."""

    @property
    def light(self) -> Array:
        """Unit vector (3,) to the light: above and to the left of the camera."""
        right, up, towards_eye = LIGHT
        towards = towards_eye * self.direction + up * self.up + right * self.right
        return towards / np.linalg.norm(towards)


@dataclass(frozen=True, eq=False)
class Frame:
    """The pixels of a view."""

    view: View
    scale: float
    """Pixels per unit of length."""
    size: tuple[int, int]
    """Width and height in pixels."""

    @classmethod
    def of(cls, view: View, inches: tuple[float, float], dots: int) -> "Frame":
        """A frame with the given dots per inch."""
        wide, tall = 2 * view.half
        scale = dots * min(inches[0] / wide, inches[1] / tall)
        return cls(view, scale, (max(int(scale * wide), 50), max(int(scale * tall), 50)))

    def places(self, points: Array) -> Array:
        """Pixels to the right and downwards, and depth in pixels, of points (…, 3)."""
        view = self.view
        across = (points - view.centre) @ np.stack([view.right, -view.up, view.direction], axis=1)
        return self.scale * (across + np.array([*view.half, 0.0]))


def draw_space(
    stored: Stored,
    fields: tuple[str, ...],
    exaggeration: float,
    target: Path,
    caption: str,
    camera: tuple[float, float, float] | None = None,
    between: bool = False,
) -> list[str]:
    """Write a picture with a panel for each field; by VTK if Python has it and it draws.

    Parameters
    ----------
    between
        Whether bodies touch each other: then they are translucent in pictures of pressure. They are
        also translucent if most of the contact surface is hidden.

    Returns
    -------
    remarks
        Why VTK did not draw, if it is installed.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    skin = stored.skin()
    rows = np.concatenate([owners for _, owners in skin])
    outline = stored.points[sharp_edges(stored.points, [sides for sides, _ in skin])]
    moved = stored.points + exaggeration * stored.point_data.get("displacement", 0.0)
    seen = np.unique(np.concatenate([sides.ravel() for sides, _ in skin]))
    direction = _towards(stored) if camera is None else np.asarray(camera, dtype=float)
    view = view_from(direction, np.concatenate([stored.points[seen], moved[seen]]))
    inside = between or mostly_hidden(stored, [sides for sides, _ in skin], moved, view)
    faces = [sides + shifts(stored, owners)[:, None] for sides, owners in skin]
    moved, vertices = np.tile(moved, (copies(stored), 1)), np.tile(stored.vertices, copies(stored))
    panels = [panel_of(stored, name, faces, rows, inside) for name in fields]
    ratio = float(np.clip(view.half[1] / view.half[0], 0.1, 1.6))
    figure, places, wide = of_bodies(len(panels), ratio)
    frame = Frame.of(view, (wide, wide * ratio), SHARPNESS)
    skins = [skin_triangles(moved, faces, panel, frame, vertices) for panel in panels]
    lines, nodes = frame.places(outline), triangle_nodes(faces) % len(stored.points)
    drawn, reason = vtk_images.images(
        [drawing_of(*skin, nodes, lines, frame) for skin in zip(skins, panels, strict=True)]
    )
    images = drawn or [image_of(*skin, lines, frame) for skin in zip(skins, panels, strict=True)]
    for image, axes, panel in zip(images, places, panels, strict=True):
        axes.imshow(image, interpolation="antialiased")
        shades = ScalarMappable(Normalize(*panel.limits), panel.colours)
        bar = figure.colorbar(
            shades, ax=axes, location="bottom", label=panel.label, shrink=0.75, aspect=30,
            pad=0.02, extend="max" if panel.exceeds else "neither",
        )  # fmt: skip
        bar.formatter.set_powerlimits((-3, 4))
    figure.suptitle(caption, fontsize=12)
    figure.savefig(target, dpi=150, format="png")
    return [f"bodies are drawn without VTK, which does not draw here: {reason}"] if reason else []


def panel_of(stored: Stored, name: str, faces: list[Ints], rows: Ints, inside: bool) -> Panel:
    """Panel of a field: its values and colours on the skin, and its caption."""
    stress, label = name in STRESSES, LABELS.get(name, name)
    name = smooth_name(stored, name)
    at_nodes = name in stored.point_data
    values = node_values(stored, name) if at_nodes else stored.cell_data[name][rows]
    if values.ndim == 2:
        values = np.linalg.norm(values, axis=1)
    if name.endswith("contact_pressure"):
        values = np.where(np.tile(touchable(stored), copies(stored)), values, np.nan)
    shown = means = values
    if at_nodes:
        shown = values[np.unique(np.concatenate([sides.ravel() for sides in faces]))]
        means = np.concatenate([values[sides].mean(axis=1) for sides in faces])
    largest = float(np.nanmax(stored.field(name), initial=-np.inf))
    low, high = limits(shown)
    most = float(np.nanquantile(means, 1.0 - EXTREME)) if stress or not at_nodes else high
    if high - low > 1.3 * (most - low) > 0.0:
        high = most
    exceeds = bool(np.isfinite(largest) and largest > high * (1.0 + 1e-12))
    if exceeds:
        label = f"{label} (largest {largest:.4g})"
    colours = "viridis" if stress or not at_nodes else "magma_r"
    through = inside and (name == "gap" or name.endswith("contact_pressure"))
    return Panel(values, (low, high), exceeds, colours, label, through)


def mostly_hidden(stored: Stored, faces: list[Ints], points: Array, view: View) -> bool:
    """Whether most of the contact surface is hidden."""
    pressure = stored.point_data.get("contact_pressure")
    if pressure is None or not (pressure > 0.0).any():
        return False
    frame = Frame.of(view, (1.0, 1.0), COARSE)
    places, may = frame.places(points), touchable(stored)
    corners, pressed = [], []
    for sides in faces:
        on = may[sides].all(axis=1) & (pressure[sides] > 0.0).any(axis=1)
        for pick, _ in _HALVES[sides.shape[1]]:
            corners.append(places[sides[:, pick]])
            pressed.append(on)
    return visible_share(np.concatenate(corners), np.concatenate(pressed), *frame.size) < 0.5


def _towards(stored: Stored) -> Array:
    """Direction to a camera from which the bodies and their contacts are visible."""
    direction = np.array([1.2, -1.0, 0.6])
    touched = touchable(stored) if "contact_pressure" in stored.point_data else np.zeros(0, bool)
    if touched.any():
        low, high = stored.points.min(axis=0), stored.points.max(axis=0)
        half = np.maximum(0.5 * (high - low), 1e-12)
        side = (stored.points[touched].mean(axis=0) - 0.5 * (low + high)) / half
        # If a whole face may touch, its mean is ±1; several faces share the rest.
        beside = np.abs(side) > 0.5 * np.abs(side).max()
        direction = np.where(beside, 1.4 * np.sign(side) * np.abs(direction), direction)
    return direction


def view_from(direction: Array, points: Array) -> View:
    """The closest view along a direction that shows all points; z is up if possible."""
    direction = direction / np.linalg.norm(direction)
    upwards = np.array([0.0, 0.0, 1.0] if abs(direction[2]) < 1.0 - 1e-9 else [0.0, 1.0, 0.0])
    right = np.cross(upwards, direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    across = points @ np.stack([right, up], axis=1)
    low, high = across.min(axis=0), across.max(axis=0)
    middle = 0.5 * (low + high)
    depth = float((points @ direction).mean())
    centre = middle[0] * right + middle[1] * up + depth * direction
    return View(direction, up, right, centre, np.maximum(0.51 * (high - low), 1e-12))


def sharp_edges(points: Array, faces: list[Ints]) -> Ints:
    """Edges (n, 2) between faces at an angle of more than `SHARP`, or of one face alone."""
    pairs, owners, normals = [], [], []
    start = 0
    for sides in faces:
        around = np.stack([sides, np.roll(sides, -1, axis=1)], axis=2)
        pairs.append(np.sort(around.reshape(-1, 2), axis=1))
        owners.append(np.repeat(np.arange(start, start + len(sides)), sides.shape[1]))
        normals.append(_normals(points, sides))
        start += len(sides)
    edges, owner, normal = (np.concatenate(part) for part in (pairs, owners, normals))
    order = np.lexsort(edges.T[::-1])
    edges, owner = edges[order], owner[order]
    first = np.flatnonzero(np.r_[True, (edges[1:] != edges[:-1]).any(axis=1)])
    last = np.r_[first[1:], len(edges)] - 1
    cosine = np.sum(normal[owner[first]] * normal[owner[last]], axis=1)
    return edges[first[(first == last) | (cosine < np.cos(np.radians(SHARP)))]]


def _normals(points: Array, sides: Ints) -> Array:
    """Unit normals (n, 3) of faces, outwards."""
    a, b, c, d = (points[sides[:, i]] for i in (0, 1, 2, -1))
    normals = np.cross(b - a, c - a) if sides.shape[1] == 3 else np.cross(c - a, d - b)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def corner_normals(points: Array, faces: list[Ints]) -> list[Array]:
    """Unit normals (n, corners, 3) at the corners of faces.

    They are means over the faces at the node without a sharp edge to the face, so that curved
    surfaces look smooth.
    """
    normals = [_normals(points, sides) for sides in faces]
    of_face = np.concatenate(
        [np.repeat(n, f.shape[1], axis=0) for n, f in zip(normals, faces, strict=True)]
    )
    node = np.concatenate([sides.ravel() for sides in faces])
    order = np.argsort(node, kind="stable")
    _, first, count = np.unique(node[order], return_index=True, return_counts=True)
    first, count = np.repeat(first, count), np.repeat(count, count)
    place, sums = np.arange(len(node)) - first, np.zeros_like(of_face)
    for shift in range(count.max(initial=0)):
        other = of_face[order[first + (place + shift) % count]]
        smooth = np.einsum("ni,ni->n", of_face[order], other) >= np.cos(np.radians(SHARP))
        sums[order] += other * (smooth & (shift < count))[:, None]
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
    ends = np.cumsum([sides.size for sides in faces])[:-1]
    return [
        part.reshape(*sides.shape, 3)
        for part, sides in zip(np.split(sums, ends), faces, strict=True)
    ]


def triangle_nodes(faces: list[Ints]) -> Ints:
    """Nodes (n, 3) of the triangles of faces, in the order of `skin_triangles`."""
    return np.concatenate(
        [sides[:, pick] for sides in faces for pick, _ in _HALVES[sides.shape[1]]]
    )


def drawing_of(
    triangles: Triangles, panel: Panel, nodes: Ints, outline: Array, frame: Frame
) -> dict[str, Any]:
    """Arrays for VTK of what `image_of` draws, by the names of `vtk_images.images`."""
    from matplotlib import colormaps

    ends = triangles.corners[:, [[1, 2], [2, 0], [0, 1]]]  # of the edges opposite to the corners
    seen = (drawn_edges(triangles) > 0.5) & ~(triangles.bare & panel.through)[:, None]
    return {
        "corners": triangles.corners,
        "nodes": nodes,
        "values": triangles.values,
        "edges": ends[seen],
        "outline": outline,
        "colours": colormaps[panel.colours](np.linspace(0.0, 1.0, 256))[:, :3],
        "limits": panel.limits,
        "light": LIGHT,
        "bright": (AMBIENT, DIFFUSE),
        "size": frame.size,
        "bare": BARE,
        "grey": GREY,
        "crease": SHARP,
        "veil": VEIL if panel.through else 1.0,
    }


def image_of(triangles: Triangles, panel: Panel, outline: Array, frame: Frame) -> Array:
    """Image (height, width, 3) of a panel; lines (n, 2, 3) in pixels."""
    from matplotlib import colormaps

    bare = triangles.bare
    toward = triangles.towards
    veiled = bare & toward if panel.through else np.zeros(len(bare), bool)
    opaque = triangles.some(~bare if panel.through else toward)
    buffer = DepthBuffer(*frame.size)
    buffer.add(opaque.corners)
    pixel, triangle, shares = buffer.seen()
    values = np.einsum("ni,ni->n", shares, opaque.values[triangle])
    low, high = panel.limits
    colours = colormaps[panel.colours](np.clip((values - low) / (high - low), 0.0, 1.0))[:, :3]
    colours[np.isnan(values)] = BARE
    bright = np.einsum("ni,ni->n", shares, opaque.bright[triangle])
    bright *= 1.0 - (1.0 - WIRE) * wires(opaque, triangle, shares)
    image = np.ones((frame.size[0] * frame.size[1], 3))
    image[pixel] = np.minimum(colours * bright[:, None], 1.0)
    image[_line_pixels(outline, buffer)] = GREY
    if veiled.any():
        veil = triangles.some(veiled)
        count, bright = buffer.in_front(veil.corners, veil.bright.mean(axis=1))
        left = ((1.0 - VEIL) ** count)[:, None]
        image = left * image + (1.0 - left) * np.minimum(np.outer(bright, BARE), 1.0)
    return image.reshape(frame.size[1], frame.size[0], 3)


def skin_triangles(
    points: Array, faces: list[Ints], panel: Panel, frame: Frame, vertices: Mask
) -> Triangles:
    """The skin in pixel coordinates; quadrilaterals in two halves, with edges for few faces.

    Of the pieces of second-order sides those edges are drawn that end at one of the `vertices` of
    cells, (nodes,).
    """
    places, view = frame.places(points), frame.view
    few = sum(map(len, faces)) <= EDGES_UP_TO
    corners, values, bright, wired = [], [], [], []
    start = 0
    for sides, normals in zip(faces, corner_normals(points, faces), strict=True):
        light = AMBIENT + DIFFUSE * np.maximum(normals @ view.light, 0.0)
        at_corners = _at_corners(panel, points, sides, start)
        if panel.through:  # visible from both sides, with the colours of the scale
            light[np.isfinite(at_corners).all(axis=1)] = 1.0
        for pick, edges in _HALVES[sides.shape[1]]:
            corners.append(places[sides[:, pick]])
            values.append(at_corners[:, pick])
            bright.append(light[:, pick])
            ends = vertices[sides[:, pick]]
            wired.append(edges & (np.roll(ends, 1, axis=1) | np.roll(ends, -1, axis=1)))
        start += len(sides)
    return Triangles(
        np.concatenate(corners), np.concatenate(values), np.concatenate(bright),
        np.concatenate(wired) & few,
    )  # fmt: skip


_HALVES = {
    3: (([0, 1, 2], (True, True, True)),),
    4: (([0, 1, 2], (True, False, True)), ([0, 2, 3], (True, True, False))),
}
"""Corners of the triangles of a face; whether the edge opposite to each is one of the face."""


def _at_corners(panel: Panel, points: Array, sides: Ints, start: int) -> Array:
    """Values at the corners of faces, of which `start` is the first, (faces, corners)."""
    if len(panel.values) == len(points):
        return panel.values[sides]
    of_cells = panel.values[start : start + len(sides), None]
    return np.broadcast_to(of_cells, sides.shape)


def _line_pixels(ends: Array, buffer: DepthBuffer) -> Ints:
    """Visible pixels of lines (n, 2, 3)."""
    if not len(ends):
        return np.zeros(0, np.int64)
    length = np.linalg.norm(ends[:, 1, :2] - ends[:, 0, :2], axis=1)
    counts = np.ceil(1.5 * length).astype(np.int64) + 1
    line = np.repeat(np.arange(len(ends)), counts)
    step = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
    along = (step / np.maximum(counts[line] - 1, 1))[:, None]
    at = (1.0 - along) * ends[line, 0] + along * ends[line, 1]
    pixels = []
    for shift in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = (np.floor(at[:, :2]).astype(np.int64) + shift).T
        inside = (column >= 0) & (column < buffer.width) & (row >= 0) & (row < buffer.height)
        pixel = row[inside] * buffer.width + column[inside]
        pixels.append(pixel[at[inside, 2] > buffer.depth[pixel] - 0.5 * buffer.level])
    return np.concatenate(pixels)
