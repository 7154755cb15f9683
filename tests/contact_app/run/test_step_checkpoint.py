"""The digest by which a checkpoint of a load history knows its scene."""

import copy
from pathlib import Path
from typing import Any

import pytest

from tests import meshfiles, scenes


def history(tmp_path: Path) -> dict[str, Any]:
    """A heated box and a block from a file under a rigid roller, in two steps."""
    meshfiles.write(meshfiles.block("quadrilateral", 3), tmp_path / "block.msh")
    box = scenes.block("quadrilateral", 4, name="box", lower=(2, 0, 0), upper=(3, 1, 1))
    box["material"]["expansion"] = 1e-3
    box["boundaries"] = {"edge": {"where": "x > 2.5 and y < 1e-9"}}
    block = {"name": "block", "mesh": {"file": str(tmp_path / "block.msh")},
             "material": {"young": 100.0, "poisson": 0.3},
             "boundaries": {"foot": {"where": "y < 1e-9"}}}  # fmt: skip
    roller = {"name": "roller", "rigid": {"sphere": {"center": [2.5, 3.0], "radius": 2.0}}}
    return {
        "title": "history", "dimension": 2, "bodies": [box, block, roller],
        "conditions": [
            {"on": "box.edge", "displacement": [0, 0]},
            {"on": "block.foot", "displacement": [0, 0]},
            {"name": "heat", "in": "box", "temperature": "5 * x"},
            {"name": "press", "in": "roller", "total_force": [0, -1]},
            {"in": "roller", "displacement": [0, None], "rotation": 0},
        ],
        "contacts": [{"on": "box.y+", "against": "roller"}],
        "steps": [{"press": 1}, {"heat": 1, "increments": 3}],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("bodies", 0, "mesh", "box", "upper"), [3, 1.25]),
        (("bodies", 0, "mesh", "box", "cells"), [2, 9]),
        (("bodies", 0, "boundaries", "edge", "where"), "x > 2.2 and y < 1e-9"),
        (("bodies", 0, "hold"), ["x"]),
        (("bodies", 1, "mesh", "translate"), [0, 0.5]),
        (("bodies", 2, "rigid", "sphere", "radius"), 1.9),
        (("conditions", 2, "temperature"), "6 * x"),
        (("steps", 0, "press"), 2),
    ],
)
def test_a_scene_has_one_digest_and_another_scene_another(
    keys: tuple[Any, ...], value: Any, tmp_path: Path
) -> None:
    """A run goes on if only later steps changed; the first step is the one that has ended."""
    made = history(tmp_path)
    here = scenes.build(made).digest(1)
    assert scenes.build({**made, "steps": [{"press": 1}, {"heat": 2}]}).digest(1) == here
    other = copy.deepcopy(made)
    place = other
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    assert scenes.build(other).digest(1) != here
