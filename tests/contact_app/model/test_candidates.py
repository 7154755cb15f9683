"""Contact rows only where a bound on the displacement lets a node touch."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.outline import outline
from contact_app.run.solve import solve_scene
from tests import reference, scenes
from tests.comparison import in_order_of


def dome(cell: str, n: int = 6) -> scenes.Config:
    """A held block under a ball that overlaps the middle of its top."""
    made = scenes.wall(cell, n)
    ball = {"sphere": {"center": scenes.vector(cell, 0.5, 0.5, 1.0 + 0.5 - 0.02), "radius": 0.5}}
    made["conditions"][1]["traction"] = scenes.vector(cell, 1, 0, 0)
    made["contacts"] = [{"on": f"block.{scenes.up(cell)}", "obstacle": ball}]
    return made


def rows_of(scene: Any, estimated: bool) -> tuple[int, int]:
    known = outline(scene, MPI.COMM_SELF, needed="estimated" if estimated else "all")
    return len(known.contact.nodes), len(known.left_out.nodes)


@pytest.mark.parametrize("split", [1, 4])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_the_answer_is_that_of_all_rows(cell: str, split: int) -> None:
    scene = scenes.build(dome(cell), split)
    near, far = rows_of(scene, True)
    assert far > near > 0
    assert rows_of(scene, False) == (near + far, 0)
    solved, known = solve_scene(scene), reference.solve(scene)
    assert solved.summary["decomposition"]["contact"] == near
    u = in_order_of(known, solved)
    np.testing.assert_allclose(u, known.u, rtol=0, atol=1e-7 * np.abs(known.u).max())
    gap = solved.nodes.gap[~np.isnan(solved.nodes.gap)]
    assert len(gap) == near + far  # the distance is told at all of them


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_a_bound_that_was_wrong(cell: str, caplog: pytest.LogCaptureFixture) -> None:
    """Nodes that were left out come into contact: the scene is solved again with all."""
    made = scenes.tilted_plane(cell, 4)
    scene = scenes.build(made, 1)
    known = reference.solve(scene)
    with caplog.at_level(logging.INFO, "contact_app"):
        solved = solve_scene(scene, needed=np.zeros(rows_of(scene, False)[0], bool))
    assert "solving again with" in caplog.text
    assert 0 < solved.summary["decomposition"]["contact"] <= rows_of(scene, False)[0]
    assert solved.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-7)
    assert known.active > 0


@pytest.mark.parametrize("angle", [1e-3, 1e-6])
@pytest.mark.parametrize("split", [1, 4])
@pytest.mark.ratchet
def test_an_obstacle_that_is_nearly_repeated(angle: float, split: int) -> None:
    """No more products than without the second plane, and the answer of both."""
    made = scenes.wall("quadrilateral", 12)
    made["contacts"][0]["obstacle"] = scenes.plane("quadrilateral", (1.001, 0, 0), (-1, 0, 0))
    once = solve_scene(scenes.build(made, split)).summary
    turned = scenes.plane("quadrilateral", (1.001, 0, 0.5), (-1, 0, angle))
    made["contacts"].append({"on": "block.x+", "obstacle": turned})
    scene = scenes.build(made, split)
    solved, known = solve_scene(scene), reference.solve(scene)
    assert solved.summary["certificate"]["passed"]
    u = in_order_of(known, solved)
    np.testing.assert_allclose(u, known.u, rtol=0, atol=1e-6 * np.abs(known.u).max())
    products = [s["solver"]["hessian_multiplications"] for s in (once, solved.summary)]
    assert products[1] < 2 * products[0] + 10
    assert known.active > 0


def test_a_body_kept_by_contact_alone_keeps_its_rows() -> None:
    made = scenes.floating_in_corner("hexahedron", 3)
    made["contacts"].append(
        {"on": "block.x+", "obstacle": scenes.plane("hexahedron", (9, 0, 0), (-1, 0, 0))}
    )
    assert rows_of(scenes.build(made), True)[1] == 0


def test_a_pair_of_bodies() -> None:
    """Two held bodies face to face, far apart and near."""
    for gap, left in ((0.5, True), (1e-3, False)):
        lower = scenes.block("quadrilateral", 4, name="lower")
        upper = scenes.block("quadrilateral", 3, name="upper", lower=(0, 0, 1 + gap),
                             upper=(1, 1, 2 + gap))  # fmt: skip
        made = scenes.config(
            "quadrilateral",
            [lower, upper],
            [scenes.clamp("quadrilateral", "lower.y-"), scenes.clamp("quadrilateral", "upper.y+"),
             {"in": "upper", "force": [0, -5]}],
            [{"on": "upper.y-", "against": "lower.y+"}],
        )  # fmt: skip
        scene = scenes.build(made, 1)
        near, far = rows_of(scene, True)
        assert (near == 0) == left
        assert (far > 0) == left
        energy = solve_scene(scene).summary["solution"]["energy"]
        assert energy == pytest.approx(reference.solve(scene).energy, rel=1e-7)
