"""Sparse Cholesky and LU factors, by CHOLMOD on one rank, by MUMPS on several; their cost."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import petsc_rows
from solver.openmp import one_openmp_thread
from solver.vectors import Array, Ints, on_arrays

COLUMNS_AT_ONCE = 256
"""Number of right-hand sides of one sparse solve; more only cost memory."""

NO_FACTOR = "a sparse matrix has no factor"
"""Message about a matrix that is not positive definite."""

WORK_SPACE = (20, 100, 500)
"""MUMPS's ICNTL(14): its work space in percent beyond its own estimate. The first is its default.
Where rows of contact fill the factor it does not suffice: with it a roller between two blocks
(2,397 unknowns, two ranks) had no factor."""

TOO_LITTLE_SPACE = (-8, -9, -14, -15, -17, -20)
"""Values of MUMPS's INFOG(1) that more of ICNTL(14) mends (its users' guide, section on errors)."""


def compute_factor(pc: PETSc.PC, matrix: PETSc.Mat, no_factor: str = NO_FACTOR) -> None:
    """Factorise a matrix by a preconditioner of the kind `cholesky` or `lu` (collective).

    PETSc raises no error where MUMPS fails: its solutions are then infinite.

    Raises
    ------
    ArithmeticError
        The matrix has no such factor.
    """
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


def factored(matrix: PETSc.Mat, no_factor: str = NO_FACTOR, *, symmetric: bool = True) -> PETSc.PC:
    """A factor by CHOLMOD; by MUMPS on several ranks, or if not symmetric (collective).

    Raises
    ------
    ArithmeticError
        The matrix has no such factor.
    """
    pc = PETSc.PC().create(matrix.comm)
    matrix.setOption(PETSc.Mat.Option.SPD, symmetric)
    pc.setType("cholesky" if symmetric else "lu")
    pc.setFactorSolverType("cholmod" if symmetric and matrix.comm.size == 1 else "mumps")
    compute_factor(pc, matrix, no_factor)
    return pc


class CholeskyFactor:
    """CHOLMOD's factor of a sparse positive definite matrix, through PETSc.

    Raises
    ------
    ArithmeticError
        The matrix is not positive definite.
    """

    def __init__(self, matrix: sparse.spmatrix, no_factor: str = NO_FACTOR) -> None:
        rows = matrix.tocsr()
        rows.sort_indices()
        self.size = rows.shape[0]
        if not self.size:  # all unknowns are held: PETSc factors no empty matrix
            return
        petsc = petsc_rows(MPI.COMM_SELF, rows, self.size)
        self._pc = factored(petsc, no_factor)
        self._factor = self._pc.getFactorMatrix()
        self._source, self._target = petsc.createVecs()  # only their shapes are used

    def solve(self, loads: Array) -> Array:
        """The inverse times each column: (n, columns) to (n, columns), both in Fortran order."""
        result = np.empty(loads.shape, order="F")
        loads = np.asfortranarray(loads)
        if loads.shape[1] == 1 and self.size:
            # without temporary matrices
            on_arrays(self._factor.solve, self._source, loads[:, 0], self._target, result[:, 0])
            return result
        for begin in range(0, loads.shape[1] if self.size else 0, COLUMNS_AT_ONCE):
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

    def restricted(self, unknowns: Ints) -> Array:
        """The inverse between some unknowns, (m, m), symmetric."""
        block = np.empty((len(unknowns), len(unknowns)))
        for begin in range(0, len(unknowns), COLUMNS_AT_ONCE):
            part = unknowns[begin : begin + COLUMNS_AT_ONCE]
            unit = np.zeros((self.size, len(part)), order="F")
            unit[part, np.arange(len(part))] = 1.0
            block[:, begin : begin + len(part)] = self.solve(unit)[unknowns]
        block += block.T.copy()
        block *= 0.5
        return block


def factor_seconds(unknowns: float, order: int, dimension: int = 3) -> float:
    """Seconds of the sparse factors of a body with so many unknowns."""
    if dimension == 2:
        return 3.5e-6 * unknowns
    return order * 1e-9 * (unknowns / order) ** 2
