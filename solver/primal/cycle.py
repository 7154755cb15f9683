"""A V-cycle whose coarse corrections leave active rows alone: truncated coarse spaces.

A coarse correction that moves an active row is undone by the projector Π, and with it most of what
it corrected beside the contact. So the prolongation to the finest level is Π P instead of P
(C. Gräser, R. Kornhuber, *Multigrid methods for obstacle problems*, J. Comput. Math. 27, 2009), and
the coarse operators are Galerkin's. Π P differs from P at the nodes of active rows alone: with
Π P = P - E

    (P - E)ᵀ K (P - E) = Pᵀ K P - Eᵀ K (P - E) - Pᵀ K E

costs products with rows on the surface. So do the levels below: their operators change by Galerkin
products of that change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from solver.primal.hierarchy import Hierarchy, MultigridOptions, galerkin, lent_options
from solver.primal.projector import Projector
from solver.tfeti.constraints.matrix import local_rows
from solver.vectors import on_arrays

Array = NDArray[np.float64]

OTHER = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN


class Cycle:
    """One V-cycle as an approximate inverse, Chebyshev smoothing on all levels.

    Parameters
    ----------
    operators, prolongations
        As in `Hierarchy`.
    own
        Matrices that serve this cycle alone.
    """

    def __init__(
        self,
        operators: Sequence[PETSc.Mat],
        prolongations: Sequence[PETSc.Mat],
        options: MultigridOptions,
        own: Sequence[PETSc.Mat] = (),
    ) -> None:
        self.comm = operators[0].comm
        self._residual, self._correction = operators[0].createVecs()
        self._pc = pc = PETSc.PC().create(self.comm)
        prefix = "contact_cycle_"
        pc.setOptionsPrefix(prefix)
        pc.setOperators(operators[0])
        pc.setType("mg")
        levels = len(operators)
        pc.setMGLevels(levels)
        for k, operator in enumerate(operators):
            level = levels - 1 - k
            if level:
                pc.setMGInterpolation(level, prolongations[k])
            pc.getMGSmoother(level).setOperators(operator)
        inverse = coarse_inverse(operators[-1], options.singular)
        pc.getMGCoarseSolve().setOperators(operators[-1], inverse)
        self._own = (*own, inverse)
        given: dict[str, object] = {
            "mg_levels_ksp_type": "chebyshev",
            "mg_levels_ksp_max_it": options.smoothing,
            "mg_levels_ksp_norm_type": "none",
            "mg_levels_pc_type": "jacobi",
            "mg_coarse_ksp_type": "preonly",
            "mg_coarse_pc_type": "mat",  # applies the given inverse
        }
        with lent_options(prefix, given):
            pc.setFromOptions()
            pc.setUp()

    def apply(self, residual: Array, out: Array) -> None:
        """Put the correction into out."""
        on_arrays(self._pc.apply, self._residual, residual, self._correction, out)

    def destroy(self) -> None:
        """Free its memory now; petsc4py would free it later (collective)."""
        for made in (self._pc, *self._own, self._residual, self._correction):
            made.destroy()


def truncated_cycle(hierarchy: Hierarchy, projector: Projector) -> Cycle:
    """The cycle of an active set (collective)."""
    levels = truncated_levels(hierarchy, projector)
    own = () if levels is hierarchy else (levels.prolongations[0], *levels.operators[1:])
    return Cycle(levels.operators, levels.prolongations, levels.options, own)


def truncated_levels(hierarchy: Hierarchy, projector: Projector) -> Hierarchy:
    """Levels whose prolongation to the finest one leaves active rows alone (collective).

    Each intermediate matrix is freed where it has served: two products with K are as large as K.
    """
    operators, prolongations = list(hierarchy.operators), list(hierarchy.prolongations)
    if projector.empty or not prolongations:
        return hierarchy
    K, P = operators[0], prolongations[0]
    E = projector.truncating(P)
    KE = K.matMult(E)
    change = _change(P, E, KE)
    KE.destroy()
    prolongations[0] = P.copy()
    prolongations[0].axpy(-1.0, E, OTHER)
    E.destroy()
    for k in range(1, len(operators)):
        operators[k] = operators[k].copy()
        operators[k].axpy(-1.0, change, OTHER)
        finer = change
        if k < len(prolongations):
            change = galerkin(finer, prolongations[k])
        finer.destroy()
    return Hierarchy(tuple(prolongations), tuple(operators), hierarchy.options)


def _change(P: PETSc.Mat, E: PETSc.Mat, KE: PETSc.Mat) -> PETSc.Mat:
    """Pᵀ K E + Eᵀ K P - Eᵀ K E, by one product with P and a transpose (collective)."""
    change = P.transposeMatMult(KE)
    for sign, part in ((1.0, change.transpose(PETSc.Mat())), (-1.0, E.transposeMatMult(KE))):
        change.axpy(sign, part, OTHER)
        part.destroy()
    return change


def coarse_inverse(operator: PETSc.Mat, singular: float) -> PETSc.Mat:
    """The inverse of a small matrix that leaves rigid motions out, as a full matrix (collective).

    Every rank has the whole matrix; its eigenvalues take a tenth of the time of PETSc's ``svd`` on
    288 unknowns.

    Parameters
    ----------
    singular
        Eigenvalues below that share of the largest row sum belong to rigid motions.
    """
    comm = operator.comm.tompi4py()
    full = sparse.vstack(comm.allgather(local_rows(operator)), format="csr").toarray()
    values, vectors = np.linalg.eigh(0.5 * (full + full.T))
    stiff = values > singular * np.abs(full).sum(axis=1).max(initial=0.0)
    first, last = operator.getOwnershipRange()
    own = (vectors[first:last, stiff] / values[stiff]) @ vectors[:, stiff].T
    matrix = PETSc.Mat().createDense(operator.getSizes(), array=np.asfortranarray(own), comm=comm)
    matrix.assemble()
    return matrix
