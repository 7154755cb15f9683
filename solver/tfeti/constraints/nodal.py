"""Products with matrices whose coefficients are equal for each component of a node.

Gluing rows form such a matrix. It is A ⊗ I with A between nodes. A product of A with the components
as columns reads each entry once for all components, and A takes a third of the memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def nodal_rows(rows: sparse.csr_matrix, components: int) -> NDArray[np.int64]:
    """Mask of the rows in runs that have equal coefficients for each component of their nodes.

    Parameters
    ----------
    rows
        With sorted entries; column ``node * components + component``.
    """
    count = np.diff(rows.indptr)
    runs = np.arange(max(len(count) - components + 1, 0))
    for nth in range(1, components):
        runs = runs[count[runs + nth] == count[runs]]
    runs = runs[count[runs] > 0]
    runs = runs[rows.indices[rows.indptr[runs]] % components == 0]
    first = rows[runs]
    alike = first.indices % components == 0
    for nth in range(1, components):
        other = rows[runs + nth]
        alike &= (other.indices == first.indices + nth) & (other.data == first.data)
    if len(runs):
        runs = runs[np.logical_and.reduceat(alike, first.indptr[:-1])]
    return (runs[:, None] + np.arange(components)).ravel()


class NodalProduct:
    """A ⊗ I and its transpose, I between the components of a node; on one rank.

    Parameters
    ----------
    rows
        Rows, which all have to be `nodal_rows`.
    """

    def __init__(self, rows: sparse.csr_matrix, components: int) -> None:
        first = rows[::components]
        self._nodes = sparse.csr_matrix(
            (first.data, first.indices // components, first.indptr),
            shape=(first.shape[0], first.shape[1] // components),
        )
        self._transpose = self._nodes.T.tocsr()
        self._components = components

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put the product with x into out."""
        out[:] = (self._nodes @ x.reshape(-1, self._components)).ravel()

    def apply_transpose(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Put the product of the transpose with x into out."""
        out[:] = (self._transpose @ x.reshape(-1, self._components)).ravel()
