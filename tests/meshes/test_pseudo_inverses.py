"""Pseudo-inverses of matrices of which some are equal."""

import numpy as np

from meshes.pseudo_inverses import pseudo_inverses


def test_pseudo_inverses_of_matrices_with_equal_plain_sums() -> None:
    """Also singular ones; a permutation of the entries has the same plain sum."""
    random = np.random.default_rng(2)
    columns = random.random((50, 4, 3))
    matrices = columns @ np.swapaxes(columns, 1, 2)
    turned = matrices[:, ::-1, ::-1]
    every = np.concatenate([matrices, turned, matrices, np.zeros((3, 4, 4))])
    expected = np.linalg.pinv(every, rcond=1e-8, hermitian=True)
    np.testing.assert_allclose(pseudo_inverses(every, 1e-8), expected, rtol=1e-6, atol=1e-6)
    assert pseudo_inverses(every[:0], 1e-8).shape == (0, 4, 4)


def test_pseudo_inverses_of_many_different_matrices() -> None:
    """One sum of nine digits took two of them for others."""
    random = np.random.default_rng(1)
    diagonals = 1.0 + random.random((300_000, 2))
    inverses = pseudo_inverses(diagonals[:, :, None] * np.eye(2), 1e-8)
    products = inverses * diagonals[:, :, None]
    np.testing.assert_allclose(products, np.tile(np.eye(2), (300_000, 1, 1)), atol=1e-7)
