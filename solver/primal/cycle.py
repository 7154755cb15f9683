"""V-cycles, and the one whose coarse corrections leave active rows alone.

A coarse correction that moves an active row is undone by the projector Π, and with it most of what
it corrected beside the contact. So the prolongation to the finest level is Π P instead of P
(C. Gräser, R. Kornhuber, *Multigrid methods for obstacle problems*, J. Comput. Math. 27, 2009).
Π is applied, and Π P is never made; smoothing steps are projected, too (`solver.primal.smoother`).
The Galerkin operator Pᵀ Πᵀ K Π P of Π P is the sum of Pᵀ K P and of the energy that it takes to
move the active rows back to where they were before the coarse displacement. A spring on each active
row, as stiff as K is against this row alone, takes nearly the same energy:

    A₁ = Pᵀ K P + Qᵀ diag(s) Q,  Q = C_A P,

and coarser levels are Galerkin's. From one set to the next the springs of few rows change, so that
a cycle follows the active set at little cost. For rows with a compliance C
(`solver.primal.springs`) Π has S + C in place of S, and the spring is that of K and C in series,
1 / (1/s + C).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import local_rows, petsc_rows
from solver.primal.block_rows import BlockRows
from solver.primal.blocks import in_blocks, petsc_blocks, rows_in_blocks
from solver.primal.factor import row_stiffness
from solver.primal.hierarchy import Hierarchy, MultigridOptions
from solver.primal.merged import MergedSystem
from solver.primal.petsc_options import lent_options
from solver.primal.products import multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.primal.smoother import Smoother
from solver.vectors import Array, Ints, Mask, on_arrays


class Cycle:
    """One V-cycle as an approximate inverse, Chebyshev smoothing on all levels.

    Parameters
    ----------
    operators, prolongations
        As in `Hierarchy`.
    """

    def __init__(
        self,
        operators: Sequence[PETSc.Mat],
        prolongations: Sequence[PETSc.Mat],
        options: MultigridOptions,
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
        self._inverse = inverse
        settings: dict[str, object] = {
            **{f"mg_levels_{name}": value for name, value in _smoothing(options).items()},
            "mg_coarse_ksp_type": "preonly",
            "mg_coarse_pc_type": "mat",  # applies the given inverse
        }
        with lent_options(prefix, settings):
            pc.setFromOptions()
            pc.setUp()

    def apply(self, residual: Array, out: Array) -> None:
        """Put the correction into out."""
        on_arrays(self._pc.apply, self._residual, residual, self._correction, out)

    def destroy(self) -> None:
        """Free its memory now; petsc4py would free it later (collective)."""
        for made in (self._pc, self._inverse, self._residual, self._correction):
            made.destroy()


@dataclass(frozen=True, eq=False)
class CycleWithSprings:
    """The cycle of the level below the finest one with springs on contact rows."""

    cycle: Cycle
    operators: Sequence[BlockRows]
    """Stiffness of its levels with springs."""
    springs: Array  # (rows,)
    """Stiffness of each spring; zero for open rows."""
    rows: Sequence[BlockRows]
    """C on each of its levels."""


class CycleOnSets:
    """One V-cycle that leaves the active rows alone and follows the active set.

    Without active rows it is `Cycle` on all levels of the hierarchy, which has at least two.

    Parameters
    ----------
    made
        The cycle of the coarser levels of the first set, to begin with.

    Attributes
    ----------
    rows : list of BlockRows
        C on each coarser level.
    """

    def __init__(
        self, system: MergedSystem, hierarchy: Hierarchy, made: CycleWithSprings | None = None
    ) -> None:
        K, self._P = hierarchy.operators[0], hierarchy.prolongations[0]
        self._K = in_blocks(K)
        self._smoother = Smoother(self._K, system.flexibility, hierarchy)
        self._prolongations = hierarchy.prolongations
        self._options = hierarchy.options
        self._unturned = self._system = system
        self._coarse: Cycle | None = None
        if made is None:
            self._operators = [rows_in_blocks(operator) for operator in hierarchy.operators[1:]]
            self._springs = np.zeros(len(system.rows))
            self.rows = rows_on_levels(system.C, self._prolongations)
        else:
            self._coarse, self._operators = made.cycle, list(made.operators)
            self._springs, self.rows = made.springs, list(made.rows)

    def _cycle(self) -> Cycle:
        operators = [petsc_blocks(rows) for rows in self._operators]
        return Cycle(operators, self._prolongations[1:], self._options)

    def adapt_to(self, projector: Projector) -> None:
        """Adapt to another active set, the frames and compliances of its rows (collective)."""
        self._projector = projector.narrow
        system, comm = projector.system, self._K.comm.tompi4py()
        springs = self._springs_of(self._projector)
        differs = (springs != self._springs) | (system.angles != self._system.angles)
        counts = int(self._clearly(springs, system).sum()), len(self._projector.rows)
        changed, rows = comm.allreduce(np.array(counts))
        if self._coarse is not None and changed <= self._options.changed * rows:
            return
        changes = self._changes(system, springs, differs)
        self._operators = [A.plus(new) for A, new in zip(self._operators, changes, strict=True)]
        self._system, self._springs = system, springs
        if self._coarse is not None:
            self._coarse.destroy()
        self._coarse = self._cycle()  # PETSc's own would keep parts of its set-up

    @property
    def coarse(self) -> Cycle:
        """The cycle of the coarser levels, with the springs of a set."""
        assert self._coarse is not None
        return self._coarse

    def projects_by(self, projector: Projector) -> bool:
        """Whether corrections already leave the rows of a projector alone."""
        return projector is self._projector and projector.compliance is None

    def _springs_of(self, projector: Projector) -> Array:
        """Stiffness of the spring of each row, (rows,) (collective)."""
        stiff = row_stiffness(projector.system)
        springs, rows = np.zeros(len(stiff)), projector.rows
        springs[rows] = stiff[rows]
        if projector.compliance is not None:
            springs[rows] /= 1.0 + stiff[rows] * projector.compliance
        return springs

    def _clearly(self, springs: Array, system: MergedSystem) -> Mask:
        """Rows whose spring or frame changes by more than `MultigridOptions.noticed`, (rows,)."""
        before, most = self._springs, np.maximum(springs, self._springs)
        noticed = self._options.noticed
        turned = np.abs(np.sin(system.angles - self._system.angles)) > noticed
        return (np.abs(springs - before) > noticed * most) | (turned & (most > 0.0))

    def _changes(self, system: MergedSystem, springs: Array, differs: Mask) -> list[BlockRows]:
        """The change of the springs on each coarse level (collective)."""
        parts = [(system, springs), (self._system, -self._springs)]
        if system is self._system:
            parts = [(system, springs - self._springs)]
        groups, weights = [], []
        for one, stiff in parts:
            some = np.flatnonzero(differs & (stiff != 0.0))
            groups.append(self._on_levels(one, some))
            weights.append(stiff[some])
        weight = np.concatenate(weights)
        changes = []
        for group in zip(*groups, strict=True):
            rows = BlockRows.stacked(group).scaled(np.sqrt(np.abs(weight)))
            changes.append(rows.transposed_times(rows.scaled(np.sign(weight))))
        return changes

    def _on_levels(self, system: MergedSystem, some: Ints) -> list[BlockRows]:
        """Some rows of this rank on each coarse level (collective)."""
        if system is self._unturned:
            return [rows.some(some) for rows in self.rows]
        chosen = petsc_rows(system.comm, local_rows(system.C)[some], system.size)
        return rows_on_levels(chosen, self._prolongations)

    def apply(self, residual: Array, out: Array) -> None:
        """Put the correction of a residual Πᵀ r into out."""
        projector = self._projector
        out[:] = self._smoother.begin(residual, projector)
        left = residual - multiply(self._K, out)
        coarse = multiply_transposed(self._P, projector.apply_transpose(left))
        correction = np.empty_like(coarse)
        assert self._coarse is not None
        self._coarse.apply(coarse, correction)
        out += projector.apply(multiply(self._P, correction))
        self._smoother.apply(residual, out, projector)


def rows_on_levels(C: PETSc.Mat, prolongations: Sequence[PETSc.Mat]) -> list[BlockRows]:
    """C P₁, C P₁ P₂, …: rows on each coarse level, in the blocks of its unknowns (collective)."""
    result = [BlockRows.of_rows(C, P.getBlockSizes()[0]) for P in prolongations[:1]]
    for P in prolongations:
        result.append(result[-1].times_matrix(P))
    return result[1:]


def _smoothing(options: MultigridOptions) -> dict[str, object]:
    return {
        "ksp_type": "chebyshev",
        "ksp_max_it": options.smoothing,
        "ksp_norm_type": "none",
        "pc_type": "jacobi",
    }


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
    local = rows_in_blocks(operator).local.tocsr()
    full = sparse.vstack(comm.allgather(local), format="csr").toarray()
    values, vectors = np.linalg.eigh(0.5 * (full + full.T))
    stiff = values > singular * np.abs(full).sum(axis=1).max(initial=0.0)
    first, last = operator.getOwnershipRange()
    block = (vectors[first:last, stiff] / values[stiff]) @ vectors[:, stiff].T
    matrix = PETSc.Mat().createDense(operator.getSizes(), array=np.asfortranarray(block), comm=comm)
    matrix.assemble()
    return matrix
