"""The inverse on the coarsest level of a V-cycle."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from solver.primal.cycle import coarse_inverse
from tests.ranks import execute

CODE = """
from tests.solver.primal.test_coarse_inverse import worst_error
from mpi4py import MPI
assert worst_error(MPI.COMM_WORLD) < 1e-12
"""


def worst_error(comm: MPI.Intracomm) -> float:
    """Largest difference to the pseudo-inverse of a chain of springs with nothing to hold it."""
    n = 7
    full = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    full[0, 0] = full[-1, -1] = 1.0
    matrix = PETSc.Mat().createAIJ((n, n), comm=comm)
    matrix.setUp()
    for i in range(*matrix.getOwnershipRange()):
        matrix.setValues([i], list(range(n)), full[i])
    matrix.assemble()
    inverse = coarse_inverse(matrix, 1e-10)
    x, y = inverse.createVecs()
    given = np.cos(np.arange(n))
    x.array[:] = given[slice(*x.getOwnershipRange())]
    inverse.mult(x, y)
    found = np.concatenate(comm.allgather(y.array.copy()))
    return float(np.abs(found - np.linalg.pinv(full) @ given).max())


def test_rigid_motions_are_left_out() -> None:
    """A free chain moves as a whole without force: its inverse leaves the motion out."""
    assert worst_error(MPI.COMM_WORLD) < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_share_the_inverse(ranks: int) -> None:
    """Each rank has the rows of its unknowns."""
    execute(CODE, ranks=ranks)
