"""Images of triangles in space by a depth buffer, in NumPy alone.

Each triangle is divided into the pixels it covers; each pixel stores the triangle nearest to the
camera, so that hidden parts are right also for interlocking triangles. Colours are computed
afterwards, from values interpolated within the triangle. Translucent triangles in front of opaque
ones are counted: k of them, each hiding a share v, leave (1 - v)ᵏ of the colour, in any order.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from meshes.arrays import Array, Ints, Mask

AT_ONCE = 2_000_000
"""Number of pixels processed at once."""

INSIDE = -1e-9
"""Smallest barycentric coordinate of a pixel in a triangle."""

LEVEL = 2e-3
"""Difference in depth, over the size of the picture, up to which two faces lie on each other."""

WIRE = 0.8
"""Brightness of the edges of faces, over that of the faces."""

WIDE = 0.8
"""Half the width of these edges in pixels; faces less than ten times as high have faint ones, and
those of half this height none."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles in pixel coordinates."""

    corners: Array  # (n, 3, 3)
    """Pixels to the right, pixels downwards, and depth towards the eye in pixels."""
    values: Array  # (n, 3)
    """At the corners; NaN where the body is bare."""
    bright: Array  # (n, 3)
    """Brightness at the corners."""
    wired: Mask  # (n, 3)
    """Whether the edge opposite each corner is drawn."""

    def some(self, chosen: Mask) -> "Triangles":
        """Some of the triangles."""
        return Triangles(
            self.corners[chosen], self.values[chosen], self.bright[chosen], self.wired[chosen]
        )

    @property
    def towards(self) -> Mask:
        """Mask (n,) of triangles that face the camera."""
        return np.asarray(_twice_area(self.corners) < 0.0)

    @property
    def bare(self) -> Mask:
        """Mask (n,) of triangles without a value at some corner."""
        return np.asarray(np.isnan(self.values).any(axis=1))


