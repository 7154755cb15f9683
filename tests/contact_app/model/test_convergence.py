"""Answers approach those of elasticity at the rate theory gives.

The energy norm of the error is read off the energy: for the minimiser over a subspace of the
admissible displacements ½‖u - u_h‖² = J(u_h) - J(u), and degree 1 gives O(h), energy O(h²).
"""

import numpy as np
import pytest

from tests import scenes
from tests.comparison import solve


def column(cell: str, n: int, *loads: scenes.Config, **keys: object) -> scenes.Config:
    """A column between rollers on all sides, standing on a floor that it may leave."""
    sides = scenes.rollers(cell, "+-", axes="xy"[: scenes.dimension(cell) - 1])
    block = {**scenes.block(cell, n), **keys}
    return scenes.config(cell, [block], [*sides, *loads], [scenes.on_floor(cell)])


def confined_modulus(young: float, poisson: float) -> float:
    """Stress over strain of a column that cannot widen."""
    return young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))


def rates(errors: list[float], sizes: list[int]) -> np.ndarray:
    """Observed orders between neighbours."""
    return np.diff(np.log(errors)) / np.diff(np.log(1.0 / np.array(sizes)))


@pytest.mark.parametrize("cell", scenes.CELLS_3D + scenes.CELLS_2D)
def test_column_under_its_own_weight(cell: str) -> None:
    """u_z = -w (H z - z²/2)/M, J = -w²/(6 M); stands on contact, energy error O(h²)."""
    weight, M = 20.0, confined_modulus(1000.0, 0.3)
    exact = -(weight**2) / (6 * M)
    sizes, errors = [2, 4, 8], []
    vertical = scenes.dimension(cell) - 1
    for n in sizes:
        solution = solve(column(cell, n, scenes.weight(cell, 0, 0, -weight)), 2)
        found = solution.summary["solution"]
        assert found["contact_force"][vertical] == pytest.approx(weight, rel=1e-8)
        errors.append(found["energy"] - exact)
    assert all(error > 0 for error in errors), "a subspace cannot have less energy"
    assert rates(errors, sizes)[-1] == pytest.approx(2.0, abs=0.12)
