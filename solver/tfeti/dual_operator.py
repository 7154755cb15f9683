"""The dual operator F = B K⁺ Bᵀ of Total FETI (paper, section 4.1), and K⁺ f of the loads."""

from collections.abc import Sequence

import numpy as np

from solver.problem.constraints.matrix import ConstraintMatrix
from solver.problem.subdomains import interface_slices
from solver.tfeti.subdomain.classes import FactoredClass
from solver.vectors import Array

FreeSolution = tuple[Array, list[Array]]
"""K⁺ f on the interface, and fᵀ K⁺ f of each subdomain, an array per class."""


class DualOperator:
    """F = B K⁺ Bᵀ, never formed.

    Parameters
    ----------
    B : (dual, interface)
        Constraint matrix on the interface unknowns.
    classes
        The congruence classes of this rank, in the order of the columns.
    """

    def __init__(self, B: ConstraintMatrix, classes: tuple[FactoredClass, ...]) -> None:
        self.comm = B.comm
        self.B = B
        self.classes = classes
        self.size, self.interface = B.rows, B.columns
        self._loads = np.empty(self.interface)
        self.displacements = np.zeros(self.interface)
        self._slices = interface_slices(classes)

    def apply(self, x: Array, out: Array) -> None:
        """F x."""
        self.B.apply_transpose(x, self._loads)
        self.solve_interface(self._loads, self.displacements)
        self.B.apply(self.displacements, out)

    def solve_interface(self, loads: Array, out: Array) -> None:
        """Put K⁺ x into out, both interface vectors."""
        for cls, part in zip(self.classes, self._slices, strict=True):
            shape = (cls.members, len(cls.interface))
            cls.apply_interface(loads[part].reshape(shape), out[part].reshape(shape))


def solve_free(classes: tuple[FactoredClass, ...], loads: Sequence[Array]) -> FreeSolution:
    """Solve with the factor of each class, for the subdomains with a load.

    Parameters
    ----------
    loads : one (n, members) array per class
        f - K u_held.
    """
    result = np.zeros(sum(cls.members * len(cls.interface) for cls in classes))
    works = [np.zeros(cls.members) for cls in classes]
    for cls, part, load, work in zip(classes, interface_slices(classes), loads, works, strict=True):
        loaded = np.flatnonzero(load.any(axis=0))
        if len(loaded):
            some_loads = np.asfortranarray(load[:, loaded])
            u = cls.solve(some_loads)
            result[part].reshape(cls.members, -1)[loaded] = u[cls.interface].T
            work[loaded] = np.einsum("ij,ij->j", some_loads, u)
    return result, works
