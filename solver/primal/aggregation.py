"""Prolongations of smoothed aggregation (P. Vaněk, J. Mandel, M. Brezina, Computing 56, 1996).

Nodes with strong couplings make aggregates, found by PETSc's GAMG on the graph of this rank's
nodes. On each aggregate the rigid motions R, orthonormalised there, are the columns of the
tentative prolongation P₀; R = P₀ R_c gives the rigid motions R_c of the coarse level. One step of
Jacobi's method smooths them: P = (I - ω D⁻¹ A) P₀.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.primal.block_rows import BlockRows
from solver.primal.petsc_options import lent_options
from solver.vectors import Array, Ints

DEPENDENT = 1e-11
"""Square of a motion on an aggregate, without its part in the motions before it, relative to the
whole, up to which it depends on these: on few nodes not all motions are independent."""


@dataclass(frozen=True, eq=False)
class Coarse:
    """A coarser level."""

    P: BlockRows
    """Smoothed prolongation."""
    rigid: Array  # (aggregates, motions, motions)
    """The rigid motions of the coarse level, R_c."""


def coarsened(
    A: BlockRows, rigid: Array, damping: float, threshold: float, aggressive: bool
) -> Coarse | None:
    """The level of the aggregates of the nodes; None if none is coarser (collective).

    Parameters
    ----------
    rigid : (nodes, unknowns per node, motions)
        R at this rank's nodes.
    damping
        ω.
    threshold, aggressive
        As in `solver.primal.hierarchy.MultigridOptions`.
    """
    aggregate = _aggregates(_graph(A), threshold, aggressive)
    basis, coarse, aggregate = _orthonormal(rigid, aggregate)
    nodes, count = np.flatnonzero(aggregate >= 0), len(coarse)
    total = A.comm.allreduce(count)
    if not 0 < total < A.comm.allreduce(A.rows):
        return None
    first = A.comm.exscan(count) or 0
    has = np.zeros(A.rows + 1, np.int64)
    has[nodes + 1] = 1
    size = rigid.shape[1:]
    tentative = sparse.bsr_matrix(
        (basis[nodes], first + aggregate[nodes], np.cumsum(has)),
        shape=(A.rows * size[0], total * size[1]), blocksize=size,
    )  # fmt: skip
    P0 = BlockRows(A.comm, tentative, count)
    correction = A.times(P0).local
    row = np.repeat(np.arange(A.rows), np.diff(correction.indptr))
    diagonal = _diagonal(A)
    inverse = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    correction.data *= (-damping * inverse)[row, :, None]
    return Coarse(BlockRows(A.comm, tentative + correction, count), coarse)


def _own_columns(A: BlockRows) -> tuple[Ints, Ints, Array]:
    """Row, column and entries of the blocks between this rank's nodes."""
    first = A.comm.exscan(A.columns) or 0
    row = np.repeat(np.arange(A.rows), np.diff(A.local.indptr))
    column = A.local.indices.astype(np.int64) - first
    here = (column >= 0) & (column < A.columns)
    if here.all():
        return row, column, A.local.data
    return row[here], column[here], A.local.data[here]


def _diagonal(A: BlockRows) -> Array:
    """Diagonal entries, (nodes, unknowns per node)."""
    row, column, values = _own_columns(A)
    result = np.zeros((A.rows, A.local.blocksize[0]))
    on = row == column
    result[row[on]] = np.diagonal(values[on], axis1=1, axis2=2)
    return result


def _graph(A: BlockRows) -> sparse.csr_matrix:
    """Frobenius norms of the blocks between this rank's nodes, (nodes, nodes)."""
    row, column, values = _own_columns(A)
    norms = np.sqrt(np.einsum("nij,nij->n", values, values))
    return sparse.csr_matrix((norms, (row, column)), shape=(A.rows, A.rows))


def _aggregates(graph: sparse.csr_matrix, threshold: float, aggressive: bool) -> Ints:
    """The aggregate of each node, (nodes,). Nodes without strong couplings have one each."""
    graph.sort_indices()
    count = graph.shape[0]
    aggregate = np.full(count, -1)
    if count < 2:
        return np.arange(count)
    begins, places = (part.astype(PETSc.IntType) for part in (graph.indptr, graph.indices))
    matrix = PETSc.Mat().createAIJ(
        graph.shape, csr=(begins, places, graph.data), comm=PETSc.COMM_SELF
    )
    prefix = "contact_gamg_"
    settings = {
        "pc_gamg_threshold": threshold,
        "pc_gamg_agg_nsmooths": 0,
        "pc_gamg_coarse_eq_limit": count - 1,  # ends after one level
        # the name until PETSc 3.18, and the one since
        "pc_gamg_square_graph": int(aggressive),
        "pc_gamg_aggressive_coarsening": int(aggressive),
        "mg_levels_pc_type": "none",
        "mg_levels_ksp_type": "richardson",
        "mg_coarse_pc_type": "none",
        "mg_coarse_ksp_type": "preonly",
    }
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOperators(matrix)
    pc.setOptionsPrefix(prefix)
    pc.setType("gamg")
    with lent_options(prefix, settings):
        pc.setFromOptions()
        pc.setUp()
    if pc.getMGLevels() > 1:
        begins, places, _ = pc.getMGInterpolation(1).getValuesCSR()
        aggregate[np.diff(begins) > 0] = places
    pc.destroy()
    matrix.destroy()
    alone = np.flatnonzero(aggregate < 0)
    aggregate[alone] = aggregate.max(initial=-1) + 1 + np.arange(len(alone))
    return aggregate


def _orthonormal(rigid: Array, aggregate: Ints) -> tuple[Array, Array, Ints]:
    """The motions orthonormalised on each aggregate, R_c, and the aggregate of each node.

    Motions that depend on those before them become zero. Aggregates without any motion are left
    out. Cholesky's factor of the Gram matrices is made twice, so that rounding errors of the first
    are gone (A. Stathopoulos, K. Wu, SIAM J. Sci. Comput. 23, 2002).
    """
    basis, count = rigid, int(aggregate.max(initial=-1)) + 1
    order = np.argsort(aggregate, kind="stable")
    starts = np.searchsorted(aggregate[order], np.arange(count))
    coarse = np.tile(np.eye(rigid.shape[2]), (count, 1, 1))
    for _ in range(2 if count else 0):
        ordered = basis[order]
        gram = np.add.reduceat(np.swapaxes(ordered, 1, 2) @ ordered, starts)
        upper, inverse = _cholesky(gram)
        basis = basis @ inverse[aggregate]
        coarse = upper @ coarse
    some = coarse.any(axis=(1, 2))
    number = np.where(some, np.cumsum(some) - 1, -1)
    return basis, coarse[some], number[aggregate]


def _cholesky(gram: Array) -> tuple[Array, Array]:
    """Upper factors of Gram matrices (n, k, k) and their inverses; zero for dependent columns."""
    k = gram.shape[1]
    upper, inverse = np.zeros((2, *gram.shape))
    for j in range(k):
        row = gram[:, j] - np.einsum("ni,nij->nj", upper[:, :j, j], upper[:, :j])
        square = row[:, j]
        some = square > DEPENDENT * gram[:, j, j]
        root = np.sqrt(np.where(some, square, 1.0))
        upper[:, j, j:] = np.where(some[:, None], row[:, j:] / root[:, None], 0.0)
        inverse[:, j, j] = np.where(some, 1.0 / root, 0.0)
        above = np.einsum("nim,nm->ni", inverse[:, :j, :j], upper[:, :j, j])
        inverse[:, :j, j] = -above * inverse[:, j, j][:, None]
    return upper, inverse
