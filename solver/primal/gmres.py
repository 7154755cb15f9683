"""The generalised minimal residual method, with a preconditioner on the right.

Y. Saad, M. H. Schultz, *GMRES: a generalized minimal residual algorithm for solving nonsymmetric
linear systems*, SIAM J. Sci. Stat. Comput. 7, 1986. Friction that follows the contact forces makes
the matrix of a set unsymmetric, by few rows.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.qp.preconditioner import Preconditioner
from solver.vectors import Array


@dataclass(frozen=True)
class GMRESLimits:
    """The end of the iteration."""

    reduction: float = 0.01
    """Reduction of the residual; a factor reduces it by far more in one iteration. With the
    preconditioner of the symmetric part a collet with μ = 0.3 and 1 (`solver.primal.coupled`) took
    180 and 150 operator applications with 0.01, 195 and 239 with 1e-6, and with 0.1 a hook on a peg
    was not certified."""
    most: int = 30
    """Iterations; each has two vectors."""
    dependent: float = 1e-14
    """Share of a new vector outside of the space of the last ones that is a rounding error."""


def gmres(
    comm: MPI.Intracomm,
    product: Callable[[Array], Array],
    M: Preconditioner,
    rhs: Array,
    limits: GMRESLimits,
) -> tuple[list[Array], Array]:
    """Preconditioned directions and their shares in the solution (collective).

    Parameters
    ----------
    product
        Multiplies by a square matrix that need not be symmetric.
    """
    size = float(np.sqrt(comm.allreduce(float(rhs @ rhs))))
    basis, steps = [rhs / (size or 1.0)], list[Array]()
    H, target = np.zeros((limits.most + 1, limits.most)), np.zeros(limits.most + 1)
    target[0], shares, left = size, np.zeros(0), size
    while left > limits.reduction * size and len(steps) < limits.most:
        k = len(steps)
        steps.append(np.empty_like(rhs))
        M.apply(basis[k], np.zeros(0, bool), steps[k])
        image = product(steps[k])
        for _ in range(2):  # once leaves rounding errors
            along = comm.allreduce(np.array([v @ image for v in basis]))
            image = image - along @ np.array(basis)
            H[: k + 1, k] += along
        H[k + 1, k] = np.sqrt(comm.allreduce(float(image @ image)))
        shares = np.linalg.lstsq(H[: k + 2, : k + 1], target[: k + 2], rcond=None)[0]
        left = float(np.linalg.norm(H[: k + 2, : k + 1] @ shares - target[: k + 2]))
        if H[k + 1, k] <= limits.dependent * np.abs(H[: k + 1, k]).max():
            break
        basis.append(image / H[k + 1, k])
    return steps, shares
