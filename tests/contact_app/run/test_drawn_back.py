"""A rigid tool presses rough blocks and is drawn back: nothing presses them any more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contact_app
from tests import scenes

SHAPES = {
    "plane": {"plane": {"point": [1.0, 2.0], "normal": [0.0, -1.0]}},
    "sphere": {"sphere": {"center": [1.0, 4.0], "radius": 2.0}},
}


def pressed_by(shape: str, method: str) -> dict[str, Any]:
    """Two blocks on a rough floor under a rough tool, in two steps."""
    rough = {"friction": {"coulomb": 0.2}}
    lower = scenes.box("lower", [2, 1], [8, 4], [0, 0], "quadrilateral", 1000.0, 0.3)
    upper = scenes.box("upper", [1.7, 2], [5, 4], [0.3, 1], "quadrilateral", 500.0, 0.25)
    floor = {"plane": {"point": [0, 0], "normal": [0, 1]}}
    return {
        "dimension": 2,
        "bodies": [lower, upper, {"name": "tool", "rigid": SHAPES[shape]}],
        "conditions": [
            {"on": "lower.x-", "displacement": [0, None]},
            {"name": "tool", "in": "tool", "displacement": [0.003, -0.01], "rotation": 0.0},
        ],
        "contacts": [
            {"on": "lower.y-", "obstacle": floor, **rough},
            {"on": "upper.y-", "against": "lower.y+", **rough},
            {"on": "upper.y+", "against": "tool", **rough},
        ],
        "steps": [{"tool": 1}, {"tool": -0.1}],
        "solver": {"tolerance": 1e-8, "method": method},
    }


@pytest.mark.parametrize("method", ["auto", "primal"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_tool_that_is_drawn_back_leaves_blocks_without_forces(shape: str, method: str) -> None:
    """SMALBE-M left forces of 1e-17, and no increment in which the blocks came apart had a
    certificate."""
    answers = contact_app.solve(pressed_by(shape, method))
    assert answers.converged
    pressed, free = answers.summary["steps"][0], answers.summary["steps"][-1]
    assert pressed["contacts"][2]["force"][1] < -0.1
    for contact in free["contacts"]:
        assert np.abs(contact["force"]).max() < 1e-9
    assert np.abs(answers.last.von_mises).max() < 1e-9
