"""The preconditioner of the projected dual operator on the free rows.

    z = P B S Bᵀ Pᵀ r + ρ⁻¹ Q r

approximates the inverse of Pᵀ F P + ρ Q, F = B K⁺ Bᵀ. S is, class by class, the Schur complement
of the stiffness on the interface (Dirichlet) or the stiffness between interface unknowns as it
stands (lumped; C. Farhat, F.-X. Roux, 1991, and C. Farhat, J. Mandel, F.-X. Roux, *Optimal
convergence properties of the FETI domain decomposition method*, 1994). The Schur complement saves
iterations, the more the larger the subdomain. Where F has dense blocks it is computed from their
inverses. B has orthonormal rows, so no scaling by multiplicity is needed, except for rows of
several nodes, which `CoupledRows` weighs. The solver sets the result to zero on rows that are not
free. An application costs two projections and a product with S.
"""

import math

import numpy as np
from scipy import sparse

from solver.tfeti.coupled import CoupledRows, coupled_rows
from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Mask


class DualPreconditioner:
    """Approximate inverse of P F P + ρ Q (protocol `Preconditioner` of MPRGP).

    Parameters
    ----------
    problem
        A dual problem with a coarse problem.
    rho
        Penalty ρ of Q, in the unit of F. Infinite if r is always in the range of Pᵀ: then one
        projection is enough.
    coupled
        The coupled rows of the problem, if they are known already.
    """

    def __init__(
        self, problem: DualProblem, rho: float, coupled: CoupledRows | None = None
    ) -> None:
        assert problem.coarse is not None
        self.comm, self.coarse, self.rho = problem.comm, problem.coarse, rho
        self._coupled = coupled or coupled_rows(problem)
        self.B = self._coupled.B if self._coupled else problem.B
        self._slices = problem.slices
        self._shapes = [(c.members, len(c.interface)) for c in problem.classes]
        self._stiffness = [c.preconditioning for c in problem.classes]
        interface = problem.B.columns
        self._jumps, self._forces = np.empty(interface), np.empty(interface)
        self._q, self._p = np.empty(problem.size), np.empty(problem.size)

    def set_penalty(self, rho: float) -> None:
        """Change ρ with the solver."""
        self.rho = rho

    def apply(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put z into out; the caller sets it to zero outside the mask."""
        penalised = math.isfinite(self.rho)
        if penalised:
            self.coarse.apply_transpose(r, self._q)
            r = np.subtract(r, self._q, out=self._p)
        self.stiffness(r, free_mask, out)
        self.coarse.project(out, out)
        if penalised:
            self._q /= self.rho
            out += self._q

    def stiffness(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put B S Bᵀ r into out."""
        if self._coupled:
            np.copyto(self._p, r)
            self._coupled.divide(self._p, free_mask)
            r = self._p
        self.B.apply_transpose(r, self._jumps)
        for S, part, shape in zip(self._stiffness, self._slices, self._shapes, strict=True):
            jumps, forces = self._jumps[part].reshape(shape), self._forces[part].reshape(shape)
            if isinstance(S, sparse.csr_matrix):
                forces[:] = (S @ jumps.T).T
            else:
                S.apply(jumps, forces)
        self.B.apply(self._forces, out)
        if self._coupled:
            self._coupled.divide(out, free_mask)


class ScaledPreconditioner:
    """Approximate inverse of P F P whose rows are scaled before and after.

    No projection stands between the scalings: the preconditioner would not be symmetric.

    Parameters
    ----------
    base
        Preconditioner of P F P of the problem.
    scale : (dual,)
        Factors on the rows.
    """

    def __init__(self, base: DualPreconditioner, scale: Array) -> None:
        self._base, self._scale = base, scale
        self._room = np.empty(len(scale))

    def apply(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put z into out."""
        np.multiply(self._scale, r, out=self._room)
        self._base.stiffness(self._room, free_mask, out)
        out *= self._scale
        self._base.coarse.project(out, out)
