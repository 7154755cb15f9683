"""Levels of contact rows: nested, for slender bodies alone, and worth their faces."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model import build_model
from contact_app.run import solve_scene
from contact_app.studies.failing_scenes import Config, slender, wall
from solver.tfeti.dual import DualProblem
from solver.tfeti.thinning import RowLevels
from tests import scenes


def problem(made: Config, parts: list[int]) -> DualProblem:
    return build_model(scenes.build(made, parts), MPI.COMM_WORLD).problem


def test_levels_of_a_slender_body_are_nested_and_even() -> None:
    """Each has the rows of the one before, and about twice as many, no stretch without."""
    dual = problem(slender(100.0, [200, 2]), [10, 1])
    levels = RowLevels(dual, thinned=True)
    x = dual.contact.points[:, 0]
    before = np.zeros(dual.size, bool)
    counts = []
    while not levels.finest:
        assert not (before & ~levels.allowed).any()
        chosen = np.sort(x[levels.allowed[dual.inequality]])
        counts.append(len(chosen))
        assert np.diff(chosen).max() < 2.5 / len(chosen)
        before = levels.allowed
        levels.refine()
    assert counts[0] <= 16
    assert len(counts) >= 4
    assert all(a < b <= 2.5 * a for a, b in zip(counts, counts[1:], strict=False))
    assert levels.allowed is dual.inequality


@pytest.mark.parametrize("made", [wall(16), slender(5.0, [45, 9])])
def test_thick_bodies_have_none(made: Config) -> None:
    assert RowLevels(problem(made, [2, 1]), thinned=True).finest


def test_a_slender_body_costs_less_than_thrice_its_thick_twin() -> None:
    """Without levels it takes 5 times as many, without directions of earlier faces 10 times."""
    products = []
    for made in (slender(100.0, [200, 2]), slender(5.0, [45, 9])):
        summary = solve_scene(scenes.build(made, [10, 1])).summary
        assert summary["certificate"]["passed"]
        products.append(summary["solver"]["hessian_multiplications"])
    assert products[0] < 3 * products[1]
