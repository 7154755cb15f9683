"""Pseudo-inverses of many small symmetric matrices of which most are equal, as on grids."""

import numpy as np

from meshes.arrays import Array

DIGITS = 9
"""Decimal places of sums of entries in which equal matrices agree."""


def pseudo_inverses(matrices: Array, rcond: float) -> Array:
    """Pseudo-inverses of symmetric matrices (n, k, k) with entries of about one.

    Equal ones are inverted once. Two sums of their entries tell matrices apart: one sum took 2 of
    300,000 random ones for others.
    """
    entries = matrices.reshape(len(matrices), matrices.shape[1] ** 2)
    sums = entries @ np.random.default_rng(0).random((entries.shape[1], 2))
    keys = np.round(sums, DIGITS).view(complex)[:, 0]
    _, first, kind = np.unique(keys, return_index=True, return_inverse=True)
    inverses = np.linalg.pinv(matrices[first], rcond=rcond, hermitian=True)
    return np.asarray(inverses[kind.reshape(-1)])
