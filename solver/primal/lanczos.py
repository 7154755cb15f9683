"""The smallest Ritz value from the step lengths of conjugate gradients."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal


class Lanczos:
    """Lanczos' tridiagonal matrix of conjugate gradients.

    Attributes
    ----------
    lengths
        Lengths of the steps so far.
    squares
        rᵀ M⁻¹ r before the first step and after each.
    """

    def __init__(self, square: float) -> None:
        self.lengths: list[float] = []
        self.squares = [square]
        self._ended = not square > 0.0

    def add(self, length: float, square: float) -> None:
        """One more step.

        The matrix ends at a step of rounding errors, whose length or residual is no finite number.
        """
        if self._ended or not (length > 0.0 and square > 0.0):
            self._ended = True
            return
        self.lengths.append(length)
        self.squares.append(square)

    def smallest_ritz_value(self) -> float:
        """The smallest Ritz value: the smallest eigenvalue of the tridiagonal matrix."""
        lengths, squares = np.array(self.lengths), np.array(self.squares[:-1])
        ratios = squares[1:] / squares[:-1]
        diagonal = 1.0 / lengths
        diagonal[1:] += ratios / lengths[:-1]
        off = np.sqrt(np.maximum(ratios, 0.0)) / lengths[:-1]
        return float(eigvalsh_tridiagonal(diagonal, off, select="i", select_range=(0, 0))[0])
