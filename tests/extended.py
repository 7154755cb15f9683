"""Small quadratic programmes in extended precision, where double precision leaves no digits."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

Extended = np.longdouble

REFINEMENTS = 20
"""Corrections of a small system solved in double precision, residuals in extended."""

ACTIVE_SETS = 60

SINGULAR = 1e-15
"""Pivot over the largest entry of the diagonal below which a matrix of doubles is singular."""

MET = 1e-13
"""Penetration over the largest displacement that counts as none."""


def minimise(
    K: sp.spmatrix, load: np.ndarray, B: sp.spmatrix, gap: np.ndarray, near: np.ndarray
) -> np.ndarray | None:
    """Minimiser of ½ uᵀ K u - loadᵀ u with B u ≤ gap; None where active sets do not settle.

    None, too, where K is singular: rows would have to keep the body.

    What is returned meets all optimality conditions in extended precision, wherever it began.

    Parameters
    ----------
    near : (n,)
        Displacements whose closed rows are tried first.
    """
    B = sp.csr_matrix(B)
    some = np.flatnonzero(B.getnnz(axis=1))
    rows, gap = B[some].toarray().astype(Extended), gap[some].astype(Extended)
    solved = _solve(K.toarray(), np.column_stack([load, rows.T]))
    if solved is None:
        return None
    free, responses = solved[:, 0], solved[:, 1:]
    flexibility, excess = rows @ responses, rows @ free - gap
    closed = np.asarray(rows @ near - gap) > -1e-7 * np.abs(near).max(initial=0.0)
    for _ in range(ACTIVE_SETS):
        multiplier, at = np.zeros(len(gap), Extended), np.flatnonzero(closed)
        small = flexibility[np.ix_(at, at)]
        for _ in range(REFINEMENTS if len(at) else 0):
            missing = (excess[at] - small @ multiplier[at]).astype(float)
            multiplier[at] += np.linalg.lstsq(small.astype(float), missing, rcond=None)[0]
        u = free - responses @ multiplier
        crossed = excess - flexibility @ multiplier > MET * np.abs(u).max(initial=0.0)
        following = np.where(closed, multiplier > 0.0, crossed)
        if (following == closed).all() and not crossed.any():
            return np.asarray(u)
        closed = following
    return None


def _solve(A: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """Solutions of a positive definite system by Cholesky's factors, None of others."""
    L, x = A.astype(Extended), right.astype(Extended)
    least = SINGULAR * L.diagonal().max(initial=0.0)
    for j in range(len(L)):
        if not L[j, j] > least:
            return None
        L[j, j] = np.sqrt(L[j, j])
        L[j + 1 :, j] /= L[j, j]
        L[j + 1 :, j + 1 :] -= np.outer(L[j + 1 :, j], L[j + 1 :, j])
    for j in range(len(L)):
        x[j] /= L[j, j]
        x[j + 1 :] -= np.multiply.outer(L[j + 1 :, j], x[j])
    for j in reversed(range(len(L))):
        x[j] /= L[j, j]
        x[:j] -= np.multiply.outer(L[j, :j], x[j])
    return x
