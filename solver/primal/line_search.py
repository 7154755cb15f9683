"""The minimum along a line of a convex quadratic function with one-sided springs."""

from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from solver.vectors import Array

ACCURATE = 1e-10
"""Slope over that at t = 0, below which it counts as zero."""

LONGEST = 1e6
"""Largest length that is tried: the function may fall for ever but for rounding errors."""


def minimum_along(
    comm: MPI.Intracomm,
    rest: Callable[[float], tuple[float, float]],
    force: Array,
    rate: Array,
    image: Array,
) -> float:
    """The length t of least energy: the root of rest'(t) + Σ q max(0, s + t r) (collective).

    The slope does not fall. Newton's method from t = 1 finds the root once it comes to the right
    piece; bisection leads there.

    Parameters
    ----------
    rest
        Slope and curvature at t of the energy without springs, which is convex; this rank's share.
    force, rate, image : (springs,)
        s, the force of each spring at t = 0, negative where it is open; its rate r; and q, its
        elongation for t = 1.
    """

    def derivatives(t: float) -> tuple[float, float]:
        """Slope and curvature of the energy at t."""
        push = force + t * rate
        pressing = push > 0.0
        sums = np.array([image @ np.where(pressing, push, 0.0), (image * rate) @ pressing])
        slope, curvature = comm.allreduce(sums + rest(t))
        return float(slope), float(curvature)

    small = ACCURATE * abs(derivatives(0.0)[0])
    low, high, t = 0.0, np.inf, 1.0
    for _ in range(60):
        value, bend = derivatives(t)
        if abs(value) <= small:
            break
        low, high = (t, high) if value < 0.0 else (low, t)
        if low >= LONGEST:
            break
        newton = t - value / bend if bend > 0.0 else np.inf
        if low < newton < min(high, LONGEST):
            t = newton
        else:
            t = 0.5 * (low + high) if high < np.inf else 2.0 * t
    return t
