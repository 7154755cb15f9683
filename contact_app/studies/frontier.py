"""Which runs nothing beats: the Pareto frontier of seconds and error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def frontier(seconds: ArrayLike, errors: ArrayLike) -> list[int]:
    """Points that no other point beats in both: none is as fast or faster with a smaller error.

    Of points equal in both the first is taken; those with a value that is not finite are no
    points.

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


def fastest_within(seconds: Sequence[float], errors: Sequence[float], target: float) -> int | None:
    """The fastest point whose error is at most the target, None where there is none."""
    good = [i for i, e in enumerate(errors) if e <= target]
    return min(good, key=lambda i: seconds[i]) if good else None
