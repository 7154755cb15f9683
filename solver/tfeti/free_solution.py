"""K⁺ f: the displacements of subdomains under their loads, without constraints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.tfeti.dual_operator import interface_slices
from solver.tfeti.subdomain.classes import SubdomainClass
from solver.vectors import Array

FreeSolution = tuple[Array, list[Array]]
"""K⁺ f on the interface, and fᵀ K⁺ f of each subdomain, an array per class."""


def solve_free(classes: tuple[SubdomainClass, ...], loads: Sequence[Array]) -> FreeSolution:
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
