"""Search directions of earlier active sets that need no second operator application.

Active sets differ in the contact rows that they leave out, but they share the operator F. The
directions p of earlier sets, all with G p = 0, span a space V. Vectors of V that vanish on the rows
that are open now are admissible on the present set, and F is known on them. On a set

    C = Z (Zᵀ VᵀFV Z)⁻¹ Zᵀ,  Z a basis of the y with V y = 0 on open rows,

gives the best multiplier V C Vᵀ r in V for a residual r, and makes a preconditioned residual z
F-orthogonal to V by z - V C (F V)ᵀ z (Y. Saad, M. Yeung, J. Erhel, F. Guyomarc'h, *A deflated
version of the conjugate gradient algorithm*, 2000; P. Gosselet, C. Rey, J. Pebrel, *Total and
selective reuse of Krylov subspaces for the resolution of sequences of nonlinear structural
problems*, 2013). A row that opens costs one dimension of V, a row that closes costs none.

On one set each new direction is made F-orthogonal to all earlier ones, not to the last one alone.
Rounding errors destroy the orthogonality, and with sliver cells most steps would repeat others
(F.-X. Roux, *Acceleration of the outer conjugate gradient by reorthogonalization for a domain
decomposition method for structural analysis problems*, 1990).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.problem.constraints.matrix import ConstraintMatrix
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class RecyclingOptions:
    """Limits on stored search directions."""

    most: int = 100
    """Largest number of stored directions."""
    fewest: int = 9
    """Number of stored directions from which on later sets use them: fewer save little."""
    light: int = 2**19
    """Bytes of a direction, over all ranks, up to which storing it takes no time beside an operator
    application."""
    easy: int = 8
    """For directions above `light`: number of first steps whose directions are not stored. Once a
    set takes more steps, it stores the following directions, and later sets store all their
    directions."""
    dependent: float = 1e-6
    """Eigenvalues of the scaled VᵀFV, over the largest, below which directions are dependent."""
    absent: float = 1e-10
    """Singular values of V on open rows, relative to the largest, that count as zero."""
    memory: int = 2**27
    """Largest memory for directions on a rank, in bytes; large problems store no directions."""


class Directions:
    """Vectors p of earlier operator applications, F p on all rows, and K⁺ Bᵀ p on the interface.

    They belong to one operator F and are independent of the loads. Problems that differ in their
    loads alone may share them (`DualProblem.recycling`).

    Parameters
    ----------
    B : (dual, interface)
        Constraint matrix with all its rows.
    conditional : (dual,)
        Rows that may be open or slide.

    Attributes
    ----------
    count
        Number of directions that later sets use; directions of the present set are stored in
        addition.
    largest
        Largest ‖F p‖/‖p‖: a lower bound of ‖F‖.
    light
        Whether a direction takes at most `RecyclingOptions.light` bytes.
    """

    def __init__(
        self, B: ConstraintMatrix, conditional: Mask, options: RecyclingOptions | None = None
    ) -> None:
        self.options = options = options or RecyclingOptions()
        self.B, self.conditional, self.comm = B, conditional, B.comm
        self._contact = np.flatnonzero(conditional)
        size = len(conditional)
        entries = 2 * size + B.columns
        self.light = 8 * self.comm.allreduce(entries) <= options.light
        room = options.memory // (8 * max(entries, 1))
        capacity = int(self.comm.allreduce(min(options.most, room), op=MPI.MIN))
        self.capacity = capacity if capacity >= options.fewest else 0
        self.count = self._next = 0
        self._vectors = np.empty((self.capacity, size))
        self._applied = np.empty((self.capacity, size))
        self._motions = np.empty((self.capacity, B.columns))
        self._gram = np.zeros((self.capacity, self.capacity))
        self.largest = 0.0
        self._first = 0  # of the present set
        self._original: Callable[[Array], Array] | None = None

    def begin(self, original: Callable[[Array], Array] | None = None) -> None:
        """Begin a set.

        Parameters
        ----------
        original
            Turns multipliers of the set into those of the original frames and lengths of rows; None
            where they are the same.
        """
        if self._original is not None:
            for vector in self._vectors[self._first : self._next]:
                vector[:] = self._original(vector)
        self._original, self._first = original, self._next

    @property
    def vectors(self) -> Array:
        """p, (count, dual)."""
        return self._vectors[: self.count]

    @property
    def applied(self) -> Array:
        """F p, (count, dual)."""
        return self._applied[: self.count]

    @property
    def motions(self) -> Array:
        """K⁺ Bᵀ p, (count, interface)."""
        return self._motions[: self.count]

    @property
    def gram(self) -> Array:
        """VᵀFV, (count, count)."""
        return self._gram[: self.count, : self.count]

    def stores_step(self, steps: int) -> bool:
        """Whether to store the direction of this step on a set, counted from one."""
        return self.light or self._next > 0 or steps > self.options.easy

    def store(self, vector: Array, motion: Array, image: Array) -> None:
        """Store an operator application (x, K⁺ Bᵀ x and P F x) while there is memory.

        The present set uses it at once, later sets from the next one on.
        """
        if self._next < self.capacity:
            self._vectors[self._next], self._motions[self._next] = vector, motion
            self._applied[self._next] = image  # F x from `settle` on
            self._next += 1

    @property
    def stored(self) -> int:
        """Number of stored directions, including those of the present set."""
        return self._next

    def orthogonalise(self, z: Array, first: int) -> None:
        """Make z F-orthogonal to the directions of this set, which begin at `first` (collective).

        In exact arithmetic conjugate gradients make it so. Rounding errors destroy this where ‖F p‖
        is small beside that of other directions, and so cost steps.
        """
        if first == self._next:
            return
        vectors, images = (a[first : self._next] for a in (self._vectors, self._applied))
        curvatures = np.einsum("ij,ij->i", vectors, images)
        curvatures, parts = self.comm.allreduce(np.stack([curvatures, images @ z]))
        good = curvatures > 0.0
        z -= np.where(good, parts / np.where(good, curvatures, 1.0), 0.0) @ vectors

    @property
    def suffice(self) -> bool:
        """Whether the number of directions is enough for later sets."""
        return self._next >= self.options.fewest

    def settle(self) -> None:
        """Make all directions that were stored before this set available to it and to later ones.

        If memory is full, drop the older half.
        """
        rows, self.count = slice(self.count, self._next), self._next
        for motion, applied in zip(self._motions[rows], self._applied[rows], strict=True):
            self.B.apply(motion, applied)
        vectors, applied = self._vectors[rows], self._applied[rows]
        gram = self.comm.allreduce(self.vectors @ applied.T)
        self._gram[: self.count, rows], self._gram[rows, : self.count] = gram, gram.T
        lengths, forces = self.comm.allreduce(
            np.array([np.einsum("ij,ij->i", a, a) for a in (vectors, applied)])
        )
        ratios = forces[lengths > 0.0] / lengths[lengths > 0.0]
        self.largest = max(self.largest, float(np.sqrt(ratios.max(initial=0.0))))
        if self.count == self.capacity:
            self.count = self._next = self._first = self.capacity // 2
            for array in (self._vectors, self._applied, self._motions):
                array[: self.count] = array[-self.count :].copy()
            self._gram[: self.count, : self.count] = self._gram[-self.count :, -self.count :].copy()

    def on_set(self, active: Mask) -> Array:
        """C, (k, k), for an active set (collective)."""
        k = self.count
        gram = self._gram[:k, :k]
        scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), np.inf))
        open_rows = self._contact[~active[self._contact]]
        values = self._vectors[:k, open_rows].T * scale
        triangle = np.zeros((k, k))
        if len(open_rows):
            part = np.linalg.qr(values, mode="r")
            triangle[: len(part)] = part
        parts = np.concatenate(self.comm.allgather(triangle))
        result = np.zeros((k, k))
        if k and not self.comm.rank:
            _, sizes, basis = np.linalg.svd(parts)
            options, scaled = self.options, gram * scale * scale[:, None]
            rank = int((sizes > options.absent * sizes.max(initial=0.0)).sum())
            result = _inverse_on(basis[rank:].T, scaled, options.dependent)
            result *= scale * scale[:, None]
        return np.asarray(self.comm.bcast(result))


def _inverse_on(basis: Array, gram: Array, dependent: float) -> Array:
    """Z (Zᵀ A Z)⁻¹ Zᵀ on the directions that are independent to working precision."""
    small = basis.T @ gram @ basis
    scale = 1.0 / np.sqrt(np.maximum(np.diag(small), np.finfo(np.float64).tiny))
    sizes, modes = np.linalg.eigh(0.5 * (small + small.T) * scale * scale[:, None])
    good = sizes > dependent * sizes.max(initial=0.0)
    half = basis @ ((scale[:, None] * modes[:, good]) / np.sqrt(sizes[good]))
    return np.asarray(half @ half.T)
