"""Similar subdomains: one stiffness is a multiple of another one with permuted axes.

The stiffness of a box of 5 × 5 × 6 cubes is that of 6 × 5 × 5 cubes with two axes exchanged, and by
K ∝ E h^(d-2) that of a box with other cells or another modulus is a multiple of it:

    K = γ Q K₁ Qᵀ,    K⁺ = Q K₁⁺ Qᵀ / γ,

where Q is the permutation of the nodes and of the components of each. If the interface unknowns of
one are numbered as the images of those of the other, their dense blocks of K⁺ are equal but for γ.
A box whose cells do not divide evenly has eight sizes of sub-boxes, but only four or six of them
are not similar; tied boxes of one material may share all of them.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from solver.tfeti.subdomain.generalised_inverse import Block, Inverse
from solver.tfeti.subdomain.reflections import TOLERANCE
from solver.vectors import Array, Ints


@dataclass(frozen=True, eq=False)
class Similarity:
    """K = γ Q K₁ Qᵀ."""

    image: Ints  # (n,)
    """The unknown to which Q moves each unknown of K₁."""
    factor: float
    """γ."""

    def moved(self, values: Array) -> Array:
        """Q times each column, (n, columns)."""
        result = np.empty_like(values)
        result[self.image] = values
        return result

    def back(self, unknowns: Ints) -> Ints:
        """The unknowns of K₁ that Q moves to some unknowns."""
        return np.argsort(self.image)[unknowns]

    def stiffness(self, matrix: sparse.csr_matrix) -> sparse.csr_matrix:
        """γ Q K₁ Qᵀ."""
        moved = matrix[np.argsort(self.image)]
        result = sparse.csr_matrix(
            (self.factor * moved.data, self.image[moved.indices], moved.indptr), shape=matrix.shape
        )
        result.sort_indices()
        return result


class Shape:
    """A subdomain as it is compared with others.

    Parameters
    ----------
    stiffness : (n, n)
    points : (nodes, 3)
        Coordinates; unknown ``node * dimension + component``.
    """

    def __init__(self, stiffness: sparse.csr_matrix, points: Array, dimension: int) -> None:
        self.stiffness, self.dimension = stiffness, dimension
        lower, upper = points.min(axis=0), points.max(axis=0)
        self.extent = (upper - lower)[:dimension]
        self.size = float(self.extent.max())
        self.places = (points - 0.5 * (lower + upper))[:, :dimension] / self.size
        self.mean = float(stiffness.diagonal().mean())

    def similarity(self, other: "Shape") -> Similarity | None:
        """The similarity to another one with as many nodes; None without one."""
        d, factor = self.dimension, other.mean / self.mean
        factor = 1.0 if abs(factor - 1.0) <= TOLERANCE else factor
        for axes in permutations(range(d)):
            # component c becomes component axes[c]
            order = np.argsort(axes)
            extent = self.extent[order] / self.size
            if np.abs(extent - other.extent / other.size).max() > TOLERANCE:
                continue
            distance, node = cKDTree(other.places).query(self.places[:, order])
            if distance.max() > TOLERANCE or len(np.unique(node)) < len(node):
                continue
            similarity = Similarity((node[:, None] * d + np.array(axes)).ravel(), factor)
            if self._is(similarity, other):
                return similarity
        return None

    def _is(self, similarity: Similarity, other: "Shape") -> bool:
        """Whether a similarity holds for a product with random displacements."""
        probe = np.random.default_rng(0).standard_normal(self.stiffness.shape[0])
        expected = similarity.factor * similarity.moved(self.stiffness @ probe)
        forces = other.stiffness @ similarity.moved(probe)
        return bool(np.abs(forces - expected).max() <= TOLERANCE * np.abs(forces).max())


class MovedInverse:
    """Q K₁⁺ Qᵀ / γ (protocol `Inverse`)."""

    def __init__(self, inverse: Inverse, similarity: Similarity) -> None:
        self._inverse, self._similarity = inverse, similarity

    def solve(self, loads: Array) -> Array:
        """K⁺ times each column: (n, columns) to (n, columns), both in Fortran order."""
        image, factor = self._similarity.image, self._similarity.factor
        solved = self._inverse.solve(np.asfortranarray(loads[image]))
        result = np.empty_like(solved)
        result[image] = solved / factor
        return result


class ScaledBlock:
    """A multiple of a block (protocol `Block`)."""

    def __init__(self, block: Block, factor: float) -> None:
        self._block, self._factor = block, factor

    def apply(self, loads: Array, out: Array) -> None:
        """Apply the block to vectors, one row per member: (s, m) to (s, m)."""
        self._block.apply(loads, out)
        out *= self._factor

    @property
    def schur_complement(self) -> "ScaledBlock":
        """The Schur complement of the stiffness on the same unknowns, (m, m)."""
        return ScaledBlock(self._block.schur_complement, 1.0 / self._factor)
