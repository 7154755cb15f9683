"""Displacements of subdomains and all multipliers, from merged displacements.

The solver provides the multipliers of contact and tied rows. Rows of gluing and of held unknowns
are orthonormal and balance the remaining forces at their nodes: λ = B (f - K u - B_Cᵀ λ_C).
"""

import numpy as np

from solver.contact.row_kinds import RowKind
from solver.primal.merged import MergedSystem
from solver.vectors import Array


def recover(system: MergedSystem, u: Array, multiplier: Array) -> tuple[list[Array], Array]:
    """Displacements (n, members) of each class, and λ of all rows, (dual,) (collective).

    Parameters
    ----------
    u : (unknowns,)
    multiplier : (dual,)
        λ of contact and tied rows, zero on others.
    """
    problem = system.problem
    displacements = system.on_subdomains(u)
    left = np.empty(problem.B.columns)
    for cls, part, displaced, load in zip(
        problem.classes, problem.slices, displacements, problem.forces, strict=True
    ):
        rows = cls.stiffness[cls.interface]
        left[part] = (load[cls.interface] - rows @ displaced).T.ravel()
    left -= problem.constraint_forces(multiplier)
    balancing = np.empty(problem.size)
    problem.B.apply(left, balancing)
    bound = (problem.kinds == RowKind.GLUING) | (problem.kinds == RowKind.DIRICHLET)
    return displacements, np.where(bound, balancing, multiplier)
