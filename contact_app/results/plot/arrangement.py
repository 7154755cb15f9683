"""Arrangement of the panels of a picture in rows and columns, and their size."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from meshes.arrays import Array

WIDE = 3.0
"""Width over height that pictures of whole bodies come near to."""

PATCHES = 1.6
"""The same of pictures of contact patches."""

PANEL, SCALE = 6.0, 0.8
"""Width of a panel with bodies, and height of its colour scale, in inches."""

WIDTH, HEIGHT = 7.0, 8.0
"""Largest size of all patches together, in inches, without labels and colour scales."""

LABELS = 0.8
"""Inches that a patch has for its labels, in each direction."""


def columns(count: int, ratio: float, wanted: float) -> int:
    """Number of columns of panels that brings the picture near to a shape.

    Parameters
    ----------
    count
        Number of panels.
    ratio
        Height of a panel over its width.
    wanted
        Width of the picture over its height.
    """
    across = np.arange(1, count + 1)
    shapes = across / (ratio * np.ceil(count / across))
    return int(across[np.argmin(np.abs(np.log(shapes / wanted)))])


def of_bodies(count: int, ratio: float) -> tuple[Any, list[Any], float]:
    """A figure with a panel for each picture of the bodies, and the width of a panel in inches.

    Parameters
    ----------
    ratio
        Height of a panel over its width.
    """
    from matplotlib.figure import Figure

    across = columns(count, ratio, WIDE)
    down, wide = -(-count // across), PANEL if across > 1 else 1.5 * PANEL
    size = wide * across, down * (wide * ratio + SCALE) + 0.5
    figure = Figure(figsize=size, layout="constrained")
    figure.get_layout_engine().set(h_pad=0.1)  # inches; less cuts labels below tall bodies
    places = list(np.ravel(figure.subplots(down, across)))
    for axes in places:
        axes.set_axis_off()
    return figure, places[:count], wide


def of_patches(boxes: Sequence[Array]) -> tuple[tuple[int, int], tuple[float, float]]:
    """Rows and columns of flat patches, and the size of the picture in inches.

    Parameters
    ----------
    boxes : (2,) each
        Width and height of the patches, with their surroundings.
    """
    size = np.max(boxes, axis=0)
    across = columns(len(boxes), float(size[1] / size[0]), PATCHES)
    down = int(np.ceil(len(boxes) / across))
    scale = min(WIDTH / (across * size[0]), HEIGHT / (down * size[1]))
    wide, tall = scale * size + LABELS
    return (down, across), (float(across * wide + 1.5), float(down * tall + 0.8))
