"""A warm block between a rough wall and another block cools down, and then shrinks away from both.

All its loads are thermal: they balance themselves up to rounding errors, by which the blocks seem
to press each other.
"""

from typing import Any

import numpy as np
import pytest

import contact_app
from tests import scenes


def cooled(dimension: int, method: str) -> dict[str, Any]:
    """Two blocks and a wall without gaps, in three steps; the free block is cold in the last."""
    rough, d = {"friction": {"coulomb": 0.3}}, dimension
    cell = "quadrilateral" if d == 2 else "hexahedron"
    warm = scenes.box("warm", [2, 1, 1][:d], [6, 3, 2][:d], [0, 0, 0][:d], cell, 1000.0, 0.3)
    warm["material"]["expansion"] = 1e-3
    held = scenes.box("held", [3, 1, 1][:d], [3, 4, 2][:d], [2, 0, 0][:d], cell, 2000.0, 0.3)
    wall = {"plane": {"point": [0] * d, "normal": [1, 0, 0][:d]}}
    return {
        "dimension": d,
        "bodies": [warm, held],
        "conditions": [
            {"on": "held.x+", "displacement": [0] * d},
            {"name": "heat", "in": "warm", "temperature": "20 + 2*y"},
        ],
        "contacts": [
            {"on": "warm.x+", "against": "held.x-", **rough},
            {"on": "warm.x-", "obstacle": wall, **rough},
        ],
        "steps": [{"heat": 1}, {"heat": 0}, {"heat": -0.5}],
        "solver": {"tolerance": 1e-7, "method": method},
    }


@pytest.mark.parametrize(("dimension", "method"), [(2, "auto"), (3, "primal")])
def test_heat_that_is_taken_off_leaves_blocks_without_forces(dimension: int, method: str) -> None:
    """Forces of 1e-17 to 1e-15 were left, and the histories ended without a certificate."""
    answers = contact_app.solve(cooled(dimension, method))
    assert answers.converged
    warm, *cold = [step["contacts"] for step in answers.summary["steps"]]
    assert warm[0]["force"][0] < -1.0
    assert max(np.abs(contact["force"]).max() for step in cold[-2:] for contact in step) < 1e-9
