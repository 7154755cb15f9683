"""A coarse space of rigid motions, for bodies that contact holds.

A ball between two grooves can rotate without a load: facets and frictionless contact hardly resist
its rotation. Such motions, changed at the nodes of active rows so that these stay closed, W = Π R,
have very little energy, and neither smoothing nor truncated coarse spaces reduce errors in them.
With Q = W (Wᵀ K W)⁻¹ Wᵀ the correction M⁻¹ r becomes

    (I - Q K) M⁻¹ r + Q r

(J. M. Tang, R. Nabben, C. Vuik, Y. A. Erlangga, *Comparison of two-level preconditioners derived
from deflation, domain decomposition and multigrid methods*, 2009: A-DEF2). K W vanishes away from
the contact. Rigid bodies are treated in the same way, since their motions have no other
preconditioner.

Rows that hold a motion in the mean of a body, M u = 0, are not for Π: it would move soft nodes
further than stiff ones, which costs much energy where friction holds the contact, too. For these
rows the space also contains E = M_c⁻¹ Mᵀ, M_c⁻¹ one V-cycle. Of all combinations Z of its vectors
with M Z = I the ones with least energy hold the means: a residual becomes (I - Mᵀ Zᵀ) r, its
correction (I - Z M) z. W has the other combinations, with M W = 0.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.contact.bodies import largest
from solver.primal.blocks import in_blocks
from solver.primal.cycle import Cycle, CycleOnSets
from solver.primal.factor import squared_rows
from solver.primal.merged import MergedSystem
from solver.primal.products import chosen_columns, multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.primal.springs import Springs
from solver.vectors import Array, largest_magnitude


@dataclass(frozen=True)
class RigidSpaceOptions:
    """The tuned numbers of the space."""

    held: float = 1e-8
    """Squared length of held unknowns under a rigid motion, over that of the largest, below which
    they do not stop it."""
    strainless: float = 1e-10
    """Forces of a motion, over the largest stiffness, below which they are rounding errors: of a
    body that is held in two nodes close to each other a motion is nearly free, and has forces."""
    singular: float = 1e-13
    """Energy of a motion, relative to the largest, below which it consists of rounding errors."""
    least: float = 0.1
    """Least value for the largest energy of a motion; in the norm of D motions have energy one."""
    rounding: float = 1e-14
    """Magnitude of K w over the root of K below which it consists of rounding errors."""
    full: int = 18
    """Largest number of motions for which W is stored as a full matrix: with more it is mostly
    zeros."""
    unbalanced: float = 1e-8
    """Work of a residual on a motion without energy, over that of the magnitudes of the load."""
    no_work: float = 1e-12
    """Work on a motion, over the sum of the load by the largest component of the motion, that
    consists of rounding errors: active rows may hold all components on which the load acts."""
    most_means: int = 18
    """Largest number of rows that hold means for which the space contains their E."""
    most: int = 50
    """Largest number of bodies for which the space contains motions of elastic bodies: its matrix
    is dense."""


OPTIONS = RigidSpaceOptions()


def floating_motions(system: MergedSystem) -> Array:
    """Rigid motions of bodies that held unknowns do not stop, (unknowns, motions) (collective).

    If more than `RigidSpaceOptions.most` bodies have such motions, only those of rigid bodies.
    """
    rigid, bodies, motions = system.rigid, system.problem.bodies, {}
    for number in range(bodies.count):
        of_body = system.body == number
        rows, count = rigid[system.held & of_body], rigid.shape[1]
        gram = np.append(rows.T @ rows, np.sum(rigid[of_body] ** 2))
        gram = system.comm.allreduce(gram)
        values, vectors = np.linalg.eigh(gram[:-1].reshape(count, count))
        free = values <= OPTIONS.held * max(values[-1], 1e-6 * gram[-1])
        if free.any():
            moved = (of_body & ~system.held)[:, None]
            motions[number] = np.where(moved, rigid @ vectors[:, free], 0.0)
    if len(motions) > OPTIONS.most:
        motions = {number: motions[number] for number in motions if bodies.rigid[number]}
    return np.concatenate([np.zeros((system.size, 0)), *motions.values()], axis=1)


class FloatingMotions:
    """The rigid motions that held unknowns do not stop, and their products with K (collective).

    Attributes
    ----------
    motions : (motions, unknowns)
        Rᵀ, from `floating_motions`.
    images : (motions, unknowns)
        (K R)ᵀ.
    lifts_means
        Whether the motions contain E, one of each row that holds a mean.
    """

    lifts_means = False

    def __init__(self, system: MergedSystem) -> None:
        self.motions = np.ascontiguousarray(floating_motions(system).T)
        self._comm = system.comm
        if len(self.motions) == 0:
            return
        self.images = np.stack([multiply(in_blocks(system.K), motion) for motion in self.motions])
        sizes = np.array([np.abs(v).max(axis=1, initial=0.0) for v in (self.images, self.motions)])
        forces, moved = largest(self._comm, sizes)
        stiff = largest_magnitude(self._comm, system.diagonal)
        self._strainless = self.motions[forces <= OPTIONS.strainless * stiff * moved]
        gram = self._comm.allreduce(self._strainless @ self._strainless.T)
        self._inverse = np.linalg.pinv(gram, hermitian=True)
        in_rows = multiply_transposed(squared_rows(system), np.ones(len(system.rows))) > 0.0
        self._in_rows = np.flatnonzero(in_rows)
        self._columns = chosen_columns(system.K, self._in_rows)

    def without(self, u: Array) -> Array:
        """A displacement (unknowns,) without its share of motions that K does not resist.

        K of the share is a rounding error (collective): a roller may turn 1e5 times as far as it is
        strained.
        """
        if len(self.motions) == 0 or len(self._inverse) == 0:
            return u
        share = self._inverse @ self._comm.allreduce(self._strainless @ u)
        return np.asarray(u - share @ self._strainless)

    def with_lifts(self, system: MergedSystem, lifts: Sequence[Array]) -> Self:
        """These motions and E, displacements (unknowns,) for the means (collective)."""
        result = copy(self)
        images = [multiply(in_blocks(system.K), lift) for lift in lifts]
        result.motions = np.vstack([self.motions, *lifts])
        result.images = np.vstack([self.images, *images])
        result.lifts_means = True
        return result

    def images_left(self, W: Array) -> Array:
        """(K W)ᵀ of W (unknowns, motions), which differs in contact rows alone (collective)."""
        lifted, images = self.motions[:, self._in_rows] - W[self._in_rows].T, self.images.copy()
        for image, values in zip(images, lifted, strict=True):
            image -= multiply(self._columns, values)
        return images


def lifts_of_means(cycle: Cycle | CycleOnSets, projector: Projector) -> list[Array]:
    """E, a displacement (unknowns,) by one V-cycle for each row that holds a mean (collective).

    Parameters
    ----------
    projector
        Of the active rows without those that hold means; the cycle follows it.
    """
    system, lifts = projector.system, []
    for rank, count in enumerate(system.comm.allgather(int(system.means.sum()))):
        for number in range(count):
            chosen = np.zeros(len(system.rows))
            if rank == system.comm.rank:
                chosen[np.flatnonzero(system.means)[number]] = 1.0
            force, lift = multiply_transposed(system.C, chosen), np.empty(system.size)
            cycle.apply(projector.apply_transpose(force), lift)
            lifts.append(projector.apply(lift))
    return lifts


class RigidSpace:
    """W and its data for one active set (collective).

    Parameters
    ----------
    floating
        R and K R. Π moves the unknowns of contact rows alone, so that K W needs few columns of K.
    springs
        They belong to K.
    """

    def __init__(
        self,
        system: MergedSystem,
        projector: Projector,
        floating: FloatingMotions,
        springs: Springs,
    ) -> None:
        self._comm = system.comm
        motions = floating.motions
        self.empty = len(motions) == 0
        self.holds_means = False
        if self.empty:
            return
        if floating.lifts_means:
            projector = projector.narrow
        W = projector.apply(motions.T)
        W = W.copy() if projector.empty else W  # not the motions themselves: W is scaled in place
        images = floating.images_left(W)
        if not springs.empty:
            images += np.stack([springs.forces(motion) for motion in W.T])
        norms = [np.einsum("i,ij,ij->j", system.diagonal, R, R) for R in (motions.T, W)]
        before, after = self._comm.allreduce(np.stack(norms))
        some = after > OPTIONS.singular * before
        scale = np.divide(1.0, np.sqrt(after), out=np.zeros_like(after), where=some)
        W *= scale
        images *= scale[:, None]
        if floating.lifts_means:
            W, images = self._without_means(system, W, images)
        images[np.abs(images) < OPTIONS.rounding * np.sqrt(system.diagonal.max(initial=0.0))] = 0.0
        self._at = np.flatnonzero(images.any(axis=0))
        few = np.ascontiguousarray(images[:, self._at])
        self._KWt = few if W.shape[1] <= OPTIONS.full else sparse.csr_matrix(few)
        energy = self._comm.allreduce(self._KWt @ W[self._at])
        self._W = W if W.shape[1] <= OPTIONS.full else sparse.csr_matrix(W)
        self._Wt = self._W.T
        values, vectors = np.linalg.eigh(0.5 * (energy + energy.T))
        some = values > OPTIONS.singular * max(values[-1], OPTIONS.least)
        self._inverse = vectors[:, some] / values[some] @ vectors[:, some].T
        self._free = vectors[:, ~some]

    def _without_means(self, system: MergedSystem, V: Array, images: Array) -> tuple[Array, Array]:
        """Combinations W of motions V that move no mean, with their images; sets Z (collective).

        Parameters
        ----------
        V, images : (unknowns, motions), (motions, unknowns)
            Motions that leave all other active rows alone, and (K V)ᵀ.
        """
        comm, self._C, self._wide = self._comm, system.C, np.flatnonzero(system.means)
        moved = np.stack([multiply(system.C, motion)[self._wide] for motion in V.T], axis=1)
        counts = comm.allgather(len(self._wide))
        self._of_rank = slice(sum(counts[: comm.rank]), sum(counts[: comm.rank + 1]))
        moved = np.concatenate(comm.allgather(moved))
        energy = comm.allreduce(images @ V)
        weight = len(moved) / np.sum(moved**2)  # motions have length one in the norm of D
        both = 0.5 * (energy + energy.T) + weight * moved.T @ moved
        inverse = np.linalg.pinv(both, OPTIONS.singular, hermitian=True)
        lifts = inverse @ moved.T
        self._Z = V @ (lifts @ np.linalg.pinv(moved @ lifts, OPTIONS.singular, hermitian=True))
        self.holds_means = True
        others = np.linalg.svd(moved)[2][len(moved) :].T
        return V @ others, others.T @ images

    def without_means(self, residual: Array) -> Array:
        """(I - Mᵀ Zᵀ) r, (unknowns,) (collective)."""
        work = self._comm.allreduce(self._Z.T @ residual)
        rows = np.zeros(self._C.getLocalSize()[0])
        rows[self._wide] = work[self._of_rank]
        return residual - multiply_transposed(self._C, rows)

    def hold_means(self, z: Array, c: Array | None = None) -> Array:
        """(I - Z M) z, or z + Z (c - M z) with c (rows,); (unknowns,) (collective)."""
        jumps = multiply(self._C, z) if c is None else multiply(self._C, z) - c
        moved = np.concatenate(self._comm.allgather(jumps[self._wide]))
        return np.asarray(z - self._Z @ moved)

    def leaves(self, residual: Array, load: Array) -> bool:
        """Whether a residual drives a motion that the active rows leave free (collective).

        Parameters
        ----------
        residual : (unknowns,)
            Initial residual, projected.
        load : (unknowns,)
            Load with which the residual is compared.
        """
        if self.empty or not self._free.shape[1]:
            return False
        work = self._comm.allreduce(self._Wt @ residual)
        scale = self._comm.allreduce(abs(self._Wt) @ np.abs(load)).max(initial=0.0)
        force = self._comm.allreduce(float(np.abs(load).sum()))
        largest = float(abs(self._Wt).max()) if self._Wt.shape[1] else 0.0
        along = self._comm.allreduce(largest, op=MPI.MAX)
        least = max(OPTIONS.unbalanced * scale, OPTIONS.no_work * force * along)
        return bool(np.abs(self._free.T @ work).max() > least)

    def balance(self, residual: Array, moved: Array) -> Array:
        """Q (r - K v) for a displacement v (unknowns,) if the space is not empty."""
        work = self._comm.allreduce(self._Wt @ residual - self._KWt @ moved[self._at])
        return np.asarray(self._W @ (self._inverse @ work))

    def correct(self, residual: Array, z: Array) -> Array:
        """(I - Q K) z + Q r."""
        if self.empty:
            return z
        along = self._comm.allreduce(self._Wt @ residual - self._KWt @ z[self._at])
        return np.asarray(z + self._W @ (self._inverse @ along))
