"""Factors of rows that share nodes."""

import numpy as np
from scipy import sparse

from solver.tfeti.coupled import FactorOfParts


def test_equal_parts_share_a_factor() -> None:
    """Three parts of M, two of them equal but for a row that is not free."""
    random = np.random.default_rng(3)
    one, other = (0.1 * random.random((5, 5)) for _ in range(2))
    blocks = [part + part.T + np.eye(5) for part in (one, one, other)]
    M = sparse.block_diag(blocks, format="csc")
    order = random.permutation(5)
    mixed = np.argsort(np.concatenate([order, order, order]) * 3 + np.repeat(range(3), 5))
    M, values, factor = M[mixed][:, mixed], random.random(15), FactorOfParts(M[mixed][:, mixed])
    for held in ([], [4]):
        free = ~np.isin(np.arange(15), held)
        expected = np.zeros(15)
        expected[free] = np.linalg.solve(M.toarray()[free][:, free], values[free])
        np.testing.assert_allclose(factor.solve(values, free), expected, atol=1e-14)
