"""The minimum along a line of a convex quadratic function with one-sided springs."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

Array = NDArray[np.float64]

ACCURATE = 1e-10
"""Slope at the end of a full step over that at its beginning, up to which the step is not changed.
"""


def minimum_along(
    comm: MPI.Intracomm, slope: float, curvature: float, force: Array, rate: Array, image: Array
) -> float:
    """The length t of least energy: the root of slope + curvature t + Σ q max(0, s + t r).

    The function is piecewise linear and does not fall (collective).

    Parameters
    ----------
    slope, curvature
        Of the part without springs, along the line.
    force, rate, image : (springs,)
        s, the force of each spring at t = 0, negative where it is open; its rate r; and q, its
        elongation for t = 1.
    """

    def rising(t: float) -> float:
        push = float(comm.allreduce(float(image @ np.maximum(force + t * rate, 0.0))))
        return slope + curvature * t + push

    low, high = 0.0, 1.0
    while rising(high) < 0.0 and high < 1e6:
        low, high = high, 4.0 * high
    if low == 0.0 and abs(rising(1.0)) <= ACCURATE * abs(rising(0.0)):
        return 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rising(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)
