"""Admissible multipliers near approximate ones: λ_I ≥ 0 and G λ = e."""

import numpy as np

from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Mask, largest_magnitude

ROUNDS = 40
"""Largest number of corrections; an iterate of a solver needs two or three."""

ROUND_OFF = 1e-16
"""Contact forces up to this share of the largest multiplier are rounding errors."""

OPEN_WEIGHT = 1e-3
"""Root of the share of a correction on an open contact row, beside one on an active row."""


def feasible_multiplier(problem: DualProblem, multiplier: Array, touching: Mask) -> Array:
    """Admissible multiplier near λ: zero on open contact rows, λ_I ≥ 0 and Gλ = e.

    The residual of Gλ = e is distributed over the rows that hold with equality: gluing, held and
    active contact rows, and tangential rows of sticking points. If these cannot carry it (a body
    held by too few active rows), open contact rows take a small share. Friction forces may exceed
    their limits slightly; the certificate measures this.

    Parameters
    ----------
    multiplier : (dual,)
        λ.
    touching : (dual,)
        Contact rows whose multiplier is above its bound, and tangential rows of sticking points.
    """
    multiplier = np.where(problem.inequality & ~touching, 0.0, multiplier)
    if problem.coarse is None:
        return np.where(problem.inequality, np.maximum(multiplier, 0.0), multiplier)
    return _balance(problem, multiplier, problem.conditional & ~touching)


def _balance(problem: DualProblem, multiplier: Array, open_rows: Mask) -> Array:
    """Add W Gᵀ (G W Gᵀ)⁻¹ (e - Gλ) with small weights on open rows until Gλ = e and λ_I ≥ 0.

    Open rows are set to zero again after each correction, as long as the other rows can carry it.
    """
    assert problem.coarse is not None
    root = np.where(open_rows, OPEN_WEIGHT, 1.0)
    coarse = None
    sliding = problem.tangential & open_rows
    missing = np.empty(len(problem.e))
    change = np.empty(problem.size)
    largest = max(
        largest_magnitude(problem.comm, problem.e), largest_magnitude(problem.comm, multiplier)
    )
    tolerance = 1e-13 * largest
    for attempt in range(2 * ROUNDS):
        empty = problem.inequality & (multiplier < 0.0)
        if attempt < ROUNDS:
            empty |= problem.inequality & open_rows
        multiplier[empty] = 0.0
        problem.coarse.restrict(multiplier, missing)
        np.subtract(problem.e, missing, out=missing)
        if largest_magnitude(problem.comm, missing) <= tolerance:
            break
        coarse = coarse or problem.coarse.weighted(root)
        coarse.least_multiplier(missing, change)
        change *= root
        if attempt < ROUNDS:
            change[sliding] = 0.0
        multiplier += change
    multiplier[problem.inequality & (multiplier <= ROUND_OFF * largest)] = 0.0
    return multiplier
