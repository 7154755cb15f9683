"""Contact rows that share nodes: how a preconditioner weighs them.

Rows over several nodes, between bodies that may be of unlike stiffness, are neither orthonormal
nor equally stiff on both sides, and B S Bᵀ is no approximate inverse of B K⁺ Bᵀ: it adds the
stiffness of both sides where F adds their compliance. With D the size of each subdomain's
stiffness and M = B D⁻¹ Bᵀ, the compliance of these rows if every unknown were a spring of its
own,

    M⁻¹ B D⁻¹ S D⁻¹ Bᵀ M⁻¹

is one (A. Klawonn, O. Widlund, FETI and Neumann-Neumann iterative substructuring methods, Comm.
Pure Appl. Math. 54 (2001)); for orthonormal rows within one stiffness it is B S Bᵀ again. Only
rows free to move count in M, as open contact joins nothing. M is as large as a contact surface;
every rank holds and factors it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import splu

from solver.tfeti.constraints.matrix import ConstraintMatrix, lent, local_rows, scale_rows
from solver.tfeti.dual import DualProblem
from solver.tfeti.subdomain.classes import SubdomainClass


def _compliance(cls: SubdomainClass) -> float:
    """D⁻¹ of the unknowns of a class; a rigid body gives way to no force by a spring of its own."""
    return 0.0 if cls.rigid else 1.0 / float(cls.stiffness.diagonal().mean())


class CoupledRows:
    """M⁻¹ on the rows of several nodes that are free, and B with these rows divided by D.

    Attributes
    ----------
    B : (dual, interface)
        Rows of several nodes times D⁻¹, the others as they were.
    """

    def __init__(self, problem: DualProblem) -> None:
        self.comm = problem.comm
        self._rows = np.flatnonzero(problem.wide)
        compliance = np.concatenate(
            [
                np.zeros(0),
                *(np.full(c.members * len(c.interface), _compliance(c)) for c in problem.classes),
            ]
        )
        mask = problem.wide.astype(float)
        own = problem.deforming
        wide = own.matrix.copy()
        scale_rows(wide, mask)
        divided = wide.copy()
        with lent(self.comm, compliance) as (right,):
            divided.diagonalScale(R=right)
        self._matrix = self._gathered(divided.matMult(wide.transpose(PETSc.Mat())))
        B = own.matrix.copy()
        scale_rows(B, 1.0 - mask)
        B.axpy(1.0, divided, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.B = ConstraintMatrix(self.comm, local_rows(B), own.columns, own.nodal, own.components)
        for matrix in (wide, divided, B):
            matrix.destroy()
        counts = self.comm.allgather(len(self._rows))
        first = sum(counts[: self.comm.rank])
        self._mine = slice(first, first + len(self._rows))
        self._filled = self._matrix.diagonal() > 0.0
        self._face: bytes | None = None

    def _gathered(self, product: PETSc.Mat) -> sparse.csc_matrix:
        """The rows and columns of several nodes, on every rank."""
        local = local_rows(product)
        first = product.getOwnershipRange()[0]
        every = np.concatenate(self.comm.allgather(first + self._rows))
        parts = self.comm.allgather(local[self._rows][:, every])
        product.destroy()
        return sparse.vstack(parts, format="csc")

    def divide(self, x: NDArray[np.float64], free: NDArray[np.bool_] | None) -> None:
        """Replace the rows of several nodes by M⁻¹ of those that are free, zero elsewhere.

        Parameters
        ----------
        x : (dual,)
        free : (dual,)
            Rows that are free; None for all rows.
        """
        own = np.ones(len(self._rows), bool) if free is None else free[self._rows]
        values, in_set = x[self._rows], own
        if self.comm.size > 1:
            pairs = self.comm.allgather((values, own))
            values, in_set = (np.concatenate(part) for part in zip(*pairs, strict=True))
        in_set = in_set & self._filled
        if in_set.tobytes() != self._face:
            self._face = in_set.tobytes()
            self._chosen = np.flatnonzero(in_set)
            if len(self._chosen):
                block = self._matrix[self._chosen][:, self._chosen]
                self._factor = splu(
                    block.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
                )
        result = np.zeros(len(values))
        if len(self._chosen):
            result[self._chosen] = self._factor.solve(values[self._chosen])
        x[self._rows] = result[self._mine]
