"""Sparse Cholesky and LU factors, by CHOLMOD on one rank, by MUMPS on several; their cost."""

from petsc4py import PETSc

from solver.openmp import one_openmp_thread

WORK_SPACE = (20, 100, 500)
"""MUMPS's ICNTL(14): its work space in percent beyond its own estimate. The first is its default.
Where rows of contact fill the factor it does not suffice: with it a roller between two blocks
(2,397 unknowns, two ranks) had no factor."""

TOO_LITTLE_SPACE = (-8, -9, -14, -15, -17, -20)
"""Values of MUMPS's INFOG(1) that more of ICNTL(14) mends (its users' guide, section on errors)."""


def compute_factor(pc: PETSc.PC, matrix: PETSc.Mat) -> None:
    """Factorise a matrix by a preconditioner of the kind `cholesky` or `lu` (collective).

    PETSc raises no error where MUMPS fails: its solutions are then infinite.

    Raises
    ------
    ArithmeticError
        The matrix has no such factor.
    """
    no_factor = "a sparse matrix has no factor"
    by_mumps = pc.getFactorSolverType() == "mumps"
    for percent in WORK_SPACE:
        pc.setOperators(matrix)
        if by_mumps:
            pc.setFactorSetUpSolverType()
            pc.getFactorMatrix().setMumpsIcntl(14, percent)
        try:
            with one_openmp_thread():
                pc.setUp()
        except PETSc.Error as error:
            raise ArithmeticError(no_factor) from error
        fault = pc.getFactorMatrix().getMumpsInfog(1) if by_mumps else 0
        if fault >= 0:
            return
        pc.reset()
        if fault not in TOO_LITTLE_SPACE:
            break
    raise ArithmeticError(f"{no_factor} (MUMPS ends with {fault})")


def factor_seconds(unknowns: float, order: int, dimension: int = 3) -> float:
    """Seconds of the sparse factors of a body with so many unknowns."""
    if dimension == 2:
        return 3.5e-6 * unknowns
    return order * 1e-9 * (unknowns / order) ** 2
