"""The projector onto displacements that keep active rows unchanged.

With D the diagonal of K and C_A the active rows,

    Π = I - D⁻¹ C_Aᵀ S⁻¹ C_A,  S = C_A D⁻¹ C_Aᵀ,

maps any displacement to the nearest one, in the norm of D, with C_A u = 0. Rows at single nodes
make S nearly diagonal, mortar rows make it a narrow band on the surface; its factor costs little
beside a product with K. The multipliers in equilibrium with a residual r are λ = S⁻¹ C_A D⁻¹ r, and
r - C_Aᵀ λ = Πᵀ r. Π does not move rigid bodies: rows that contain their unknowns alone have another
projector (`solver.primal.rigid_bodies`).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.primal.cholesky import SmallInverse
from solver.primal.merged import MergedSystem
from solver.primal.products import chosen_rows, multiply, multiply_transposed
from solver.primal.rigid_bodies import RowsOfMotions
from solver.tfeti.constraints.matrix import lent

Array = NDArray[np.float64]

REDUNDANT = 1e-12
"""Relative addition to the diagonal of S.

Dependent rows then share their force, and leave jumps of this size.
"""


class Projector:
    """Π and its data for one active set.

    Parameters
    ----------
    active : (rows,)
        Mask of the contact and tied rows that hold with equality.
    compliance : (rows,)
        Compliance of the active rows, added to S (see `solver.primal.springs`); None for none.

    Attributes
    ----------
    rows : (active,)
        Places of these rows of this rank.
    C : (active, unknowns)
    compliance : (active,)
        Compliance of these rows; None for none.
    """

    def __init__(
        self,
        system: MergedSystem,
        active: NDArray[np.bool_],
        compliance: Array | None = None,
    ) -> None:
        self.system, comm = system, system.comm
        self.rows = np.flatnonzero(active)
        self.empty = comm.allreduce(len(self.rows)) == 0
        self.C = chosen_rows(system.C, self.rows)
        self._inverse = system.flexibility
        self.compliance = None if compliance is None else compliance[self.rows]
        if self.empty:
            return
        moved = self.C if system.deforming is system.C else chosen_rows(system.deforming, self.rows)
        self.Ct = moved.transpose(PETSc.Mat())
        with lent(comm, self._inverse) as (inverse,):
            self.Ct.diagonalScale(L=inverse)
        self.S = moved.matMult(self.Ct)
        diagonal = self.S.getDiagonal()
        diagonal.scale(1.0 + REDUNDANT)
        if self.compliance is not None:
            diagonal.getArray()[:] += self.compliance
        stiffless = diagonal.getArray() == 0.0
        diagonal.getArray()[stiffless] = 1.0
        self.S.setDiagonal(diagonal)
        self._inverse_of_rows = SmallInverse(self.S)
        self._of_motions: RowsOfMotions | None = None
        if system.has_rigid_bodies:
            self._of_motions = RowsOfMotions(system, self.C, stiffless)

    def multipliers(self, residual: Array) -> Array:
        """λ of the active rows in equilibrium with a residual (unknowns,), (active,)."""
        if self.empty:
            return np.zeros(0)
        result = self._inverse_of_rows.apply(multiply(self.C, self._inverse * residual))
        if self._of_motions is not None:
            self._of_motions.add_multipliers(result, residual - self.forces(result))
        return result

    def forces(self, multipliers: Array) -> Array:
        """C_Aᵀ λ, (unknowns,)."""
        if self.empty:
            return np.zeros(self.system.size)
        return multiply_transposed(self.C, multipliers)

    def apply(self, u: Array) -> Array:
        """Π u."""
        if self.empty:
            return u
        return u - self.lifting(multiply(self.C, u))

    def apply_transpose(self, residual: Array) -> Array:
        """Πᵀ r."""
        if self.empty:
            return residual
        return residual - self.forces(self.multipliers(residual))

    def lifting(self, jumps: Array) -> Array:
        """The smallest displacement with C_A u = jumps (active,), in the norm of D."""
        if self.empty:
            return np.zeros(self.system.size)
        if self._of_motions is None:
            return multiply(self.Ct, self._inverse_of_rows.apply(jumps))
        motions = self._of_motions.lifting(jumps)
        left = jumps - multiply(self.C, motions)
        return motions + multiply(self.Ct, self._inverse_of_rows.apply(left))

    def giving(self, residual: Array) -> Array:
        """D⁻¹ Bᵀ (S + C)⁻¹ C (S + C)⁻¹ B D⁻¹ r, the motion of rows with a compliance."""
        if self.compliance is None:
            return np.zeros(self.system.size)
        return self.lifting(self.compliance * self.multipliers(residual))

    @cached_property
    def narrow(self) -> Projector:
        """The projector without the rows that hold a motion in the mean of many nodes.

        Itself without such rows (collective).
        """
        wide = self.system.means[self.rows]
        if not self.system.comm.allreduce(int(wide.any())):
            return self
        active = np.zeros(len(self.system.rows), bool)
        active[self.rows[~wide]] = True
        if self.compliance is None:
            return Projector(self.system, active)
        compliance = np.zeros(len(active))
        compliance[self.rows] = self.compliance
        return Projector(self.system, active, compliance)