class DepthBuffer:
    """The nearest triangle in each pixel.

    Attributes
    ----------
    depth : (pixels,)
        -∞ where nothing is seen.
    triangle : (pixels,)
        -1 where nothing is seen.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.depth = np.full(width * height, -np.inf)
        self.triangle = np.full(width * height, -1, np.int64)
        self._shares = np.zeros((width * height, 3), np.float32)

    @property
    def level(self) -> float:
        """Depth up to which faces lie on each other."""
        return LEVEL * max(self.width, self.height)

    def add(self, corners: Array) -> None:
        """Draw opaque triangles (n, 3, 3), once."""
        for pixel, triangle, shares, depth in self._fragments(corners):
            near = depth > self.depth[pixel]
            order = np.flatnonzero(near)[np.argsort(depth[near], kind="stable")]
            pixel = pixel[order]  # of several at a pixel the last one, the nearest, stays
            self.depth[pixel], self.triangle[pixel] = depth[order], triangle[order]
            self._shares[pixel] = shares[order]

    def in_front(self, corners: Array, bright: Array) -> tuple[Array, Array]:
        """Number of triangles in front of the drawn ones, and their mean brightness, by pixel."""
        count, sums = np.zeros((2, len(self.depth)))
        for pixel, triangle, _, depth in self._fragments(corners):
            near = depth > self.depth[pixel] + self.level
            count += np.bincount(pixel[near], minlength=len(count))
            sums += np.bincount(pixel[near], bright[triangle[near]], len(count))
        return count, sums / np.maximum(count, 1.0)

    def seen(self) -> tuple[Ints, Ints, Array]:
        """Pixels (k,) in which something was drawn, the triangles (k,), and shares (k, 3)."""
        pixel = np.flatnonzero(self.triangle >= 0)
        return pixel, self.triangle[pixel], self._shares[pixel].astype(float)

    def _fragments(self, corners: Array) -> Iterator[tuple[Ints, Ints, Array, Array]]:
        """Yield pixels, triangles, barycentric coordinates and depths, some triangles at a time."""
        x, y = corners[:, :, 0], corners[:, :, 1]
        size = np.array([self.width, self.height])
        first = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5), 0, size).astype(np.int64)
        last = np.clip(np.floor(corners[:, :, :2].max(axis=1) - 0.5), -1, size - 1)
        wide, high = np.maximum(last.astype(np.int64) - first + 1, 0).T
        counts = np.where(np.abs(_twice_area(corners)) > 1e-12, wide * high, 0)
        some = np.flatnonzero(counts)
        ends = np.cumsum(counts[some])
        begin = 0
        while begin < len(some):
            before = ends[begin - 1] if begin else 0
            end = max(begin + 1, int(np.searchsorted(ends, before + AT_ONCE)))
            part = some[begin:end]
            begin = end
            triangle = np.repeat(part, counts[part])
            starts = np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
            within = np.arange(len(triangle)) - starts
            column = first[triangle, 0] + within % wide[triangle]
            row = first[triangle, 1] + within // wide[triangle]
            shares = _shares(x[triangle], y[triangle], column + 0.5, row + 0.5)
            inside = (shares >= INSIDE).all(axis=1)
            triangle, shares = triangle[inside], shares[inside]
            depth = np.einsum("ni,ni->n", shares, corners[triangle, :, 2])
            yield row[inside] * self.width + column[inside], triangle, shares, depth


def _twice_area(corners: Array) -> Array:
    """Twice the signed area of triangles (n, 3, 2 or more); negative if they face the camera."""
    first, second = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _shares(x: Array, y: Array, at_x: Array, at_y: Array) -> Array:
    """Barycentric coordinates (n, 3) of places in triangles (n, 3)."""
    a = (x[:, 1] - at_x) * (y[:, 2] - at_y) - (x[:, 2] - at_x) * (y[:, 1] - at_y)
    b = (x[:, 2] - at_x) * (y[:, 0] - at_y) - (x[:, 0] - at_x) * (y[:, 2] - at_y)
    c = (x[:, 0] - at_x) * (y[:, 1] - at_y) - (x[:, 1] - at_x) * (y[:, 0] - at_y)
    return np.stack([a, b, c], axis=1) / (a + b + c)[:, None]


def wires(triangles: Triangles, triangle: Ints, shares: Array) -> Array:
    """How much of a drawn edge pixels in triangles show, with their shares (n, 3), from 0 to 1."""
    near = shares * _heights(triangles.corners)[triangle] < WIDE
    return np.asarray((near * drawn_edges(triangles)[triangle]).max(axis=1))


def drawn_edges(triangles: Triangles) -> Array:
    """Strength (n, 3) of the edges opposite to corners, from 0, not drawn, to 1.

    Edges of low triangles are faint, so that a fine mesh does not blacken its surface.
    """
    low = _heights(triangles.corners).min(axis=1, keepdims=True) / (10.0 * WIDE)
    return np.asarray(np.clip(2.0 * low * triangles.wired - 1.0, 0.0, 1.0))


def _heights(corners: Array) -> Array:
    """Heights (n, 3) of triangles in pixels, over the edges opposite to their corners."""
    ends = corners[:, :, :2]
    sides = np.linalg.norm(np.roll(ends, -1, axis=1) - np.roll(ends, 1, axis=1), axis=2)
    return np.asarray(np.abs(_twice_area(ends))[:, None] / np.maximum(sides, 1e-12))


def visible_share(corners: Array, chosen: Mask, width: int, height: int) -> float:
    """Share of the pixels of chosen triangles (n,) that other triangles do not hide."""
    alone, all_of_them = DepthBuffer(width, height), DepthBuffer(width, height)
    alone.add(corners[chosen])
    all_of_them.add(corners)
    pixel, _, _ = alone.seen()
    hidden = all_of_them.depth[pixel] > alone.depth[pixel] + all_of_them.level
    return 1.0 - float(hidden.mean()) if len(pixel) else 1.0
