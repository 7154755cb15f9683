"""Subdomains whose axes are exchanged share one factor.

A box of 4 × 5 × 5 equal cells becomes one of 5 × 4 × 5 if x and y are exchanged. Let T be the
permutation that takes the unknowns of the first to those of the second: nodes change places, and
so do the components of a node. Of an isotropic material the stiffness of the second is T K Tᵀ, so
its generalised inverse is T K⁺ Tᵀ, and K⁺ on the interface is the same matrix if the interface
unknowns have the order of their images. Boxes that do not divide into equal parts have half as many
factors, or fewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from solver.tfeti.subdomain.generalised_inverse import Inverse
from solver.tfeti.subdomain.reflections import TOLERANCE


@dataclass(frozen=True, eq=False)
class RelabelledInverse:
    """T K⁺ Tᵀ (protocol `Inverse`).

    Attributes
    ----------
    inverse
        K⁺.
    image : (n,)
        Unknown to which T takes each unknown.
    """

    inverse: Inverse
    image: NDArray[np.int64]

    def solve(self, loads: NDArray[np.float64]) -> NDArray[np.float64]:
        """T K⁺ Tᵀ times each column: (n, columns) to (n, columns), both in Fortran order."""
        result = np.empty(loads.shape, order="F")
        result[self.image] = self.inverse.solve(np.asfortranarray(loads[self.image]))
        return result


def exchange_of_axes(
    first: tuple[sparse.csr_matrix, NDArray[np.float64]],
    second: tuple[sparse.csr_matrix, NDArray[np.float64]],
    dimension: int,
) -> NDArray[np.int64] | None:
    """The second subdomain's unknown for each unknown of the first; None where they differ.

    Parameters
    ----------
    first, second
        Stiffness (n, n) and points (nodes, 3) of two subdomains. An exchange of axes that takes the
        points of the first to those of the second is tested on the stiffness with random
        displacements.
    """
    (K, points), (other, targets) = first, second
    if K.shape != other.shape or K.nnz != other.nnz:
        return None
    x, y = (p - 0.5 * (p.min(axis=0) + p.max(axis=0)) for p in (points, targets))
    extents, length = np.ptp(y, axis=0)[:dimension], float(np.abs(y).max())
    for axes in permutations(range(dimension)):
        exchanged = x.copy()
        exchanged[:, :dimension] = x[:, axes]
        sizes = np.ptp(exchanged, axis=0)[:dimension]
        if axes == tuple(range(dimension)) or np.abs(sizes - extents).max() > TOLERANCE * length:
            continue
        distance, node = cKDTree(y).query(exchanged)
        if distance.max() > TOLERANCE * length or len(np.unique(node)) < len(node):
            continue
        # component k of the image is component axes[k]
        image = (node[:, None] * dimension + np.argsort(axes)).ravel()
        probe = np.random.default_rng(0).standard_normal(K.shape[0])
        moved, expected = np.empty((2, K.shape[0]))
        moved[image], expected[image] = probe, K @ probe
        if np.abs(other @ moved - expected).max() <= TOLERANCE * np.abs(expected).max():
            return image
    return None
