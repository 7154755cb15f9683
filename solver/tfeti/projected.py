"""The projected dual operator, alone and with the penalty of the equality Q x = 0.

P = I - Q is the projector of the coarse problem (paper, section 4.1). Where two projections follow
each other, the operators below apply only one.
"""

import math
from collections.abc import Callable

import numpy as np

from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.dual_operator import DualOperator
from solver.vectors import Array


class ProjectorEquality:
    """Gλ = 0 as the equality Q x = 0 of a SMALBE solve (protocol `Equalities`).

    Parameters
    ----------
    on_penalty
        Called with each penalty ρ that the solver chooses, for a preconditioner that depends on it.
    """

    norm = 1.0

    def __init__(
        self, coarse: CoarseProblem, on_penalty: Callable[[float], None] | None = None
    ) -> None:
        self.coarse = coarse
        self.comm = coarse.comm
        self.rows = coarse.size
        self._on_penalty = on_penalty

    def apply(self, x: Array, out: Array) -> None:
        """Q x."""
        self.coarse.apply(x, out)

    def apply_transpose(self, multiplier: Array, out: Array) -> None:
        """Qᵀ times a multiplier; Q is symmetric."""
        self.coarse.apply(multiplier, out)

    def penalised(self, operator: "ProjectedOperator", rho: float) -> "PenalisedOperator":
        """The operator x -> P F P x + ρ Q x, with two projections instead of three."""
        if self._on_penalty is not None:
            self._on_penalty(rho)
        return PenalisedOperator(operator, rho)


class ProjectedOperator:
    """Pᵀ F P on dual vectors."""

    def __init__(self, F: Callable[[Array, Array], None], coarse: CoarseProblem) -> None:
        self.F = F
        self.coarse = coarse
        self.comm = coarse.comm
        self.size = coarse.size
        self._projected = np.empty(self.size)

    def apply(self, x: Array, out: Array) -> None:
        """Pᵀ F P x."""
        self.coarse.project(x, self._projected)
        self.F(self._projected, out)
        self.coarse.project_transpose(out, out)


class RangeOperator:
    """Pᵀ F on the range of P, where it equals Pᵀ F P and takes one projection less.

    Conjugate gradients that start there and are preconditioned within it stay there.

    Attributes
    ----------
    image : (interface,)
        K⁺ Bᵀ x of the last vector x the operator was applied to.
    """

    def __init__(self, F: DualOperator, coarse: CoarseProblem) -> None:
        self.F = F
        self.coarse = coarse
        self.comm = coarse.comm
        self.size = coarse.size

    @property
    def image(self) -> Array:
        """K⁺ Bᵀ x of the last x; the next application overwrites it."""
        return self.F.displacements

    def apply(self, x: Array, out: Array) -> None:
        """Pᵀ F x."""
        self.F.apply(x, out)
        self.coarse.project_transpose(out, out)


class PenalisedOperator:
    """P F P + ρ Q on dual vectors; both terms share the first projection.

    Attributes
    ----------
    image : (2, kernels)
        G x and (G Gᵀ)⁻¹ G x of the last vector x the operator was applied to, for ‖Q x‖.
    """

    def __init__(self, projected: ProjectedOperator, rho: float) -> None:
        self.projected = projected
        self.rho = rho
        self.comm = projected.comm
        self.size = projected.size
        self.image = np.empty((2, projected.coarse.kernels))
        self._q = np.empty(self.size)
        self._p = np.empty(self.size)

    def apply(self, x: Array, out: Array) -> None:
        """P F P x + ρ Q x."""
        coarse = self.projected.coarse
        coarse.restrict(x, self.image[0])
        coarse.solve(self.image[0], self.image[1])
        coarse.extend(self.image[1], self._q)
        np.subtract(x, self._q, out=self._p)
        self.projected.F(self._p, out)
        coarse.project(out, out)
        self._q *= self.rho
        out += self._q

    def image_norm(self, image: Array) -> float:
        """‖Q x‖ = √((G x)ᵀ (G Gᵀ)⁻¹ G x) from the image of x."""
        square = self.comm.allreduce(float(np.dot(image[0], image[1])))
        return math.sqrt(max(square, 0.0))
