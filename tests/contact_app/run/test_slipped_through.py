"""A round obstacle that passes between the nodes of a contact boundary is told of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from contact_app.accuracy.contact_limits import entered_between
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from tests import scenes
from tests.comparison import solve


def lifted(cells: int, cell: str = "quadrilateral", degree: int = 1, **more: Any) -> scenes.Config:
    """A block that its own force lifts against a small disc above the middle of a facet."""
    box = {"lower": [0, 0], "upper": [2, 1], "cells": [cells, cells], "cell": cell}
    disc = {"sphere": {"center": [0.51, 1.0 + 0.2 + 1e-3], "radius": 0.2}}
    return {
        "dimension": 2,
        "bodies": [
            {
                "name": "b",
                "mesh": {"box": box},
                "material": {"young": 1000.0, "poisson": 0.3},
                "degree": degree,
            }
        ],
        "conditions": [
            {"on": "b.y-", "displacement": [0, 0]},
            {"in": "b", "force": [0, 20.0]},
        ],
        "contacts": [{"on": "b.y+", "obstacle": disc}],
        **more,
    }


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_contact_between_nodes_causes_a_warning(cell: str) -> None:
    coarse = solve(lifted(2, cell))
    moved = coarse.summary["solution"]["max_displacement"]
    assert coarse.summary["solution"]["active_contacts"] == 0
    depth = entered_between(coarse.model, coarse.solution, 0)
    assert 0.5 * moved < depth < moved, "the top rises by less than the whole, the disc stays"
    assert any("between the nodes of b" in w for w in coarse.solution.certificate.warnings)
    fine = solve(lifted(64, cell))
    assert fine.summary["solution"]["active_contacts"] > 0
    assert entered_between(fine.model, fine.solution, 0) < 0.1 * moved
    assert not any("between the nodes" in w for w in fine.solution.certificate.warnings)


def test_the_same_on_facets_of_second_order_and_in_parts() -> None:
    whole, parts = (solve(lifted(2, degree=2), n) for n in (1, [2, 2]))
    depths = [entered_between(s.model, s.solution, 0) for s in (whole, parts)]
    assert depths[0] == pytest.approx(depths[1], rel=1e-5)
    assert depths[0] > 0.0


def test_interference_with_a_flat_side_causes_a_warning() -> None:
    """The disc stands in the side before anything moves, where no node is."""
    made = lifted(2)
    made["contacts"][0]["obstacle"]["sphere"]["center"][1] -= 0.002
    solved = solve(made)
    depth = entered_between(solved.model, solved.solution, 0)
    assert depth > solved.summary["solution"]["max_displacement"]


def test_a_round_surface_on_a_round_obstacle_is_no_obstacle_between_nodes() -> None:
    """The initial overlap is that of the polygon, which another warning covers."""
    config = Path(__file__).parents[3] / "configs" / "bushing.yaml"
    solved = solve_scene(build_scene(load(config)))
    depth = entered_between(solved.model, solved.solution, 0)
    assert depth < 0.01 * solved.summary["solution"]["max_displacement"]
