"""Bodies whose subdomains leave the dual problem no digits are solved whole."""

from __future__ import annotations

import pytest

from contact_app.run import solve_scene
from tests import reference, scenes


def slab(dimension: int, cells: list[int], length: float) -> scenes.Config:
    """A held slab beside an oblique plane, of cells a hundred times longer than thick."""
    upper = [0.3, 1.5, length] if dimension == 3 else [0.3, length]
    cell = "hexahedron" if dimension == 3 else "quadrilateral"
    box = {"lower": [0.0] * dimension, "upper": upper, "cells": cells, "cell": cell}
    plane = {"point": [0.3, 0.0, 0.0][:dimension], "normal": [-0.9, -0.3, -0.27][:dimension]}
    return {
        "title": "slab",
        "dimension": 3 if dimension == 3 else "plane_strain",
        "bodies": [
            {
                "name": "b",
                "mesh": {"box": box},
                "material": {"young": 50.0, "poisson": 0.43},
                "degree": 2,
            }
        ],
        "conditions": [
            {"on": "b.x-", "displacement": [-0.0002, -0.0008, 0.033][:dimension]},
            {"on": "b.y-", "traction": [-0.0015, 0.05, -0.016][:dimension]},
        ],
        "contacts": [{"on": "b.x+", "obstacle": {"plane": plane}}],
        "solver": {"tolerance": 1e-8},
    }


SLABS = [(3, [2, 2, 2], 200.0), (2, [4, 4], 300.0)]


@pytest.mark.parametrize(("dimension", "cells", "length"), SLABS)
def test_what_rounding_keeps_from_an_answer_in_parts_is_solved_whole(
    dimension: int, cells: list[int], length: float
) -> None:
    scene = scenes.build(slab(dimension, cells, length), 4)
    summary = solve_scene(scene).summary
    assert summary["certificate"]["passed"]
    assert summary["decomposition"]["subdomains"] == 1
    assert "in 4 subdomains the answer could not be" in summary["certificate"]["warnings"][-1]
    known = reference.solve(scene).energy
    assert summary["solution"]["energy"] == pytest.approx(known, rel=1e-6)


def test_a_limit_on_steps_stays_one() -> None:
    made = slab(*SLABS[0])
    made["solver"]["max_iterations"] = 40
    summary = solve_scene(scenes.build(made, 4)).summary
    assert not summary["certificate"]["passed"]
    assert summary["decomposition"]["subdomains"] == 4
    assert summary["solver"]["cg_steps"] <= 40
