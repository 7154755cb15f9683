"""From multipliers back to displacements: u = K⁺ (f - Bᵀ λ) + R α.

α is the multiplier of the equality G λ = e. With g the gradient of the augmented Lagrangian at
the solution and t = Cᵀ μ the force of its multiplier,

    g = P (F λ - d) + t,  α = (G Gᵀ)⁻¹ G (F λ - d - t)  gives  B u - c = -g :

rows that hold with equality keep exactly the residual the solver left, and contact rows open or
close by their gradient. Open rows never enter, so they cannot pull u apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.tfeti.dual import DualProblem


def kernel_coefficients(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    equality_force: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """α for a multiplier λ with G λ = e.

    Parameters
    ----------
    multiplier : (dual,)
        λ.
    equality_force : (dual,) or None
        t = Cᵀ μ, the force of the multiplier of G λ = e in the solver; None for zero.
    """
    if problem.coarse is None:
        return np.zeros(0)
    residual = np.empty(problem.size)
    problem.F.apply(multiplier, residual)
    residual -= problem.d
    if equality_force is not None:
        residual -= equality_force
    return problem.coarse.coefficients(residual)


def displacements(
    problem: DualProblem, multiplier: NDArray[np.float64], alpha: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """u of every subdomain of this rank, (n, members) a class."""
    result = []
    forces = problem.constraint_forces(multiplier)
    for cls, load, lift, force, part in zip(
        problem.classes,
        problem.loads,
        problem.lifting,
        forces,
        problem.kernel_slices(),
        strict=True,
    ):
        u = cls.solve(load - force) + lift
        if cls.kernel.shape[1]:
            u += cls.kernel @ alpha[part].reshape(cls.members, -1).T
        result.append(u)
    return result
