"""The planes of symmetry at which a scene was cut."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from contact_app.scene.bodies import Body
from contact_app.scene.scene import Mirror
from meshes.arrays import Array, Mask

ON_PLANE = 1e-9
"""Distance from a plane, over the size of the scene, up to which a node lies on it."""


def on_planes(bodies: Sequence[Body], mirrors: Sequence[Mirror], points: Array) -> Mask:
    """Masks (planes, …) of the points (…, 3) on each plane of a scene."""
    ends = np.array([(b.mesh.lower, b.mesh.upper) for b in bodies])
    tolerance = ON_PLANE * float(np.ptp(ends, axis=(0, 1)).max())
    on = np.zeros((len(mirrors), *points.shape[:-1]), bool)
    for k, mirror in enumerate(mirrors):
        on[k] = np.abs(points[..., mirror.axis] - mirror.at) <= tolerance
    return on


def subsets(count: int) -> Iterator[tuple[int, ...]]:
    """All subsets of a number of planes, smaller ones first."""
    for size in range(count + 1):
        yield from combinations(range(count), size)
