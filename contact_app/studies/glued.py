"""Bodies glued at their contacts: the linear problem with which contact is compared.

Without contact a part may have no support at all. Therefore an unknown with a bound is held at its
bound. Between bodies every contact row Σ w_j n·u_j with its normal n is replaced by ties of all
components, Σ w_j u_j = 0, through springs as stiff as the bodies are there: with T the tied rows, A
= K + Tᵀ diag(s) T. With springs instead of constraints the matrix suits any solver; the near-null
space is that of the rigid motions of all bodies as one.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from contact_app.studies.undecomposed import WholeSystem
from solver.contact.row_kinds import RowKind
from solver.primal.factor import row_stiffness, with_springs
from solver.primal.hierarchy import near_kernel
from solver.primal.merged import MergedSystem
from solver.tfeti.constraints.matrix import local_rows, petsc_rows
from solver.tfeti.subdomain.kernels import rigid_motions


def hold_bounds(system: WholeSystem) -> None:
    """Hold unknowns with a bound at the bound, in place (collective)."""
    x = system.load.duplicate()
    upper, lower = system.upper.array, system.lower.array
    x.array[:] = np.where(upper < 1e300, upper, np.where(lower > -1e300, lower, 0.0))
    rows = np.unique(system.contact) + system.load.getOwnershipRange()[0]
    scale = system.matrix.getDiagonal().sum() / system.dofs
    system.matrix.zeroRowsColumns(rows.astype(PETSc.IntType), diag=scale, x=x, b=system.load)


def glued_matrix(system: MergedSystem) -> PETSc.Mat:
    """A of the glued bodies with its near-null space (collective)."""
    d = system.problem.dimension
    kinds = system.problem.kinds[system.rows]
    chosen = np.flatnonzero((kinds == RowKind.CONTACT) | (kinds == RowKind.TIED))
    tied = petsc_rows(system.comm, _tied_rows(local_rows(system.C)[chosen], d), system.size)
    stiff = np.repeat(row_stiffness(system)[chosen], d)
    A = with_springs(system.K, tied, stiff, np.zeros(system.size))
    A.setBlockSize(d)
    A.setOption(PETSc.Mat.Option.SPD, True)
    A.setNearNullSpace(_rigid_motions(system))
    return A


def _tied_rows(C: sparse.csr_matrix, d: int) -> sparse.csr_matrix:
    """Rows that tie all components where those of C (rows, unknowns) tie one, (rows · d, …)."""
    nodes = sparse.bsr_matrix(C, blocksize=(1, d))
    blocks = nodes.data.reshape(-1, d)
    row = np.repeat(np.arange(C.shape[0]), np.diff(nodes.indptr))
    length = np.linalg.norm(blocks, axis=1)
    longest = np.lexsort((length, row))[np.cumsum(np.diff(nodes.indptr)) - 1]
    normals = blocks[longest] / length[longest, None]
    weights = np.einsum("ij,ij->i", blocks, normals[row])
    shape = C.shape[0], C.shape[1] // d
    W = sparse.csr_matrix((weights, nodes.indices, nodes.indptr), shape=shape)
    return sparse.csr_matrix(sparse.kron(W, sparse.eye(d)))


def _rigid_motions(system: MergedSystem) -> PETSc.NullSpace:
    """The rigid motions of all bodies as one, orthonormal (collective)."""
    comm, d = system.comm, system.problem.dimension
    points = system.nodes.points[system.nodes.owned]
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    low, high = np.min(comm.allgather(low), axis=0), np.max(comm.allgather(high), axis=0)
    motions = rigid_motions(points, d, 0.5 * (low + high), float((high - low).max()))
    motions = motions.reshape(system.size, -1)
    motions[system.held] = 0.0
    return near_kernel(comm, motions)
