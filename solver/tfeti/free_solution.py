"""K⁺ f: the displacements of subdomains under their loads, without constraints."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha1

import numpy as np
from numpy.typing import NDArray

from solver.tfeti.dual_operator import interface_slices
from solver.tfeti.subdomain.classes import SubdomainClass

FreeSolution = tuple[NDArray[np.float64], list[NDArray[np.float64]]]
"""K⁺ f on the interface, and fᵀ K⁺ f of each subdomain, an array per class."""


def solve_free(
    classes: tuple[SubdomainClass, ...], loads: Sequence[NDArray[np.float64]]
) -> FreeSolution:
    """Solve with the factor of each class; equal loads are solved once.

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
            first, of_column = _distinct_columns(load, loaded)
            u = cls.solve(load[:, first])
            result[part].reshape(cls.members, -1)[loaded] = u[cls.interface].T[of_column]
            work[loaded] = np.einsum("ij,ij->j", load[:, first], u)[of_column]
    return result, works


def _distinct_columns(
    loads: NDArray[np.float64], chosen: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first column of each set of equal chosen columns, and the set of each column."""
    sets: dict[bytes, int] = {}
    firsts: list[int] = []
    of_column = np.empty(len(chosen), np.int64)
    for k, column in enumerate(chosen):
        digest = sha1(np.ascontiguousarray(loads[:, column]).data, usedforsecurity=False).digest()
        if digest not in sets:
            sets[digest] = len(firsts)
            firsts.append(int(column))
        of_column[k] = sets[digest]
    return np.array(firsts), of_column
