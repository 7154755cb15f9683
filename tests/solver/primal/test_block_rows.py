"""Products in dense blocks, and the prolongation of smoothed aggregation."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from solver.distributed import local_rows
from solver.primal.aggregation import coarsened
from solver.primal.block_rows import BlockRows
from tests.ranks import execute

CODE = """
from tests.solver.primal.test_block_rows import worst_error
from mpi4py import MPI
for nodes in (12, 2):
    for coupled in (True, False):
        assert worst_error(MPI.COMM_WORLD, nodes, coupled) < 1e-13
"""


def worst_error(comm: MPI.Intracomm, nodes: int = 12, coupled: bool = True) -> float:
    """Largest difference to SciPy's products of single entries, over all ranks.

    Parameters
    ----------
    coupled
        Whether nodes have entries in the rows of others; bodies of different ranks have not.
    """
    aggregates = nodes // 2 + 1
    A = sparse.random(3 * nodes, 3 * nodes, 0.2, "csr", random_state=1)
    P = sparse.random(3 * nodes, 6 * aggregates, 0.3, "csr", random_state=2)
    if not coupled:
        A = A.multiply(sparse.kron(sparse.eye(nodes), np.ones((3, 3)))).tocsr()
    rows, columns = (
        np.array_split(np.arange(n), comm.size)[comm.rank] for n in (nodes, aggregates)
    )
    fine, coarse = (np.repeat(part * d, d) + np.tile(np.arange(d), len(part))
                    for part, d in ((rows, 3), (columns, 6)))  # fmt: skip
    left = BlockRows(comm, A[fine].tobsr((3, 3)), len(rows))
    right = BlockRows(comm, P[fine].tobsr((3, 6)), len(columns))
    product = left.galerkin(right)
    again = product.to_petsc()
    differences = (
        left.times(right).local - (A @ P)[fine],
        left.times_matrix(right.to_petsc()).local - (A @ P)[fine],
        product.local - (P.T @ A @ P)[coarse],
        local_rows(again) - (P.T @ A @ P)[coarse],
        BlockRows.of(again).local - product.local,
        right.gram().local - (P.T @ P)[coarse],
    )
    largest = [np.abs(part.data).max(initial=0.0) for part in differences]
    return float(comm.allreduce(max(largest), op=MPI.MAX))


def test_products_are_those_of_single_entries() -> None:
    """A P, Pᵀ A P and Pᵀ P."""
    assert worst_error(MPI.COMM_SELF) < 1e-13


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_share_the_products(ranks: int) -> None:
    """Rows that other ranks have are fetched, and sums for them are sent; a rank may need none."""
    execute(CODE, ranks=ranks)


def test_coarse_motions_are_the_rigid_motions() -> None:
    """A beam in the plane on which nothing acts, A R = 0: P R_c is R.

    All nodes are on a line and the last one is apart, so that motions on aggregates depend on each
    other.
    """
    count = 40
    x = np.linspace(0.0, 1.0, count)
    rigid = np.zeros((count, 2, 3))
    rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
    rigid[:, 1, 2] = x
    # second differences: no force under translation and rotation
    bend = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], (count - 3, count))
    stretch = sparse.diags([-1.0, 1.0], [0, 1], (count - 2, count))
    along, across = stretch.T @ stretch, bend.T @ bend
    A = sparse.kron(along, np.diag([1.0, 0.0])) + sparse.kron(across, np.diag([0.0, 1.0]))
    level = coarsened(
        BlockRows(MPI.COMM_SELF, A.tobsr((2, 2)), count), rigid, 1.4 / 3.0, 0.005, False
    )
    assert level is not None
    assert 0 < len(level.rigid) < count / 2
    motions = level.P.local @ level.rigid.reshape(-1, 3)
    assert np.abs(motions - rigid.reshape(-1, 3)).max() < 1e-12
    full = level.P.local.toarray()
    assert np.isfinite(full).all()
