"""GMRES on small matrices that are not symmetric."""

import numpy as np
import pytest
from mpi4py import MPI

from solver.primal.gmres import GMRESLimits, gmres
from solver.vectors import Array, Mask


class Matrix:
    """A full matrix as operator and as preconditioner."""

    def __init__(self, values: Array) -> None:
        self.values = values

    def product(self, x: Array) -> Array:
        """The product."""
        return np.asarray(self.values @ x)

    def apply(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put the product into out."""
        out[:] = self.values @ r


@pytest.mark.parametrize("couples", [0, 1, 3])
def test_coupled_rows_cost_as_many_iterations_as_their_rank(couples: int) -> None:
    """The inverse of the symmetric part as preconditioner leaves the identity and few rows."""
    random = np.random.default_rng(couples)
    B = random.normal(size=(20, 20))
    symmetric = B @ B.T + 20.0 * np.eye(20)
    added = random.normal(size=(20, couples)) @ random.normal(size=(couples, 20))
    A, M, b = Matrix(symmetric + 5.0 * added), Matrix(np.linalg.inv(symmetric)), B[0]
    steps, shares = gmres(MPI.COMM_SELF, A.product, M, b, GMRESLimits(reduction=1e-10))
    assert len(steps) == couples + 1
    assert shares @ np.array(steps) == pytest.approx(np.linalg.solve(A.values, b), rel=1e-7)


def test_no_force_takes_no_iteration() -> None:
    """A right-hand side of zero."""
    one = Matrix(np.eye(3))
    steps, shares = gmres(MPI.COMM_SELF, one.product, one, np.zeros(3), GMRESLimits())
    assert not steps
    assert len(shares) == 0
