"""The natural coarse space: G = Rᵀ Bᵀ, its factor and the projectors Q and P = I - Q.

Gλ = e says that every floating subdomain is in equilibrium under its load and the multipliers.
Q = Gᵀ (G Gᵀ)⁻¹ G projects onto the range of Gᵀ, P onto the kernel of G. As an equality
constraint of the dual problem, Q itself serves as the matrix C: with C = Cᵀ = C² the rows are
orthonormal, the penalty product Cᵀ C x is one projection, and ‖C x‖ measures ‖G x‖ in a norm that
does not depend on the scaling of R.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc


def petsc_vec(values: NDArray[np.float64], comm: MPI.Intracomm) -> PETSc.Vec:
    """A distributed PETSc vector on the memory of the local part."""
    return PETSc.Vec().createWithArray(values, comm=comm)


class CoarseProblem:
    """G, the factor of G Gᵀ and the projectors; vectors are local parts of distributed ones.

    Parameters
    ----------
    Gt : (dual, kernels)
        Gᵀ = B R as a PETSc matrix, of full column rank.

    Raises
    ------
    ArithmeticError
        G Gᵀ is singular: some rigid motion is seen by no row of B.
    """

    def __init__(self, Gt: PETSc.Mat) -> None:
        self.comm: MPI.Intracomm = Gt.getComm().tompi4py()
        self.Gt = Gt
        self.size = Gt.getLocalSize()[0]
        self.kernels = Gt.getLocalSize()[1]
        GGt = Gt.transposeMatMult(Gt)
        GGt.setOption(PETSc.Mat.Option.SPD, True)
        self._pc = PETSc.PC().create(self.comm)
        self._pc.setOperators(GGt)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("cholmod" if self.comm.size == 1 else "mumps")
        try:
            self._pc.setUp()
        except PETSc.Error as error:
            raise ArithmeticError(
                "the coarse problem G Gᵀ is singular: a rigid motion is seen by no constraint"
            ) from error
        self._dual = np.empty(self.size)
        self._coarse = np.empty(self.kernels)
        self._solution = np.empty(self.kernels)

    def solve(self, rhs: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """(G Gᵀ)⁻¹ times a coarse vector."""
        self._pc.apply(petsc_vec(rhs, self.comm), petsc_vec(out, self.comm))

    def restrict(self, dual: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """G times a dual vector."""
        self.Gt.multTranspose(petsc_vec(dual, self.comm), petsc_vec(out, self.comm))

    def extend(self, coarse: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Gᵀ times a coarse vector."""
        self.Gt.mult(petsc_vec(coarse, self.comm), petsc_vec(out, self.comm))

    def coefficients(self, dual: NDArray[np.float64]) -> NDArray[np.float64]:
        """(G Gᵀ)⁻¹ G times a dual vector: the α whose Gᵀ α is closest to it."""
        self.restrict(dual, self._coarse)
        alpha = np.empty(self.kernels)
        self.solve(self._coarse, alpha)
        return alpha

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Q x."""
        self.restrict(x, self._coarse)
        self.solve(self._coarse, self._solution)
        self.extend(self._solution, out)

    def project(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """P x = x - Q x; `out` may be `x`."""
        self.apply(x, self._dual)
        np.subtract(x, self._dual, out=out)


class ProjectorEquality:
    """Gλ = 0 as the equality Q x = 0 of a SMALBE solve (protocol `Equalities`).

    Parameters
    ----------
    on_penalty
        Told of each penalty ρ the solver chooses; a preconditioner depends on it.
    """

    norm = 1.0

    def __init__(
        self, coarse: CoarseProblem, on_penalty: Callable[[float], None] | None = None
    ) -> None:
        self.coarse = coarse
        self.comm = coarse.comm
        self.rows = coarse.size
        self._on_penalty = on_penalty

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Q x."""
        self.coarse.apply(x, out)

    def apply_transpose(self, multiplier: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """Qᵀ times a multiplier; Q is symmetric."""
        self.coarse.apply(multiplier, out)

    def penalised(self, operator: ProjectedOperator, rho: float) -> PenalisedOperator:
        """x to P F P x + ρ Q x, with two projections instead of three."""
        if self._on_penalty is not None:
            self._on_penalty(rho)
        return PenalisedOperator(operator, rho)


class ProjectedOperator:
    """P F P on dual vectors."""

    def __init__(
        self, F: Callable[[NDArray[np.float64], NDArray[np.float64]], None], coarse: CoarseProblem
    ) -> None:
        self.F = F
        self.coarse = coarse
        self.comm = coarse.comm
        self.size = coarse.size
        self._projected = np.empty(self.size)

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """P F P x."""
        self.coarse.project(x, self._projected)
        self.F(self._projected, out)
        self.coarse.project(out, out)


class PenalisedOperator:
    """P F P + ρ Q on dual vectors, sharing the first projection."""

    def __init__(self, projected: ProjectedOperator, rho: float) -> None:
        self.projected = projected
        self.rho = rho
        self.comm = projected.comm
        self.size = projected.size
        self._q = np.empty(self.size)
        self._p = np.empty(self.size)

    def apply(self, x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
        """P F P x + ρ Q x."""
        coarse = self.projected.coarse
        coarse.apply(x, self._q)
        np.subtract(x, self._q, out=self._p)
        self.projected.F(self._p, out)
        coarse.project(out, out)
        self._q *= self.rho
        out += self._q
