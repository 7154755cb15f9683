"""A generalised inverse K⁺ of a singular stiffness by one sparse Cholesky factor.

Fixing nodes carry the regularisation (Brzobohatý, Dostál, Kozubek, Kovář, Markopoulos, *Cholesky
decomposition with fixing nodes to stable computation of a generalized inverse of the stiffness
matrix of a floating structure*, 2011): with N the rows of the kernel R at the fixing nodes and
zeros elsewhere,

    K_ρ = K + ρ N (Nᵀ N)⁻¹ Nᵀ

is positive definite, and K_ρ x = K u implies Rᵀ N (Nᵀ N)⁻¹ Nᵀ x = Nᵀ x = 0, hence K x = K u:
K K_ρ⁻¹ K = K exactly, whatever ρ. The factor is CHOLMOD's, through PETSc.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

COLUMNS_AT_ONCE = 256
"""Right-hand sides a sparse solve takes at once; more only cost memory."""


class GeneralisedInverse:
    """K⁺ of a symmetric positive semidefinite sparse matrix.

    Parameters
    ----------
    stiffness : (n, n)
        K.
    kernel : (n, k)
        Orthonormal basis of the null space; k = 0 for a definite matrix.
    fixing : (m,)
        Unknowns that carry the regularisation: the kernel restricted to them has full rank.

    Raises
    ------
    ArithmeticError
        The matrix has a larger null space than the kernel, or is not positive semidefinite.
    """

    def __init__(
        self,
        stiffness: sparse.csr_matrix,
        kernel: NDArray[np.float64],
        fixing: NDArray[np.int64],
    ) -> None:
        self.size = stiffness.shape[0]
        regular = stiffness.tocsr()
        if kernel.shape[1]:
            basis = np.linalg.qr(kernel[fixing])[0]
            ρ = float(stiffness.diagonal().mean())
            rows, columns = np.meshgrid(fixing, fixing, indexing="ij")
            block = sparse.csr_matrix(
                ((ρ * basis @ basis.T).ravel(), (rows.ravel(), columns.ravel())),
                shape=stiffness.shape,
            )
            regular = (regular + block).tocsr()
        regular.sort_indices()
        matrix = PETSc.Mat().createAIJ(
            regular.shape,
            csr=(regular.indptr.astype(PETSc.IntType), regular.indices.astype(PETSc.IntType),
                 regular.data),
            comm=PETSc.COMM_SELF,
        )  # fmt: skip
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setOperators(matrix)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("cholmod")
        try:
            self._pc.setUp()
        except PETSc.Error as error:
            raise ArithmeticError(
                "a subdomain's stiffness has no Cholesky factor once its rigid motions are "
                "fixed: it has further zero-energy modes, or cells of no volume"
            ) from error
        self._factor = self._pc.getFactorMatrix()

    def solve(self, loads: NDArray[np.float64]) -> NDArray[np.float64]:
        """K⁺ times each column: (n, columns) to (n, columns), both in Fortran order."""
        result = np.empty(loads.shape, order="F")
        loads = np.asfortranarray(loads)
        for begin in range(0, loads.shape[1], COLUMNS_AT_ONCE):
            part = slice(begin, begin + COLUMNS_AT_ONCE)
            b = PETSc.Mat().createDense(
                loads[:, part].shape, array=loads[:, part], comm=PETSc.COMM_SELF
            )
            x = PETSc.Mat().createDense(
                loads[:, part].shape, array=result[:, part], comm=PETSc.COMM_SELF
            )
            self._factor.matSolve(b, x)
            b.destroy()
            x.destroy()
        return result

    def restricted(self, unknowns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Dense block of K⁺ at some unknowns, (m, m), symmetric."""
        block = np.empty((len(unknowns), len(unknowns)))
        for begin in range(0, len(unknowns), COLUMNS_AT_ONCE):
            part = unknowns[begin : begin + COLUMNS_AT_ONCE]
            unit = np.zeros((self.size, len(part)), order="F")
            unit[part, np.arange(len(part))] = 1.0
            block[:, begin : begin + len(part)] = self.solve(unit)[unknowns]
        return 0.5 * (block + block.T)
