"""Recovery of displacements from multipliers: u = K⁺ (f - Bᵀ λ) + R α.

α is the multiplier of the equality G λ = e. With g the gradient of the augmented Lagrangian at
the solution and t = Cᵀ μ the force of its multiplier,

    g = P (F λ - d) + t,  α = (G Gᵀ)⁻¹ G (F λ - d - t)  gives  B u - c = -g :

rows that hold with equality have exactly the residual of the solver, and contact rows open or close
by their gradient. Open rows do not influence α, so they cause no jumps of u.
"""

import numpy as np

from solver.tfeti.dual import DualProblem
from solver.vectors import Array


def kernel_coefficients(
    problem: DualProblem, multiplier: Array, equality_force: Array | None
) -> Array:
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


def interface_displacements(problem: DualProblem, multiplier: Array, alpha: Array) -> Array:
    """u on the interface; costs as much as one application of F."""
    result = np.empty_like(problem.free_displacements)
    problem.F.solve_interface(problem.constraint_forces(multiplier), result)
    np.subtract(problem.free_displacements, result, out=result)
    for cls, part, lift in zip(problem.classes, problem.slices, problem.lifting, strict=True):
        result[part].reshape(cls.members, -1)[:] += lift[cls.interface].T
    add_motions(problem, alpha, result)
    return result


def add_motions(problem: DualProblem, alpha: Array, displacements: Array) -> None:
    """Add R α to displacements on the interface."""
    for cls, part, kernel in zip(
        problem.classes, problem.slices, problem.kernel_slices(), strict=True
    ):
        of_class = displacements[part].reshape(cls.members, -1)
        of_class += alpha[kernel].reshape(cls.members, -1) @ cls.kernel[cls.interface].T


def displacements(problem: DualProblem, multiplier: Array, alpha: Array) -> list[Array]:
    """u of every subdomain of this rank, (n, members) a class."""
    result = []
    forces = problem.constraint_forces(multiplier)
    for cls, interface, kernel, load, lift in zip(
        problem.classes,
        problem.slices,
        problem.kernel_slices(),
        problem.loads,
        problem.lifting,
        strict=True,
    ):
        force = forces[interface].reshape(cls.members, -1)
        motion = alpha[kernel].reshape(cls.members, -1)
        u = np.empty(load.shape, order="F")
        for members in cls.batches():
            net = load[:, members].copy(order="F")
            net[cls.interface] -= force[members].T
            u[:, members] = cls.solve(net)
            u[:, members] += lift[:, members]
            u[:, members] += cls.kernel @ motion[members].T
        result.append(u)
    return result
