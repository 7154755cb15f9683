"""Rows that hold rigid motions: those nothing else holds, and those that are held on request."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SupportRows:
    """Extra rows of this rank.

    Attributes
    ----------
    copies : one (k,) array a row
        Copies of nodes, by their number on this rank.
    values : one (k, dimension) array a row
        Coefficients.
    bodies : one a row
        The body that asked for it; -1 where none did.
    points : one (k, 3) array a row
        Where the nodes are; empty where no body asked for the row.
    """

    copies: list[NDArray[np.int64]] = field(default_factory=list)
    values: list[NDArray[np.float64]] = field(default_factory=list)
    bodies: list[int] = field(default_factory=list)
    points: list[NDArray[np.float64]] = field(default_factory=list)

    def add(
        self,
        copies: NDArray[np.int64],
        values: NDArray[np.float64],
        body: int = -1,
        points: NDArray[np.float64] | None = None,
    ) -> None:
        """Add a row; with the body and the places of its nodes where one asked for it."""
        self.copies.append(copies)
        self.values.append(values)
        self.bodies.append(body)
        self.points.append(np.zeros((0, 3)) if points is None else points)
