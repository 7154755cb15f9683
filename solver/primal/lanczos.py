"""Ritz values: estimates of the smallest and of the largest eigenvalue."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.linalg import eigvalsh_tridiagonal

from solver.primal.products import multiply
from solver.vectors import Array


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


def largest_eigenvalue(K: PETSc.Mat, flexibility: Array, steps: int = 10) -> float:
    """The largest Ritz value of D⁻¹ K after some steps, as many as PETSc takes (collective).

    Parameters
    ----------
    flexibility : (unknowns,)
        D⁻¹.
    """
    comm: MPI.Intracomm = K.comm.tompi4py()
    root = np.sqrt(flexibility)
    w = root * np.random.default_rng(comm.rank).uniform(-1.0, 1.0, len(root))
    v, length = np.zeros_like(w), float(np.sqrt(comm.allreduce(w @ w)))
    diagonal: list[float] = []
    lengths: list[float] = []
    while length > 0.0 and len(diagonal) < steps:
        before, v = v, w / length
        w = root * multiply(K, root * v) - length * before
        diagonal.append(float(comm.allreduce(w @ v)))
        w -= diagonal[-1] * v
        length = float(np.sqrt(comm.allreduce(w @ w)))
        lengths.append(length)
    if not diagonal:
        return 1.0
    return float(eigvalsh_tridiagonal(np.array(diagonal), np.array(lengths[:-1]))[-1])
