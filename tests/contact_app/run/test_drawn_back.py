"""A rigid tool approaches rough blocks, presses them and is drawn back."""

from typing import Any

import numpy as np
import pytest

import contact_app
from tests import scenes

GAP = 0.003


def shape_of(name: str, gap: float) -> dict[str, Any]:
    """The shape of a tool with a gap to the blocks."""
    if name == "plane":
        return {"plane": {"point": [1.0, 2.0 + gap], "normal": [0.0, -1.0]}}
    return {"sphere": {"center": [1.0, 4.0 + gap], "radius": 2.0}}


def pressed_by(shape: str, method: str, gap: float = 0.0) -> dict[str, Any]:
    """Two blocks on a rough floor under a rough tool, in two steps."""
    rough = {"friction": {"coulomb": 0.2}}
    lower = scenes.box("lower", [2, 1], [8, 4], [0, 0], "quadrilateral", 1000.0, 0.3)
    upper = scenes.box("upper", [1.7, 2], [5, 4], [0.3, 1], "quadrilateral", 500.0, 0.25)
    floor = {"plane": {"point": [0, 0], "normal": [0, 1]}}
    return {
        "dimension": 2,
        "bodies": [lower, upper, {"name": "tool", "rigid": shape_of(shape, gap)}],
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
@pytest.mark.parametrize("shape", ["plane", "sphere"])
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


@pytest.mark.parametrize("method", ["auto", "primal"])
@pytest.mark.parametrize("shape", ["plane", "sphere"])
def test_a_tool_closes_its_gap_in_the_middle_of_a_step(shape: str, method: str) -> None:
    """In multigrid a state at rest had the relative error one, and no penetrated row joined."""
    made = pressed_by(shape, method, GAP) | {"steps": [{"tool": 1, "increments": 5}]}
    made["conditions"][1]["displacement"] = [0.003, -0.01 - GAP]
    answers = contact_app.solve(made)
    assert answers.converged
    increments = answers.summary["steps"]
    assert len(increments) == 5, "no increment was halved"
    assert increments[0]["solution"]["max_displacement"] == 0.0
    assert increments[0]["contacts"][2]["force"][1] == 0.0
    assert increments[-1]["contacts"][2]["force"][1] < -0.1
