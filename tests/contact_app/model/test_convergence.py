"""Answers approach those of elasticity at the rate theory gives.

The energy norm of the error is read off the energy: for the minimiser over a subspace of the
admissible displacements ½‖u - u_h‖² = J(u_h) - J(u), and degree 1 gives O(h), energy O(h²).
"""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.comparison import solve


def column(cell: str, n: int, young: float = 1000.0, poisson: float = 0.3) -> scenes.Config:
    """A column between rollers on all sides, standing on a floor that it may leave."""
    d = scenes.dimension(cell)
    holds = [[0.0 if i == axis else None for i in range(d)] for axis in range(d - 1)]
    sides = [
        {"on": f"block.{'xyz'[axis]}{side}", "displacement": hold}
        for axis, hold in enumerate(holds)
        for side in "+-"
    ]
    return scenes.config(
        cell,
        [scenes.block(cell, n, young=young, poisson=poisson)],
        sides,
        [
            {
                "on": f"block.{scenes.down(cell)}",
                "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1)),
            }
        ],
    )


def confined_modulus(young: float, poisson: float) -> float:
    """Stress over strain of a column that cannot widen."""
    return young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))


def rates(errors: list[float], sizes: list[int]) -> np.ndarray:
    """Observed orders between neighbours."""
    return np.diff(np.log(errors)) / np.diff(np.log(1.0 / np.array(sizes)))


@pytest.mark.parametrize("cell", scenes.CELLS_3D + scenes.CELLS_2D)
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.4999])
def test_laterally_confined_column(cell: str, poisson: float) -> None:
    """Exact: stress = M ε; E = 1, ν = 0.4999 gives M = 1667.1."""
    M = confined_modulus(1.0, poisson)
    made = column(cell, 2, young=1.0, poisson=poisson)
    strain = 0.01
    made["conditions"].append(
        {
            "on": f"block.{scenes.up(cell)}",
            "displacement": scenes.vector(cell, None, None, -strain),
        }
    )
    solution = solve(made, [2] * scenes.dimension(cell), tolerance=1e-11)
    force = solution.summary["solution"]["contact_force"][scenes.dimension(cell) - 1]
    assert force == pytest.approx(M * strain, rel=1e-9)
    assert solution.summary["solution"]["energy"] == pytest.approx(0.5 * M * strain**2, rel=1e-9)
    if poisson == 0.4999:
        assert pytest.approx(1667.1, rel=1e-4) == M


@pytest.mark.parametrize("cell", scenes.CELLS_3D + scenes.CELLS_2D)
def test_column_under_its_own_weight(cell: str) -> None:
    """u_z = -w (H z - z²/2)/M, J = -w²/(6 M); stands on contact, energy error O(h²)."""
    weight, M = 20.0, confined_modulus(1000.0, 0.3)
    exact = -(weight**2) / (6 * M)
    sizes, errors = [2, 4, 8], []
    vertical = scenes.dimension(cell) - 1
    for n in sizes:
        made = column(cell, n)
        made["conditions"].append({"in": "block", "force": scenes.vector(cell, 0, 0, -weight)})
        solution = solve(made, 2)
        found = solution.summary["solution"]
        assert found["contact_force"][vertical] == pytest.approx(weight, rel=1e-8)
        errors.append(found["energy"] - exact)
    assert all(error > 0 for error in errors), "a subspace cannot have less energy"
    assert rates(errors, sizes)[-1] == pytest.approx(2.0, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("cell", scenes.CELLS_2D)
@pytest.mark.parametrize("name", ["rollers_and_floor", "no_contacts", "wall"])
def test_energy_settles(name: str, cell: str) -> None:
    """Nested meshes: energies fall to a limit. Corners between held and free sides cost order."""
    energies = []
    for n in (4, 8, 16, 32):
        made = scenes.ALL[name](cell, n)
        if name == "rollers_and_floor":
            made["conditions"].append({"in": "block", "force": [0, -60]})
        energies.append(solve(made, [2, 2]).summary["solution"]["energy"])
    steps = -np.diff(energies)
    assert np.all(steps > 0), "nested spaces lower the energy"
    observed = np.log2(steps[:-1] / steps[1:])
    assert observed[-1] > (1.8 if name == "rollers_and_floor" else 1.0), observed


def hertz(n: int, depth: float) -> scenes.Config:
    """Half a block, 4 wide and 4 high, pushed by its foot against a rigid disc above it."""
    cell = "quadrilateral"
    body = scenes.block(cell, n, upper=(4.0, 4.0, 4.0), young=1000.0, poisson=0.3)
    return scenes.config(
        cell,
        [body],
        [
            {"on": "block.x-", "displacement": [0.0, None]},
            {"on": "block.y-", "displacement": [None, depth]},
        ],
        [
            {
                "on": "block.y+",
                "obstacle": {"sphere": {"center": [0.0, 4.0 + 10.0], "radius": 10.0}},
            }
        ],
    )


@pytest.mark.slow
def test_hertz_cylinder_on_a_plane() -> None:
    """Peak pressure p0 = √(F' E*/(π R)) and half-width a = √(4 F' R/(π E*)), better when finer."""
    modulus, radius, depth = 1000.0 / (1 - 0.3**2), 10.0, 0.03
    errors = []
    for n in (16, 32, 64):
        summary = solve(hertz(n, depth), [4, 4]).summary["solution"]
        load = -2 * summary["contact_force"][1]
        peak = np.sqrt(load * modulus / (np.pi * radius))
        half_width = np.sqrt(4 * load * radius / (np.pi * modulus))
        assert summary["active_contacts"] * 4.0 / n == pytest.approx(half_width, abs=2 * 4.0 / n)
        errors.append(abs(summary["max_contact_pressure"] / peak - 1))
    assert errors[-1] < 0.05, errors
    assert errors[-1] < errors[0]
