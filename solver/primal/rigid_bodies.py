"""Rigid bodies in the undecomposed problem: six unknowns more each, three in the plane.

Their rows and columns of K are zero; only contact rows, tied rows and rows that hold rigid motions
have entries in them. With q their unknowns and u all others, a row reads C_u u + C_q q.

The projector moves u alone, D⁻¹ = 0 on q: S keeps its narrow band, and Π e_j of a unit motion of a
rigid body moves the nodes of active rows along with the body. These motions are part of the coarse
space of `solver.primal.rigid_space`, which meets the balance of each rigid body exactly. The
V-cycle only has to treat the problem in which rigid bodies are held. Rows of q alone, as those of a
rigid body on held nodes, are held by a projector of their own (`RowsOfMotions`).

The coarse levels that find the first set contain q unchanged (`with_motions`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import local_rows, petsc_rows
from solver.primal.blocks import rows_in_blocks
from solver.primal.hierarchy import Hierarchy
from solver.primal.merged import MergedSystem
from solver.vectors import Array, Mask

DEPENDENT = 1e-10
"""Singular values of rows of rigid motions below that share of the largest are repetitions."""


class RowsOfMotions:
    """Active rows of unknowns of rigid bodies alone: C_q q = c (collective).

    Every rank has all of these rows, since the rows and their unknowns are few.

    Parameters
    ----------
    C : (active, unknowns)
        The active rows.
    chosen : (active,)
        Mask of these rows among the active rows of this rank.
    """

    def __init__(self, system: MergedSystem, C: PETSc.Mat, chosen: Mask) -> None:
        comm = system.comm
        self._comm, self._size = comm, system.size
        self._chosen = np.flatnonzero(chosen)
        counts = comm.allgather(len(self._chosen))
        self.empty = sum(counts) == 0
        if self.empty:
            return
        first = sum(counts[: comm.rank])
        self._local_rows = slice(first, first + len(self._chosen))
        self._q = np.flatnonzero(system.stiffless)
        columns = np.concatenate(comm.allgather(C.getOwnershipRangeColumn()[0] + self._q))
        starts = np.cumsum([0, *comm.allgather(len(self._q))])
        self._of_rank = slice(starts[comm.rank], starts[comm.rank + 1])
        local = local_rows(C)[self._chosen][:, columns].toarray()
        self._rows = np.concatenate(comm.allgather(local))
        self._inverse = np.linalg.pinv(self._rows, rcond=DEPENDENT)

    def add_multipliers(self, multipliers: Array, residual: Array) -> None:
        """Put λ of these rows, in balance with a residual (unknowns,), into all (active,)."""
        if self.empty:
            return
        forces = np.concatenate(self._comm.allgather(residual[self._q]))
        multipliers[self._chosen] = (self._inverse.T @ forces)[self._local_rows]

    def lifting(self, jumps: Array) -> Array:
        """The smallest motions with these jumps (active,); zero elsewhere, (unknowns,).

        Jumps in several columns have a motion for each.
        """
        result = np.zeros((self._size, *jumps.shape[1:]))
        if self.empty:
            return result
        every = np.concatenate(self._comm.allgather(jumps[self._chosen]))
        result[self._q] = (self._inverse @ every)[self._of_rank]
        return result


def with_motions(
    system: MergedSystem, hierarchy: Hierarchy, operators: Sequence[PETSc.Mat], springs: Array
) -> tuple[Hierarchy, Sequence[PETSc.Mat]]:
    """Levels that carry the unknowns of rigid bodies along, for the first set (collective).

    Parameters
    ----------
    operators
        Stiffness of each level.
    springs : (unknowns,)
        Springs that hold rigid bodies on coarser levels of a cycle, which need an inverse: the sum
        of the springs of all contact rows.

    Returns
    -------
    The levels for cycles, and the stiffness of each level, zero on rigid bodies.
    """
    if not system.has_rigid_bodies or not hierarchy.prolongations:
        return hierarchy, operators
    q = np.flatnonzero(system.stiffless)
    total = system.comm.allreduce(len(q))
    unit = sparse.eye(len(q), total, k=total - len(q), format="csr")  # the last rank has them
    stiffness = springs[q]
    stiffness = np.where(stiffness > 0.0, stiffness, 1.0)
    first = local_rows(hierarchy.prolongations[0])
    first = sparse.diags(np.where(system.stiffless, 0.0, 1.0)) @ first
    places = sparse.csr_matrix((np.ones(len(q)), (q, np.arange(len(q)))), (system.size, len(q)))
    first = sparse.hstack([first, places @ unit])
    prolongations = [_matrix(hierarchy.prolongations[0], first, len(q))]
    prolongations += [_with_block(P, unit) for P in hierarchy.prolongations[1:]]
    coarser = operators[1:]
    free = [operators[0], *(_with_block(A, 0.0 * unit) for A in coarser)]
    held = [operators[0], *(_with_block(A, sparse.diags(stiffness) @ unit) for A in coarser)]
    return replace(hierarchy, prolongations=tuple(prolongations), operators=tuple(held)), free


def _with_block(matrix: PETSc.Mat, block: sparse.csr_matrix) -> PETSc.Mat:
    """A matrix with a block of unknowns of rigid bodies after its last rows and columns."""
    joined = sparse.block_diag([rows_in_blocks(matrix).local.tocsr(), block])
    return _matrix(matrix, joined, block.shape[0])


def _matrix(like: PETSc.Mat, local: sparse.spmatrix, more: int) -> PETSc.Mat:
    """This rank's rows as a matrix with more columns than another."""
    rows = sparse.csr_matrix(local)
    rows.sort_indices()
    return petsc_rows(like.comm.tompi4py(), rows, like.getLocalSize()[1] + more)
