"""A generalised inverse K⁺ of a singular stiffness by sparse Cholesky factors.

Fixing nodes carry the regularisation (Brzobohatý, Dostál, Kozubek, Kovář, Markopoulos, *Cholesky
decomposition with fixing nodes to stable computation of a generalized inverse of the stiffness
matrix of a floating structure*, 2011): with N the rows of the kernel R at the fixing nodes and
zeros elsewhere,

    K_ρ = K + ρ N (Nᵀ N)⁻¹ Nᵀ

is positive definite, and K_ρ x = K u implies Rᵀ N (Nᵀ N)⁻¹ Nᵀ x = Nᵀ x = 0, hence K x = K u:
K K_ρ⁻¹ K = K exactly, whatever ρ. If the subdomain has reflections and the fixing nodes have them,
too, K_ρ splits into one block per character, and so do its factor and its inverse.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from solver.factors import COLUMNS_AT_ONCE, CholeskyFactor
from solver.tfeti.subdomain.reflections import Split, Symmetry
from solver.vectors import Array, Ints

SMALL = 600
"""Size up to which blocks of one character have dense factors: for 200 to 400 unknowns of boxes in
space, the factor and the inverse between those of the interface take half the time of sparse ones,
at 650 nine tenths, and more above; in the plane as long at 340."""

SINGLE_CONDITION = 1e5
"""Largest condition of Schur complements in single precision: then products take half the time, and
their errors, 1e-7, are far below the smallest eigenvalues of the preconditioner."""

NO_FACTOR = (
    "a subdomain's stiffness has no Cholesky factor once its rigid motions are fixed: it has "
    "further zero-energy modes, or cells of no volume"
)


class Inverse(Protocol):
    """K⁺ of one class."""

    def solve(self, loads: Array) -> Array:
        """K⁺ times each column: (n, columns) to (n, columns), both in Fortran order."""


class Block(Protocol):
    """A dense part of K⁺, symmetric, applied to many members at once."""

    def apply(self, loads: Array, out: Array) -> None:
        """Apply the block to vectors, one row per member: (s, m) to (s, m)."""

    @property
    def schur_complement(self) -> "Block":
        """The Schur complement of the stiffness on the same unknowns, (m, m).

        Raises
        ------
        numpy.linalg.LinAlgError
            The block is not positive definite to working precision.
        """


class DenseFactor:
    """LAPACK's factor of a small sparse positive definite matrix, as `CholeskyFactor`.

    Unknowns of `restricted` are eliminated last: their part of A = L Lᵀ is the factor of a Schur
    complement, whose inverse is their part of A⁻¹.
    """

    def __init__(self, matrix: sparse.spmatrix) -> None:
        self._matrix = matrix
        self._order, self._lower = np.arange(0), np.empty((0, 0))

    def _factorise(self, last: Ints) -> None:
        first = np.setdiff1d(np.arange(self._matrix.shape[0]), last)
        self._order = np.concatenate([first, last])
        ordered = self._matrix.toarray()[self._order][:, self._order].T
        self._lower, failed = lapack.dpotrf(ordered, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise ArithmeticError(NO_FACTOR)

    def solve(self, loads: Array) -> Array:
        """The inverse times each column: (n, columns) to (n, columns), both in Fortran order."""
        if not len(self._order):
            self._factorise(self._order)
        result = np.empty(loads.shape, order="F")
        result[self._order] = lapack.dpotrs(self._lower, loads[self._order], lower=1)[0]
        return result

    def restricted(self, unknowns: Ints) -> Array:
        """The inverse between some unknowns, (m, m), symmetric."""
        self._factorise(unknowns)
        begin = len(self._order) - len(unknowns)
        block = np.tril(lapack.dpotri(self._lower[begin:, begin:], lower=1)[0])
        return block + np.tril(block, -1).T


class GeneralisedInverse:
    """K⁺ of a symmetric positive semidefinite sparse matrix by one factor (protocol `Inverse`).

    Parameters
    ----------
    stiffness : (n, n)
        K.
    kernel : (n, k)
        Orthonormal basis of the null space; k = 0 for a definite matrix.
    fixing : (m,)
        Unknowns that carry the regularisation: the kernel restricted to them has full rank.

    Raises
    ------
    ArithmeticError
        The matrix has a larger null space than the kernel, or is not positive semidefinite.
    """

    def __init__(self, stiffness: sparse.csr_matrix, kernel: Array, fixing: Ints) -> None:
        self._factor = CholeskyFactor(_regularised(stiffness, kernel, fixing), NO_FACTOR)
        self._kernel = kernel

    def solve(self, loads: Array) -> Array:
        """K⁺ times each column: (n, columns) to (n, columns), both in Fortran order."""
        return self._factor.solve(loads)

    def restricted(self, unknowns: Ints) -> "DenseBlock":
        """K⁺ between some unknowns."""
        return DenseBlock(self._factor.restricted(unknowns), self._kernel[unknowns])


class SymmetricInverse:
    """K⁺ of a subdomain with reflections: one factor for each character (protocol `Inverse`).

    Parameters and errors are those of `GeneralisedInverse`; `fixing` may be any set; its mirror
    images are added.
    """

    def __init__(
        self, stiffness: sparse.csr_matrix, kernel: Array, fixing: Ints, symmetry: Symmetry
    ) -> None:
        self.symmetry, self._kernel = symmetry, kernel
        regular = _regularised(stiffness, kernel, symmetry.closure(fixing))
        self._split = symmetry.split(np.arange(stiffness.shape[0]))
        bases = self._split.bases(stiffness.shape[0])
        # V_χᵀ K V_χ from the first row of each orbit: the others repeat it
        self.factors = [
            _factor_of(_scaled_rows(regular[first] @ V, orbit))
            for V, (first, orbit) in zip(bases, self._split.orbits, strict=True)
        ]

    def solve(self, loads: Array) -> Array:
        """K⁺ times each column: (n, columns) to (n, columns), both in Fortran order."""
        result = np.empty(loads.shape, order="F")
        order = self._split.unknowns
        back = np.argsort(order)
        for begin in range(0, loads.shape[1], COLUMNS_AT_ONCE):
            part = slice(begin, begin + COLUMNS_AT_ONCE)
            rows = loads.T[part][:, order]
            coordinates = self._split.forward(rows)
            for factor, place in zip(self.factors, self._split.places, strict=True):
                coordinates[:, place] = factor.solve(coordinates[:, place].T).T
            self._split.backward(coordinates, rows)
            result.T[part] = rows[:, back]
        return result

    def restricted(self, unknowns: Ints) -> "SymmetricBlock":
        """K⁺ between some unknowns, in the order of a split."""
        inside = np.zeros(len(self._split.unknowns), bool)
        inside[unknowns] = True
        chosen = [np.flatnonzero(inside[first]) for first, _ in self._split.orbits]
        blocks = [f.restricted(some) for f, some in zip(self.factors, chosen, strict=True)]
        split = self.symmetry.split(unknowns)
        return SymmetricBlock(blocks, split, self._kernel[split.unknowns])


class DenseBlock:
    """A dense part of K⁺ as one matrix, and the kernel there, (m, k) (protocol `Block`)."""

    def __init__(self, matrix: Array, kernel: Array) -> None:
        self.matrix, self._kernel = matrix, kernel

    def apply(self, loads: Array, out: Array) -> None:
        """Apply the block to vectors, one row per member: (s, m) to (s, m)."""
        out[:] = loads.astype(self.matrix.dtype, copy=False) @ self.matrix

    @cached_property
    def schur_complement(self) -> "DenseBlock":
        """The Schur complement of the stiffness on the same unknowns, (m, m)."""
        motions = _range(self._kernel, np.linalg.norm(self._kernel))
        return DenseBlock(_relaxed(self.matrix, motions), self._kernel)


class SymmetricBlock:
    """A dense part of K⁺ as one matrix for each character (protocol `Block`).

    Parameters
    ----------
    blocks : one (m_χ, m_χ) array per character
        (V_χᵀ K V_χ)⁻¹ between coordinates of the interface.
    split
        The coordinates; loads and displacements are in the order of its unknowns.
    kernel : (m, k)
        The rigid motions there.
    """

    MEMBERS_AT_ONCE = 256
    """Number of members transformed together.

    Few enough for small temporary arrays, many enough for a fast product.
    """

    def __init__(self, blocks: Sequence[Array], split: Split, kernel: Array) -> None:
        self.blocks, self.split, self._kernel = blocks, split, kernel
        self._precision = np.result_type(np.float32, *blocks)

    def apply(self, loads: Array, out: Array) -> None:
        """Apply the block to vectors, one row per member: (s, m) to (s, m)."""
        for begin in range(0, len(loads), self.MEMBERS_AT_ONCE):
            members = slice(begin, begin + self.MEMBERS_AT_ONCE)
            some = loads[members].astype(self._precision, copy=False)
            coordinates = self.split.forward(some)
            solved = np.empty_like(coordinates)
            for place, block in zip(self.split.places, self.blocks, strict=True):
                np.matmul(coordinates[:, place], block, out=solved[:, place])
            self.split.backward(solved, out[members])

    @cached_property
    def schur_complement(self) -> "SymmetricBlock":
        """The Schur complement of the stiffness on the same unknowns, (m, m)."""
        coordinates = self.split.forward(np.ascontiguousarray(self._kernel.T))
        complements = []
        for block, place, (_, orbit) in zip(
            self.blocks, self.split.places, self.split.orbits, strict=True
        ):
            # the bases are orthogonal, their squares the sizes of the orbits
            motions = _range(coordinates[:, place].T, np.linalg.norm(coordinates))
            complements.append(_relaxed(block, motions, 1.0 / orbit))
        return SymmetricBlock(complements, self.split, self._kernel)


def _factor_of(matrix: sparse.csr_matrix) -> DenseFactor | CholeskyFactor:
    """The faster factor of a part of a stiffness."""
    small = 0 < matrix.shape[0] <= SMALL
    return DenseFactor(matrix) if small else CholeskyFactor(matrix, NO_FACTOR)


def _scaled_rows(matrix: sparse.csr_matrix, factors: Ints) -> sparse.csr_matrix:
    """The matrix, its rows multiplied in place, without the calls of a sparse product."""
    matrix.data *= np.repeat(factors, np.diff(matrix.indptr))
    return matrix


def _relaxed(block: Array, kernel: Array, weights: Array | None = None) -> Array:
    """S = A⁻¹ - Y (Rᵀ Y)⁻¹ Yᵀ with Y = A⁻¹ R, from A = K⁺ on the interface; its kernel is R.

    A force g = S w does no work on R, and A g = w + R c for some c; so A⁻¹ (w + R c) = g, and what
    is subtracted makes R the kernel and vanishes at w + R c, for Yᵀ (w + R c) = Rᵀ g = 0.

    Parameters
    ----------
    weights : (m,)
        Scale of the result on both sides, for coordinates that are not normalised. R is given in
        the coordinates of forces.
    """
    inverse, failed = lapack.dpotrf(block, lower=0, clean=1)
    if not failed:
        inverse, failed = lapack.dpotri(inverse, lower=0, overwrite_c=1)
    if failed:
        raise np.linalg.LinAlgError("K⁺ on the interface is not positive definite")
    inverse += np.triu(inverse, 1).T
    condition = np.linalg.norm(block, 1) * np.linalg.norm(inverse, 1) if len(block) else 0.0
    if weights is not None:
        inverse *= weights
        inverse *= weights[:, None]
    if kernel.shape[1]:
        forces = inverse @ kernel
        inverse -= forces @ np.linalg.solve(kernel.T @ forces, forces.T)
    return inverse.astype(np.float32 if condition < SINGLE_CONDITION else np.float64, order="C")


def _range(motions: Array, size: np.floating) -> Array:
    """Orthonormal basis of the columns' span but for rounding, (m, k) to (m, rank)."""
    basis, sizes, _ = np.linalg.svd(motions, full_matrices=False)
    return basis[:, sizes > 1e-10 * size]


def _regularised(stiffness: sparse.csr_matrix, kernel: Array, fixing: Ints) -> sparse.csr_matrix:
    """K + ρ N (Nᵀ N)⁻¹ Nᵀ; K itself where there is no kernel."""
    if not kernel.shape[1]:
        return stiffness
    basis = np.linalg.qr(kernel[fixing])[0]
    ρ = float(stiffness.diagonal().mean())
    rows, columns = np.meshgrid(fixing, fixing, indexing="ij")
    block = sparse.csr_matrix(
        ((ρ * basis @ basis.T).ravel(), (rows.ravel(), columns.ravel())), shape=stiffness.shape
    )
    return (stiffness + block).tocsr()
