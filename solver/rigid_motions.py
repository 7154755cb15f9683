"""Rigid motions of points: three in the plane, six in space."""

import numpy as np

from solver.vectors import Array

MOTIONS = {2: 3, 3: 6}
"""Rigid motions by dimension."""


def rigid_motions(points: Array, dimension: int, centre: Array, length: float) -> Array:
    """Displacements of points under each rigid motion.

    Parameters
    ----------
    points : (n, 3)
        Coordinates; the third is zero in the plane.
    centre, length
        Rotations turn about `centre` and are divided by `length`, so that all motions have the
        same unit.

    Returns
    -------
    (n, dimension, motions): translations first, then rotations (about z in the plane; about x,
    y and z in space).
    """
    x = (points - centre) / length
    motions = np.zeros((len(points), dimension, MOTIONS[dimension]))
    for axis in range(dimension):
        motions[:, axis, axis] = 1.0
    if dimension == 2:
        motions[:, 0, 2], motions[:, 1, 2] = -x[:, 1], x[:, 0]
    else:
        for k, (a, b) in enumerate(((1, 2), (2, 0), (0, 1)), start=3):
            motions[:, a, k], motions[:, b, k] = -x[:, b], x[:, a]
    return motions
