"""A solution of a quadratic programme to the last digit, from one that is nearly right."""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

Extended = np.longdouble

ACTIVE_SETS = 20

REFINEMENTS = 60
"""Corrections of a system solved in double precision, residuals in extended."""

PRIMAL, DUAL = 1e-11, 1e-11
"""Regularisation of the factored system; corrections remove its effect on the solution."""

MET = 1e-13
"""Penetration over the largest displacement, and pull over the largest force, that are none."""

SOLVED = 1e-13
"""Residual over the largest force at which a system counts as solved."""


def polish(
    K: sp.spmatrix, load: np.ndarray, B: sp.spmatrix, gap: np.ndarray, multiplier: np.ndarray
) -> np.ndarray | None:
    """Minimiser of ½ uᵀ K u - loadᵀ u with B u ≤ gap; None where active sets do not settle.

    Each active set is solved as a saddle point, corrected by residuals in extended precision.
    What is returned meets all optimality conditions, wherever it began.

    Parameters
    ----------
    multiplier : (m,)
        Its positive rows are tried first.
    """
    if K.shape[0] == 0:
        return np.zeros(0)
    unit = 1.0 / np.sqrt(K.diagonal())
    K = sp.csr_matrix(sp.diags(unit) @ K @ sp.diags(unit))
    B = sp.csr_matrix(sp.csr_matrix(B) @ sp.diags(unit))
    size = np.sqrt(np.asarray(B.multiply(B).sum(axis=1)).ravel())
    some = size > 1e-12 * size.max(initial=0.0)
    B = sp.csr_matrix(sp.diags(1.0 / size[some]) @ B[some])
    gap, load = gap[some] / size[some], load * unit
    active = multiplier[some] > 1e-12 * multiplier.max(initial=0.0)
    for _ in range(ACTIVE_SETS):
        found = _saddle_point(K, load, B[active], gap[active])
        if found is None:
            return None
        u, force = found
        length = max(np.abs(u).max(initial=0.0), np.abs(load).max(initial=0.0) * 1e-3)
        crossed = ~active & (B @ u - gap > MET * length)
        pulls = np.zeros(len(gap), bool)
        pulls[active] = force < -MET * np.abs(force).max(initial=0.0)
        if not crossed.any() and not pulls.any():
            return np.asarray(unit * u, float)
        active = (active & ~pulls) | crossed
    return None


def _saddle_point(
    K: sp.csr_matrix, load: np.ndarray, B: sp.csr_matrix, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """u and multipliers of K u + Bᵀ λ = load, B u = gap; rows may depend on each other."""
    n, m = B.shape[1], B.shape[0]
    exact = sp.bmat([[K, B.T], [B, None]], format="csr").astype(Extended)
    near = sp.bmat([[K + PRIMAL * sp.identity(n), B.T], [B, -DUAL * sp.identity(m)]], format="csc")
    try:
        factor = spla.splu(near)
    except RuntimeError:
        return None
    right = np.concatenate([load, gap]).astype(Extended)
    x = np.zeros(n + m, Extended)
    for _ in range(REFINEMENTS):
        residual = right - exact @ x
        scale = max(np.abs(load).max(initial=0.0), np.abs(x[n:]).max(initial=0.0))
        digits = 10.0 * float(np.finfo(Extended).eps) * np.abs(x[:n]).max()
        solved = np.abs(residual[:n]).max() <= SOLVED * scale + digits
        length = max(np.abs(x[:n]).max(), np.abs(gap).max(initial=0.0))
        if solved and np.abs(residual[n:]).max(initial=0.0) <= SOLVED * length:
            return x[:n], x[n:]
        x = x + factor.solve(residual.astype(float))
    return None
