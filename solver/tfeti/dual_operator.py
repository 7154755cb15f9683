"""The dual operator F = B K⁺ Bᵀ of Total FETI (paper, section 4.1)."""

from __future__ import annotations

import numpy as np

from solver.tfeti.constraints.matrix import ConstraintMatrix
from solver.tfeti.subdomain.classes import SubdomainClass
from solver.vectors import Array


class DualOperator:
    """F = B K⁺ Bᵀ, never formed.

    Parameters
    ----------
    B : (dual, interface)
        Constraint matrix on the interface unknowns.
    classes
        The congruence classes of this rank, in the order of the columns.
    """

    def __init__(self, B: ConstraintMatrix, classes: tuple[SubdomainClass, ...]) -> None:
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


def interface_slices(classes: tuple[SubdomainClass, ...]) -> list[slice]:
    """Slice of each class in an interface vector."""
    ends = np.cumsum([0, *(c.members * len(c.interface) for c in classes)])
    return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
