"""Nearly parallel rows are left out, and rows that the answer penetrates join again."""

import logging
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.model.model import build_model
from contact_app.model.outline import outline_of_scene
from contact_app.run.solve import solve_scene
from tests import reference, scenes
from tests.comparison import same_displacement


def rows_of(scene: Any) -> tuple[int, int]:
    """Numbers of contact rows, and of candidate rows that are left out."""
    known = outline_of_scene(scene, MPI.COMM_SELF, needed="distinct")
    return len(known.contact.nodes), len(known.left_out.nodes)


class NoRowsAtFirst:
    """Models of which the first one has no contact rows."""

    keeps_subdomains = False

    def model(self, scene: Any, timings: Any, needed: Any, report: Any) -> Any:
        rows = np.zeros(rows_of(scene)[0], bool) if isinstance(needed, str) else needed
        return build_model(scene, MPI.COMM_SELF, timings, rows, report)

    def estimator(self, model: Any) -> ErrorEstimator:
        return ErrorEstimator(model)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_rows_that_the_answer_penetrates_join(cell: str, caplog: pytest.LogCaptureFixture) -> None:
    """Nodes without rows come into contact: the scene is solved again with their rows."""
    made = scenes.tilted_plane(cell, 4)
    scene = scenes.build(made, 1)
    known = reference.solve(scene)
    with caplog.at_level(logging.INFO, "contact_app"):
        solved = solve_scene(scene, MPI.COMM_SELF, cases=NoRowsAtFirst())
    assert "solving again with" in caplog.text
    assert 0 < solved.summary["decomposition"]["contact"] <= rows_of(scene)[0]
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
    same_displacement(known, solved, 1e-6)
    products = [s["solver"]["hessian_multiplications"] for s in (once, solved.summary)]
    assert products[1] < 2 * products[0] + 10
    assert known.active > 0


def test_a_body_held_by_contact_alone_has_all_rows() -> None:
    """Rows of a nearly repeated obstacle are left out on a held body, not on a floating one."""
    for made, left_out in (
        (scenes.wall("hexahedron", 3), 12),
        (scenes.floating_in_corner("hexahedron", 3), 0),
    ):
        obstacle = made["contacts"][0]["obstacle"]["plane"]
        turned = {**obstacle, "normal": np.add(obstacle["normal"], [1e-3, 1e-3, 1e-3]).tolist()}
        made["contacts"].append({**made["contacts"][0], "obstacle": {"plane": turned}})
        assert rows_of(scenes.build(made))[1] == left_out
