"""Rows of an active set with a compliance: sliding points in space, across their slip.

In such a row B u - c = C λ with a compliance C (`solver.backend.Statuses`). It is a spring of
stiffness 1/C: K becomes K + Bᵀ C⁻¹ B. The fine level of the V-cycle does not contain the springs;
the preconditioner adds them. Let B be all active rows, C their compliances, zero in rows that hold
exactly, D the diagonal of K and S = B D⁻¹ Bᵀ. Then

    Π = I - D⁻¹ Bᵀ (S + C)⁻¹ B,      z = Π M⁻¹ Πᵀ r + D⁻¹ Bᵀ (S + C)⁻¹ C (S + C)⁻¹ B D⁻¹ r

does not move the rows that hold exactly, and for M = D it is the inverse of D + Bᵀ C⁻¹ B.
"""

from dataclasses import dataclass

import numpy as np

from solver.backend import Statuses
from solver.primal.block_rows import BlockRows
from solver.primal.blocks import in_blocks
from solver.primal.factor import row_stiffness
from solver.primal.merged import MergedSystem
from solver.primal.products import chosen_rows, multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.vectors import Array, Ints, Vector


class Springs:
    """The rows of a set that have a compliance.

    Parameters
    ----------
    stiffest
        Largest stiffness of such a row, relative to the stiffness of K against it. A point with
        such a small slip hardly changes its direction, and a stiffer spring takes digits from its
        force.

    Attributes
    ----------
    rows : (springs,)
        Places among the rows of the system.
    compliance : (springs,)
    empty
        Whether no rank has any.
    """

    def __init__(self, system: MergedSystem, statuses: Statuses, stiffest: float = 1e4) -> None:
        self._system = system
        self.rows = np.zeros(0, np.int64)
        self.compliance = np.zeros(0)
        if statuses.compliance is not None:
            compliance = np.where(statuses.active, statuses.compliance, 0.0)[system.rows]
            self.rows = np.flatnonzero(compliance > 0.0)
            self.compliance = compliance[self.rows]
        self.empty = system.comm.allreduce(len(self.rows)) == 0
        if not self.empty:
            least = 1.0 / (stiffest * row_stiffness(system)[self.rows])
            self.compliance = np.maximum(self.compliance, least)
            self._B = chosen_rows(system.C, self.rows)
            self._c = system.c[self.rows]

    @property
    def stiffness(self) -> Array | None:
        """C⁻¹ of its rows, zero on others, (rows,); None where no rank has any."""
        if self.empty:
            return None
        result = np.zeros(len(self._system.rows))
        result[self.rows] = 1.0 / self.compliance
        return result

    def softened(self, projector: Projector) -> Projector:
        """The projector with these rows and their compliance; itself where no rank has any."""
        if self.empty:
            return projector
        active = np.zeros(len(self._system.rows), bool)
        active[projector.rows] = active[self.rows] = True
        compliance = np.zeros(len(active))
        compliance[self.rows] = self.compliance
        return Projector(self._system, active, compliance)

    def forces(self, x: Array) -> Array:
        """Bᵀ C⁻¹ B x, (unknowns,)."""
        if self.empty:
            return np.zeros(self._system.size)
        stretched = multiply(self._B, x) / self.compliance
        return multiply_transposed(self._B, stretched)

    def multipliers(self, u: Array) -> Array:
        """C⁻¹ (B u - c), (springs,)."""
        if self.empty:
            return np.zeros(0)
        return np.asarray((multiply(self._B, u) - self._c) / self.compliance)

    def forces_at(self, u: Array) -> Array:
        """Bᵀ C⁻¹ (B u - c), (unknowns,)."""
        if self.empty:
            return np.zeros(self._system.size)
        return multiply_transposed(self._B, self.multipliers(u))


class ProjectedStiffness:
    """Πᵀ K on displacements that leave the active rows alone; `image` is K x itself.

    K with springs, where the set has some.
    """

    def __init__(self, system: MergedSystem, projector: Projector, springs: Springs) -> None:
        self.comm, self.size = system.comm, system.size
        self.system, self.projector, self._springs = system, projector, springs
        self.image = np.zeros(system.size)

    def product(self, x: Array) -> Array:
        """K x, with springs."""
        image = multiply(in_blocks(self.system.K), x)
        return image if self._springs.empty else image + self._springs.forces(x)

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product into out."""
        self.image = self.product(x)
        out[:] = self.projector.apply_transpose(self.image)


@dataclass(frozen=True, eq=False)
class Coupling:
    """Forces in some rows that follow the jumps of others, by local rows."""

    rows: Ints
    sources: Ints
    factors: Array
    """Row of each force, row of the jump, and force over jump. Shape (pairs,)."""

    def forces(self, jumps: Array) -> Array:
        """Forces (rows,) of jumps (rows,)."""
        result = np.zeros(len(jumps))
        result[self.rows] = self.factors * jumps[self.sources]
        return result

    def matrix(self, system: MergedSystem) -> BlockRows:
        """The forces of displacements on the unknowns (collective)."""
        C = BlockRows.of_rows(system.C, system.K.getBlockSize())
        return C.some(self.rows).scaled(self.factors).transposed_times(C.some(self.sources))


class CoupledStiffness:
    """The stiffness of a set and the forces of a coupling, which make it unsymmetric.

    Attributes
    ----------
    images
        Products with the stiffness alone, without the projector.
    """

    def __init__(self, stiffness: ProjectedStiffness, coupling: Coupling) -> None:
        self._stiffness, self._coupling = stiffness, coupling
        self.images: list[Array] = []

    def forces(self, image: Array) -> Array:
        """Projected forces (unknowns,) of jumps (rows,) (collective)."""
        C, projector = self._stiffness.system.C, self._stiffness.projector
        return projector.apply_transpose(multiply_transposed(C, self._coupling.forces(image)))

    def product(self, x: Array) -> Array:
        """The product with all forces (collective)."""
        out = np.empty_like(x)
        self._stiffness.apply(x, out)
        self.images.append(self._stiffness.image)
        return out + self.forces(multiply(self._stiffness.system.C, x))
