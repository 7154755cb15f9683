"""Rows that hold rigid motions which nothing else holds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SupportRows:
    """Extra rows of this rank.

    Attributes
    ----------
    copies : one (k,) array per row
        Copies of nodes, by their number on this rank.
    values : one (k, dimension) array per row
        Coefficients.
    """

    copies: list[NDArray[np.int64]] = field(default_factory=list)
    values: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, copies: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add a row with its copies (k,) and coefficients (k, dimension)."""
        self.copies.append(copies)
        self.values.append(values)
