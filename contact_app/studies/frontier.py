"""The Pareto frontier of seconds and error."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def frontier(seconds: ArrayLike, errors: ArrayLike) -> list[int]:
    """Points of the frontier: no other point is at least as fast with a smaller error.

    Of points equal in both values only the first counts; points with a value that is not finite are
    left out.

    Returns
    -------
    list of int
        Their numbers, from the fastest to the most accurate.

    Examples
    --------
    >>> frontier([1, 2, 3, 4], [0.5, 0.2, 0.3, 0.1])
    [0, 1, 3]
    """
    t, e = np.asarray(seconds, float), np.asarray(errors, float)
    order = np.lexsort((np.arange(len(t)), e, t))
    result: list[int] = []
    best = np.inf
    for i in order[np.isfinite(t[order]) & np.isfinite(e[order])]:
        if e[i] < best:
            best = e[i]
            result.append(int(i))
    return result
