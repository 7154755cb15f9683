"""The projector onto displacements that keep active rows unchanged.

With D the diagonal of K and C_A the active rows,

    Π = I - D⁻¹ C_Aᵀ S⁻¹ C_A,  S = C_A D⁻¹ C_Aᵀ,

maps any displacement to the nearest one, in the norm of D, with C_A u = 0. Rows at single nodes
make S nearly diagonal, mortar rows make it a narrow band on the surface; its factor costs little
beside a product with K. The multipliers in equilibrium with a residual r are λ = S⁻¹ C_A D⁻¹ r, and
r - C_Aᵀ λ = Πᵀ r. Π does not move rigid bodies: rows that contain their unknowns alone have another
projector (`solver.primal.rigid_bodies`).
"""

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.primal.merged import MergedSystem
from solver.primal.products import chosen_rows, own_columns
from solver.primal.rigid_bodies import RowsOfMotions
from solver.primal.small_inverse import BorderedInverse, SmallInverse
from solver.problem.constraints.matrix import REDUNDANT
from solver.vectors import Array, Mask


class Projector:
    """Π and its data for one active set.

    Every rank has all active rows, restricted to its own unknowns, and the factor of S: Π takes one
    message, the sum of C_A u over ranks.

    Parameters
    ----------
    active : (rows,)
        Mask of the contact and tied rows that hold with equality.
    compliance : (rows,)
        Compliance of the active rows, added to S (see `solver.primal.springs`); None for none.
    wide
        The projector of these rows and others, which has S already; None for none.

    Attributes
    ----------
    rows : (active,)
        Places of these rows of this rank.
    compliance : (active,)
        Compliance of these rows; None for none.
    C : (active rows of all ranks, unknowns)
    """

    def __init__(
        self,
        system: MergedSystem,
        active: Mask,
        compliance: Array | None = None,
        wide: "Projector | None" = None,
    ) -> None:
        self.system, comm = system, system.comm
        self.rows = np.flatnonzero(active)
        self.compliance = None if compliance is None else compliance[self.rows]
        masks, means = zip(*comm.allgather((active, system.means)), strict=True)
        self._counts = np.array([int(mask.sum()) for mask in masks])
        first = int(self._counts[: comm.rank].sum())
        self._of_rank = slice(first, first + len(self.rows))
        every = np.concatenate(masks)
        self.C = own_columns(system.C)[np.flatnonzero(every)]
        self.empty = not every.any()
        self._narrow: Projector | None = None
        if self.empty:
            return
        self._inverse = system.flexibility
        self._Ct = self.C.T  # in columns, so that a product skips the unknowns of no row
        self._DCt = _scaled(self.C, self._inverse).T
        self._every = every
        if wide is None:
            self._S, self._stiffless = self._sum_of_ranks()
        else:
            some = np.flatnonzero(every[wide._every])
            self._S, self._stiffless = wide._S[some][:, some], wide._stiffless[some]
        mean = np.concatenate(means)[every]
        if mean.any():
            self._narrow = Projector(system, active & ~system.means, compliance, self)
        self._inverse_of_rows: SmallInverse | BorderedInverse
        if self._narrow is None or self._narrow.empty:
            self._inverse_of_rows = SmallInverse(self._S)
        else:
            self._inverse_of_rows = BorderedInverse(self._narrow._inverse_of_rows, self._S, mean)
        self._of_motions: RowsOfMotions | None = None
        if system.has_rigid_bodies:
            C = chosen_rows(system.C, self.rows)
            self._of_motions = RowsOfMotions(system, C, self._stiffless[self._of_rank])

    @property
    def narrow(self) -> "Projector":
        """The projector without the rows that hold a motion in the mean of many nodes.

        Itself without such rows.
        """
        return self if self._narrow is None else self._narrow

    def _sum_of_ranks(self) -> tuple[sparse.csr_matrix, Mask]:
        """S = C_A D⁻¹ C_Aᵀ of all ranks, and the rows of rigid bodies alone (collective).

        S has the compliance, and one in the diagonal of rows of rigid bodies alone. Rigid bodies do
        not couple their rows.
        """
        scaled = _scaled(self.C, np.sqrt(self._inverse))
        if self.system.has_rigid_bodies:
            scaled.eliminate_zeros()
        S = sparse.csr_matrix(scaled @ scaled.T)
        if self.system.comm.size > 1:
            parts = self.system.comm.allgather(S)
            S = sum(parts[1:], start=parts[0])
        diagonal = S.diagonal()
        stiffless = diagonal == 0.0
        diagonal = np.where(stiffless, 1.0, (1.0 + REDUNDANT) * diagonal)
        if self.compliance is not None:
            diagonal += self._of_all(self.compliance)
        return _with_diagonal(S, diagonal), stiffless

    def _of_all(self, values: Array) -> Array:
        """Values of the active rows of all ranks from those of each (collective)."""
        if self.system.comm.size == 1:
            return values
        every = np.empty(self._counts.sum())
        self.system.comm.Allgatherv(np.ascontiguousarray(values), [every, self._counts])
        return every

    def _summed(self, u: Array) -> Array:
        """C_A u on all ranks (collective)."""
        every = self.C @ u
        if self.system.comm.size > 1:
            self.system.comm.Allreduce(MPI.IN_PLACE, every)
        return np.asarray(every)

    def multipliers(self, residual: Array) -> Array:
        """λ of the active rows in equilibrium with a residual (unknowns,), (active,)."""
        if self.empty:
            return np.zeros(0)
        return self._multipliers(residual)[self._of_rank]

    def _multipliers(self, residual: Array) -> Array:
        """λ of the active rows of all ranks (collective)."""
        every = self._inverse_of_rows.apply(self._summed(self._inverse * residual))
        if self._of_motions is None:
            return every
        result = every[self._of_rank].copy()
        self._of_motions.add_multipliers(result, residual - self._Ct @ every)
        return self._of_all(result)

    def apply(self, u: Array) -> Array:
        """Π u, of one displacement or of several (unknowns, displacements)."""
        if self.empty:
            return u
        return u - self._lifting(self._summed(u))

    def apply_transpose(self, residual: Array) -> Array:
        """Πᵀ r."""
        if self.empty:
            return residual
        return residual - self._Ct @ self._multipliers(residual)

    def lifting(self, jumps: Array) -> Array:
        """The smallest displacement with C_A u = jumps (active,), in the norm of D."""
        if self.empty:
            return np.zeros(self.system.size)
        return self._lifting(self._of_all(jumps))

    def _lifting(self, jumps: Array) -> Array:
        """The smallest displacement with given jumps of the active rows of all ranks."""
        if self._of_motions is None:
            return np.asarray(self._DCt @ self._inverse_of_rows.apply(jumps))
        motions = self._of_motions.lifting(jumps[self._of_rank])
        left = jumps - self._summed(motions)
        return np.asarray(motions + self._DCt @ self._inverse_of_rows.apply(left))

    def giving(self, residual: Array) -> Array:
        """D⁻¹ Bᵀ (S + C)⁻¹ C (S + C)⁻¹ B D⁻¹ r, the motion of rows with a compliance."""
        if self.compliance is None:
            return np.zeros(self.system.size)
        return self.lifting(self.compliance * self.multipliers(residual))


def _with_diagonal(S: sparse.csr_matrix, values: Array) -> sparse.csr_matrix:
    """A square matrix with another diagonal, in place where all entries of it are stored."""
    rows = np.repeat(np.arange(len(values)), np.diff(S.indptr))
    at = np.flatnonzero(S.indices == rows)
    if len(at) < len(values):
        return sparse.csr_matrix(S + sparse.diags(values - S.diagonal()))
    S.data[at] = values[S.indices[at]]
    return S


def _scaled(matrix: sparse.csr_matrix, scale: Array) -> sparse.csr_matrix:
    """A matrix with scaled columns."""
    result = matrix.copy()
    result.data *= scale[matrix.indices]
    return result
