"""Reflection symmetry of a subdomain, which splits its inverse into small independent blocks.

A box of equal cells looks the same in the mirror: with S_a the signed permutation that reflects
along axis a (nodes change places, the component along a changes sign), S_a K S_aᵀ = K. The
reflections a subdomain has commute and form a group H of at most 2^d elements. For each character
χ of H, the displacements with S_h u = χ(h) u are a subspace that K maps into itself; orthonormal
bases V_χ of these subspaces turn K, and a generalised inverse that keeps the symmetry, into |H|
blocks of about n / |H| unknowns (Bossavit, *Symmetry, groups, and boundary value problems*, 1986).
A dense inverse then costs |H| times less to apply and to hold, and its factors much less.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

TOLERANCE = 1e-10
"""Relative difference at which two coordinates, or two products with K, are the same."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The reflections of a subdomain, as signed permutations of its unknowns.

    Attributes
    ----------
    images : (2^g, n)
        Where each element of the group takes each unknown; element h is the product of the
        generators whose bit is set in h, element 0 the identity.
    signs : (2^g, n)
        The sign it takes there.
    """

    images: NDArray[np.int64]
    signs: NDArray[np.int8]

    @property
    def order(self) -> int:
        """Elements of the group."""
        return len(self.images)

    def closure(self, unknowns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The unknowns and their mirror images, sorted."""
        return np.unique(self.images[:, unknowns])

    def average(self, stiffness: sparse.csr_matrix) -> sparse.csr_matrix:
        """The mean of S K Sᵀ over the group: K without the round-off that breaks the symmetry.

        Coordinates have round-off of their own, so cells that should be mirror images differ in
        their last digits; a slender body multiplies the difference by its condition.
        """
        h = 1
        while h < self.order:  # the generators are the elements with one bit set
            image, sign = self.images[h], self.signs[h].astype(float)
            S = sparse.csr_matrix((sign, (image, np.arange(len(image)))), stiffness.shape)
            stiffness = 0.5 * (stiffness + S @ stiffness @ S.T)
            h *= 2
        result = stiffness.tocsr()
        result.sort_indices()
        return result

    def bases(self, unknowns: NDArray[np.int64]) -> list[sparse.csc_matrix]:
        """Orthonormal bases V_χ on some unknowns, closed under reflection: (m, m_χ) each.

        A column belongs to an orbit; its first entry is positive and all have one magnitude.
        """
        place = np.full(self.images.shape[1], -1, np.int64)
        place[unknowns] = np.arange(len(unknowns))
        images, signs = place[self.images[:, unknowns]], self.signs[:, unknowns]
        first = np.flatnonzero(images.min(axis=0) == np.arange(len(unknowns)))
        images, signs = images[:, first], signs[:, first]
        result = []
        for character in range(self.order):
            weights = [_parity(character & h) for h in range(self.order)]
            values = signs * np.array(weights, float)[:, None]
            columns = np.broadcast_to(np.arange(len(first)), images.shape)
            V = sparse.coo_matrix(
                (values.ravel(), (images.ravel(), columns.ravel())),
                shape=(len(unknowns), len(first)),
            ).tocsc()  # entries of one unknown are summed, and cancel where the orbit folds
            V.eliminate_zeros()
            squares = np.asarray(V.multiply(V).sum(axis=0)).ravel()
            V = V[:, squares > 0.0]
            V = (V @ sparse.diags(1.0 / np.sqrt(squares[squares > 0.0]))).tocsc()
            V.sort_indices()
            result.append(V)
        return result


def find_symmetry(
    points: NDArray[np.float64], dimension: int, stiffness: sparse.csr_matrix
) -> Symmetry | None:
    """Reflections along the axes, and their products, under which a stiffness does not change.

    They are looked for about the middle of the nodes, and tried on the stiffness with random
    displacements. None where there are none.

    Parameters
    ----------
    points : (nodes, 3)
        Coordinates; unknown ``node * dimension + component``.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    x = points - middle
    length = float(np.abs(x).max())
    lopsided = np.abs(x.mean(axis=0)[:dimension]) > TOLERANCE * length
    tree = cKDTree(x)
    probe = np.random.default_rng(0).standard_normal((stiffness.shape[0], 2))
    force = stiffness @ probe
    scale = float(np.abs(force).max())

    generators: list[tuple[NDArray[np.int64], NDArray[np.int8]]] = []
    spanned = {(False,) * dimension}
    flips = sorted(product((False, True), repeat=dimension), key=sum)
    for flip in flips[1:]:
        if flip in spanned or (lopsided & flip).any():
            continue
        mirror = np.ones(3)
        mirror[:dimension] = np.where(flip, -1.0, 1.0)
        distance, node = tree.query(x * mirror)
        if distance.max() > TOLERANCE * length or len(np.unique(node)) < len(node):
            continue
        image = (node[:, None] * dimension + np.arange(dimension)).ravel()
        sign = np.tile(mirror[:dimension], len(points))[:, None]
        reflected = np.empty_like(probe)
        reflected[image] = sign * probe
        expected = np.empty_like(force)
        expected[image] = sign * force
        if np.abs(stiffness @ reflected - expected).max() > TOLERANCE * scale:
            continue
        generators.append((image, sign[:, 0].astype(np.int8)))
        spanned |= {tuple(np.logical_xor(flip, s).tolist()) for s in spanned}
    if not generators:
        return None

    unknowns = stiffness.shape[0]
    images = [np.arange(unknowns)]
    signs = [np.ones(unknowns, np.int8)]
    for image, sign in generators:
        images += [image[known] for known in images]
        signs += [
            known_sign * sign[known] for known, known_sign in zip(images, signs, strict=False)
        ]
    return Symmetry(np.array(images), np.array(signs))


def _parity(bits: int) -> int:
    """+1 where an even number of bits is set, -1 elsewhere."""
    return -1 if bits.bit_count() % 2 else 1
