"""A factor that follows sets is nearly the factor of the last set."""

import numpy as np
import pytest

from solver.primal.factor import FactorOptions
from solver.primal.factor_on_sets import FactorOnSets
from solver.primal.merged import MergedSystem, merge
from solver.primal.projector import Projector
from solver.vectors import Array
from tests.solver.lattices import undecomposed

PENALTY = FactorOptions().penalty


def strip() -> MergedSystem:
    return merge(undecomposed(40, lambda x: 0.0 * x[:, 1], np.zeros(41), (True, True)))


def corrections(factor: FactorOnSets, projector: Projector, residuals: Array) -> Array:
    """Projected corrections of residuals (residuals, unknowns) on a set."""
    factor.adapt_to(projector)
    results = np.empty_like(residuals)
    for residual, result in zip(residuals, results, strict=True):
        factor.apply(projector.apply_transpose(residual), result)
    return np.stack([projector.apply(result) for result in results])


def test_rows_that_leave_and_join_change_it_as_a_new_factor() -> None:
    system = strip()
    number = np.arange(len(system.rows))
    first, later, last = (
        Projector(system, number % 3 > 0),
        Projector(system, (number % 3 > 0) ^ (number % 7 == 0)),
        Projector(system, (number % 3 > 0) ^ (number % 5 == 0)),
    )
    residuals = np.random.default_rng(0).standard_normal((2, system.size))
    options = FactorOptions(most_changed=len(number))
    followed, fresh = FactorOnSets(system, options), FactorOnSets(system, options)
    other = corrections(followed, first, residuals)
    corrections(followed, later, residuals)
    again, expected = (corrections(f, last, residuals) for f in (followed, fresh))
    scale = np.abs(expected).max()
    assert np.abs(other - expected).max() > 1e-2 * scale
    assert np.abs(again - expected).max() < 10.0 / PENALTY * scale
    assert residuals[0] @ again[1] == pytest.approx(residuals[1] @ again[0], rel=1e-6)


def test_a_new_factor_is_made_where_many_rows_change_or_few_hold_the_body() -> None:
    """With new factors both results are equal to the last digit."""
    system = strip()
    residuals = np.random.default_rng(0).standard_normal((1, system.size))
    every, half = (Projector(system, np.arange(len(system.rows)) % k == 0) for k in (1, 2))
    changed = len(every.rows) - len(half.rows)
    for most, equal in ((changed - 1, True), (changed, False)):
        options = FactorOptions(most_changed=most)
        followed, fresh = FactorOnSets(system, options), FactorOnSets(system, options)
        corrections(followed, every, residuals)
        again, expected = (corrections(f, half, residuals) for f in (followed, fresh))
        assert np.array_equal(again, expected) == equal
