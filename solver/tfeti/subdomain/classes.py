"""Congruence classes: subdomains of one stiffness, solved together.

All members share K, its kernel R and its factor. On the interface, K⁺ acts either as one dense
block, which makes the class's share of the dual operator a single matrix product, or through
sparse solves with a column for each member.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from solver.tfeti.subdomain.costs import BlockKind, choose_block, relaxing_pays
from solver.tfeti.subdomain.generalised_inverse import (
    Block,
    DenseBlock,
    GeneralisedInverse,
    Inverse,
    SymmetricInverse,
)
from solver.tfeti.subdomain.kernels import (
    check_kernel,
    fixing_nodes,
    fixing_unknowns,
    orthonormal_kernel,
)
from solver.tfeti.subdomain.reflections import find_symmetry
from solver.tfeti.subdomain.rigid import ZeroInverse

DENSE_GAIN = 20.0
"""Speed of a dense product over that of a sparse one, per multiplication."""

MEMBERS_AT_ONCE = 128
"""Number of members whose full vectors are processed together."""


@dataclass(frozen=True, eq=False)
class SubdomainClass:
    """Subdomains of equal stiffness on this rank.

    Attributes
    ----------
    stiffness : (n, n)
        K, before any condition is imposed.
    kernel : (n, k)
        Orthonormal rigid motions R; k = 0 where held unknowns are eliminated instead.
    motions : (n, r)
        Orthonormal rigid motions, also where held unknowns are eliminated.
    free : (m,)
        Unknowns that are solved for; all unknowns unless held ones are eliminated.
    interface : (i,)
        Unknowns with entries in B in some member, in the order of vectors for K⁺.
    members
        Number of subdomains in the class.
    inverse
        K⁺ on the free unknowns; None where the class is not factored.
    block : (i, i) or None
        K⁺ between interface unknowns; None where it does not pay.
    relaxes
        Whether a preconditioner of Schur complements pays.
    """

    stiffness: sparse.csr_matrix
    kernel: NDArray[np.float64]
    motions: NDArray[np.float64]
    free: NDArray[np.int64]
    interface: NDArray[np.int64]
    members: int
    inverse: Inverse | None
    block: Block | None
    relaxes: bool

    @property
    def unknowns(self) -> int:
        """Unknowns of one member."""
        return self.stiffness.shape[0]

    @property
    def rigid(self) -> bool:
        """Whether the members are rigid bodies, without any stiffness."""
        return self.stiffness.nnz == 0

    @property
    def resistance(self) -> NDArray[np.float64]:
        """Diagonal of K, (n,); infinite for rigid bodies, which no force strains."""
        if self.rigid:
            return np.full(self.unknowns, np.inf)
        return np.asarray(self.stiffness.diagonal())

    @cached_property
    def interface_stiffness(self) -> sparse.csr_matrix:
        """K between interface unknowns, (i, i)."""
        return self.stiffness[self.interface][:, self.interface].tocsr()

    @cached_property
    def row_sums(self) -> NDArray[np.float64]:
        """Σ_j |K_ij| of each unknown, (n,)."""
        return np.asarray(abs(self.stiffness).sum(axis=1)).ravel()

    @cached_property
    def preconditioning(self) -> Block | sparse.csr_matrix:
        """The stiffness on the interface in a preconditioner, dense where that is faster."""
        if self.schur_complement is not None:
            return self.schur_complement
        S = self.interface_stiffness
        return DenseBlock(S.toarray()) if S.shape[0] ** 2 < DENSE_GAIN * S.nnz else S

    @cached_property
    def schur_complement(self) -> Block | None:
        """Schur complement of K on the interface, (i, i); None where it does not pay."""
        if self.block is None or not self.relaxes:
            return None
        try:
            return self.block.schur_complement(self.kernel[self.interface])
        except np.linalg.LinAlgError:  # a body so slender that its block has no correct digits
            return None

    def batches(self) -> Iterator[slice]:
        """Slices of members, for operations whose temporary arrays should stay small."""
        for begin in range(0, self.members, MEMBERS_AT_ONCE):
            yield slice(begin, min(begin + MEMBERS_AT_ONCE, self.members))

    def solve(self, loads: NDArray[np.float64]) -> NDArray[np.float64]:
        """K⁺ on full vectors, (n, s) to (n, s); held unknowns stay zero."""
        assert self.inverse is not None
        if len(self.free) == self.unknowns:
            return self.inverse.solve(loads)
        result = np.zeros(loads.shape, order="F")
        result[self.free] = self.inverse.solve(loads[self.free])
        return result

    def apply_interface(self, loads: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """K⁺ on interface vectors, one row per member: (s, i) to (s, i)."""
        if self.block is not None:
            self.block.apply(loads, out)
            return
        assert self.inverse is not None
        full = np.zeros((len(self.free), len(loads)), order="F")
        full[self._place] = loads.T
        out[:] = self.inverse.solve(full)[self._place].T

    @cached_property
    def _place(self) -> NDArray[np.int64]:
        """Places of the interface unknowns among the free unknowns."""
        return np.searchsorted(self.free, self.interface)


def unfactored_class(
    stiffness: sparse.csr_matrix,
    points: NDArray[np.float64],
    dimension: int,
    touched: NDArray[np.int64],
    members: int,
    eliminated: NDArray[np.int64] | None,
    kernel: NDArray[np.float64] | None = None,
) -> SubdomainClass:
    """A class without factor and kernel, for methods that solve for the displacements.

    Parameters are those of `subdomain_class`.

    Raises
    ------
    ValueError
        The stiffness resists a rigid motion.
    """
    every = np.arange(stiffness.shape[0])
    free = every if eliminated is None else np.setdiff1d(every, eliminated)
    if stiffness.nnz == 0:
        unit = np.eye(len(every))
        return SubdomainClass(stiffness, unit[:, :0], unit, free, every, members, None, None, False)
    rigid = orthonormal_kernel(points, dimension) if kernel is None else np.linalg.qr(kernel)[0]
    check_kernel(stiffness, rigid)
    return SubdomainClass(
        stiffness, rigid[:, :0], rigid, free, np.unique(touched), members, None, None, False
    )


def subdomain_class(
    stiffness: sparse.csr_matrix,
    points: NDArray[np.float64],
    dimension: int,
    touched: NDArray[np.int64],
    members: int,
    eliminated: NDArray[np.int64] | None,
    sharing: MPI.Intracomm | None = None,
    kernel: NDArray[np.float64] | None = None,
) -> SubdomainClass:
    """Factor the stiffness of a congruence class and choose how K⁺ is applied.

    A stiffness without entries is that of a rigid body, whose free unknowns are its kernel.

    Parameters
    ----------
    stiffness : (n, n)
        K; unknown ``node * dimension + component``.
    points : (nodes, 3)
    touched
        Unknowns with entries in B in some member. Their mirror images join the interface if the
        class is symmetric.
    eliminated
        Held unknowns that are eliminated; None where the members float.
    sharing
        All ranks, if all build this class now with the same `touched`: they share the work.
    kernel : (n, k)
        Basis of the kernel of K; the rigid motions of the points unless given.

    Raises
    ------
    ValueError, ArithmeticError
        The stiffness resists a rigid motion, or has further zero-energy modes.
    """
    if stiffness.nnz == 0:
        return _rigid_class(stiffness, members, eliminated)
    # all ranks that share the work decide alike here
    most = sharing.allreduce(members, op=MPI.MAX) if sharing else members
    rigid = orthonormal_kernel(points, dimension) if kernel is None else np.linalg.qr(kernel)[0]
    check_kernel(stiffness, rigid)
    every = np.arange(stiffness.shape[0])
    inverse: GeneralisedInverse | SymmetricInverse
    if eliminated is not None:
        free = np.setdiff1d(every, eliminated)
        moves = np.zeros((len(every), 0))
        inverse = GeneralisedInverse(stiffness[free][:, free], moves[free], every[:0])
        interface = touched
        block_kind = choose_block(len(free), len(touched), most, 1, dimension)
    else:
        free, moves = every, rigid
        symmetry = None
        if kernel is None:
            nodes = fixing_nodes(points, dimension)
            fixing = (nodes[:, None] * dimension + np.arange(dimension)).ravel()
            symmetry = find_symmetry(points, dimension, stiffness)
        else:
            fixing = fixing_unknowns(rigid)
        interface = np.unique(touched)
        if symmetry is not None:
            interface = symmetry.split(symmetry.closure(touched)).unknowns
        order = symmetry.order if symmetry else 1
        block_kind = choose_block(len(free), len(interface), most, order, dimension)
        if symmetry is None or block_kind is BlockKind.NONE:
            inverse = GeneralisedInverse(stiffness, moves, fixing)
        else:
            stiffness = symmetry.average(stiffness)
            inverse = SymmetricInverse(stiffness, moves, fixing, symmetry, sharing)
    block: Block | None = None
    if block_kind is not BlockKind.NONE:
        block = inverse.restricted(np.searchsorted(free, interface))
        if block_kind is BlockKind.DENSE:
            block = DenseBlock(block.toarray())
    relaxes = block is not None and relaxing_pays(len(interface), most, block.order)
    return SubdomainClass(
        stiffness, moves, rigid, free, interface, members, inverse, block, relaxes
    )


def _rigid_class(
    stiffness: sparse.csr_matrix, members: int, eliminated: NDArray[np.int64] | None
) -> SubdomainClass:
    """The class of rigid bodies: all unknowns are on the interface, and free ones are kernel."""
    every = np.arange(stiffness.shape[0])
    free = every if eliminated is None else np.setdiff1d(every, eliminated)
    unit, inverse = np.eye(len(every)), ZeroInverse()
    return SubdomainClass(
        stiffness, unit[:, free], unit, free, every, members, inverse, inverse.restricted(every),
        relaxes=True,
    )  # fmt: skip
