"""Two elastic bodies in contact: the contact patch test, and bodies held by other bodies alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.comparison import solve

YOUNG, POISSON, PRESSURE = 900.0, 0.25, 10.0


def stack(
    lower: str, upper: str, n: tuple[int, int], gap: float = 0.0, held: bool = True
) -> scenes.Config:
    """A block on a block, pressed from above; unless `held`, the upper one floats on the other."""
    d = scenes.dimension(lower)
    up, down = scenes.up(lower), scenes.down(lower)
    bodies = [
        scenes.block(lower, n[0], "lower", young=YOUNG, poisson=POISSON),
        scenes.block(
            upper, n[1], "upper", (0, 0, 1 + gap), (1, 1, 2 + gap), YOUNG, POISSON
        ),
    ]  # fmt: skip
    conditions: list[scenes.Config] = [
        {"on": f"lower.{down}", "displacement": scenes.vector(lower, None, None, 0.0)},
        {"on": f"upper.{up}", "pressure": PRESSURE},
    ]
    for body in ("lower", "upper")[: 1 + held]:
        for axis in range(d - 1):
            values = [0.0 if k == axis else None for k in range(d)]
            conditions.append({"on": f"{body}.{'xyz'[axis]}-", "displacement": values})
    contacts = [{"on": f"upper.{down}", "against": f"lower.{up}"}]
    return scenes.config(lower, bodies, conditions, contacts)


def patch_displacement(points: np.ndarray, d: int) -> np.ndarray:
    """Uniaxial stress along the last axis; plane strain in the plane."""
    side = POISSON * PRESSURE / YOUNG * (1.0 if d == 3 else 1.0 + POISSON)
    down = -PRESSURE / YOUNG * (1.0 if d == 3 else 1.0 - POISSON**2)
    return points[:, :d] * np.array([side] * (d - 1) + [down])


PAIRS = [
    ("quadrilateral", "triangle", (3, 5)),
    ("triangle", "triangle", (4, 3)),
    ("quadrilateral", "quadrilateral", (7, 2)),
    ("hexahedron", "tetrahedron", (2, 3)),
    ("tetrahedron", "hexahedron", (3, 2)),
    ("hexahedron", "hexahedron", (3, 4)),
    ("tetrahedron", "tetrahedron", (2, 3)),
]


@pytest.mark.parametrize(("lower", "upper", "n"), PAIRS)
@pytest.mark.parametrize("split", [1, 5])
def test_contact_patch(lower: str, upper: str, n: tuple[int, int], split: int) -> None:
    solution = solve(stack(lower, upper, n), split, tolerance=1e-12)
    points, u = solution.displacement_at_nodes()
    exact = patch_displacement(points, u.shape[1])
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    touching = np.isfinite(solution.nodes.gap)
    pressure = solution.nodes.contact_pressure[touching]
    np.testing.assert_allclose(pressure, PRESSURE, rtol=1e-9)
    assert solution.summary["solution"]["contact_force"] == [0, 0, 0]
    (force,) = solution.summary["solution"]["pair_forces"].values()
    np.testing.assert_allclose(force[u.shape[1] - 1], PRESSURE, rtol=1e-9)
