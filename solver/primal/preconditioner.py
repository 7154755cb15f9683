"""The preconditioner of a set: a V-cycle or a factor, the projector and the rigid motions."""

import numpy as np

from solver.primal.cycle import Cycle, CycleOnSets
from solver.primal.factor import Factor
from solver.primal.factor_on_sets import FactorOnSets
from solver.primal.projector import Projector
from solver.primal.rigid_space import RigidSpace
from solver.primal.springs import Coupling, Springs
from solver.vectors import Mask, Vector


class Preconditioner:
    """Π M⁻¹ with a V-cycle M⁻¹; rows with a compliance are added as in `solver.primal.springs`.

    Parameters
    ----------
    projector
        Without the rows that hold means if the space of rigid motions holds these.

    Attributes
    ----------
    square
        rᵀ M⁻¹ r of the last residual.
    """

    def __init__(
        self,
        cycle: Cycle | CycleOnSets | Factor | FactorOnSets,
        projector: Projector,
        rigid: RigidSpace,
        rigid_holds_means: bool,
    ) -> None:
        self._cycle, self._projector, self._rigid = cycle, projector, rigid
        self._rigid_holds_means = rigid_holds_means
        self._is_projected = isinstance(cycle, CycleOnSets) and cycle.projects_by(projector)
        self.square = 0.0

    def coupled(self, coupling: Coupling, springs: Springs) -> "Preconditioner | CoupledFactor":
        """That of a set with a coupling: a V-cycle leaves the coupling out (collective)."""
        if not isinstance(self._cycle, Factor):
            return self
        system, options = self._projector.system, self._cycle.options
        matrix = coupling.matrix(system)
        factor = Factor(system, self._projector, options, springs.stiffness, matrix)
        return CoupledFactor(factor, self._projector)

    def apply(self, r: Vector, free_mask: Mask, out: Vector) -> None:
        """Put the correction into out."""
        z, force = np.empty_like(r), r
        if self._rigid_holds_means:
            force = self._rigid.without_means(r)
        if self._projector.compliance is not None:
            self._cycle.apply(self._projector.apply_transpose(force), z)
            z = self._projector.apply(z) + self._projector.giving(force)
        else:
            if self._rigid_holds_means:
                force = self._projector.apply_transpose(force)
            self._cycle.apply(force, z)
            if not self._is_projected:
                z = self._projector.apply(z)
        if self._rigid_holds_means:
            z = self._rigid.hold_means(z)
        out[:] = self._rigid.correct(r, z)
        self.square = float(self._projector.system.comm.allreduce(float(r @ out)))


class CoupledFactor:
    """Π M⁻¹ with an LU factor that contains a coupling and the rigid motions."""

    def __init__(self, factor: Factor, projector: Projector) -> None:
        self._factor, self._projector = factor, projector

    def apply(self, r: Vector, free_mask: Mask, out: Vector) -> None:
        """Put the correction into out."""
        self._factor.apply(r, out)
        out[:] = self._projector.apply(out)
