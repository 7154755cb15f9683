"""Sparse Cholesky factors of PETSc matrices."""

from __future__ import annotations

from petsc4py import PETSc

from solver.openmp import one_openmp_thread


def factored(matrix: PETSc.Mat) -> PETSc.PC:
    """A factor by CHOLMOD, by MUMPS on several ranks (collective).

    Raises
    ------
    ArithmeticError
        The matrix has none.
    """
    pc = PETSc.PC().create(matrix.comm)
    pc.setOperators(matrix)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    pc.setType("cholesky")
    pc.setFactorSolverType("cholmod" if matrix.comm.size == 1 else "mumps")
    try:
        with one_openmp_thread():
            pc.setUp()
    except PETSc.Error as error:
        raise ArithmeticError("a sparse matrix has no Cholesky factor") from error
    return pc
