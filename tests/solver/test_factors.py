"""Sparse factors, and the matrices that have none."""

import numpy as np
import pytest
from petsc4py import PETSc

from solver.factors import compute_factor


def cholesky(package: str, values: list[float]) -> tuple[PETSc.PC, PETSc.Mat]:
    """A preconditioner for a matrix with a diagonal, and the matrix."""
    n = len(values)
    rows = np.arange(n + 1, dtype=np.int32)
    csr = rows, rows[:n], np.array(values)
    matrix = PETSc.Mat().createAIJ((n, n), csr=csr, comm=PETSc.COMM_SELF)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setType("cholesky")
    pc.setFactorSolverType(package)
    return pc, matrix


@pytest.mark.parametrize("package", ["cholmod", "mumps"])
def test_a_factor_solves(package: str) -> None:
    pc, matrix = cholesky(package, [2.0, 4.0, 8.0])
    compute_factor(pc, matrix)
    b, x = matrix.createVecs()
    b.setArray([2.0, 4.0, 8.0])
    pc.apply(b, x)
    assert x.getArray() == pytest.approx(1.0)


@pytest.mark.parametrize("package", ["cholmod", "mumps"])
def test_a_singular_matrix_has_no_factor(package: str) -> None:
    """PETSc raises nothing where MUMPS fails, and the solutions are not finite."""
    pc, matrix = cholesky(package, [2.0, 0.0, 8.0])
    with pytest.raises(ArithmeticError, match="no factor"):
        compute_factor(pc, matrix)
