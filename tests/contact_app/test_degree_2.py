"""Degree 2: the undecomposed answer, patch tests, constant pressure, rates, any decomposition."""

from __future__ import annotations

import numpy as np
import pytest

from tests import reference, scenes
from tests.comparison import in_order_of, in_space, solve

CELLS = (*scenes.CELLS_2D, *scenes.CELLS_3D)


def quadratic(made: scenes.Config) -> scenes.Config:
    """The same scene with every body of degree 2."""
    return {**made, "bodies": [{**body, "degree": 2} for body in made["bodies"]]}


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("name", ["wall", "floating_in_corner"])
def test_the_undecomposed_answer(name: str, cell: str) -> None:
    made = quadratic(scenes.ALL[name](cell, 3))
    known = reference.solve(scenes.build(made))
    scale = max(abs(known.energy), 0.5 * abs(known.u.ravel() @ known.system.load))
    d = scenes.dimension(cell)
    for subdomains in (1, [2] * d, 4):
        solution = solve(made, subdomains)
        summary = solution.summary
        assert summary["certificate"]["passed"], summary["certificate"]
        assert summary["mesh"]["nodes"] == known.points.shape[0] == 7**d
        assert summary["solution"]["energy"] == pytest.approx(known.energy, rel=0, abs=1e-8 * scale)
        u = in_order_of(known, solution)
        np.testing.assert_allclose(u, known.u, rtol=0, atol=1e-7 * np.abs(known.u).max())
        np.testing.assert_allclose(
            summary["solution"]["contact_force"], in_space(known.contact_force),
            rtol=0, atol=1e-6 * np.abs(known.system.load).sum(),
        )  # fmt: skip
