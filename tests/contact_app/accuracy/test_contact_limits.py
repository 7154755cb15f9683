"""The error added by contact on a few facets, against finer meshes."""

import math

import pytest

from contact_app.accuracy.contact_limits import coarse_contact
from tests import scenes
from tests.comparison import solve

LIFT, RADIUS = 0.02, 0.5


def pushed_against_a_ball(cells: int, degree: int, above: float) -> scenes.Config:
    """A block that is lifted against a ball above the middle of a facet of four by four.

    Parameters
    ----------
    above
        Gap between the ball and the block at the nodes of the mesh of four by four.
    """
    middle = 0.75
    off = math.sqrt(2.0) * 0.25
    height = 1.0 + math.sqrt(RADIUS**2 - off**2) + above
    ball = {"sphere": {"center": [middle, middle, height], "radius": RADIUS}}
    return {
        "dimension": 3,
        "bodies": [scenes.box("b", [2, 2, 1], [cells, cells, cells // 2], degree=degree)],
        "conditions": [
            {"on": "b.z-", "displacement": [0.0, 0.0, LIFT]},
            {"on": "b.x+", "displacement": [0.0, None, None]},
            {"on": "b.z+", "traction": [0.0, 0.0, 20.0]},
        ],
        "contacts": [{"on": "b.z+", "obstacle": ball}],
    }


@pytest.mark.parametrize("above", [0.035, 0.03])
def test_a_node_that_hardly_touches_adds_little_to_the_error(above: float) -> None:
    """The force at its nodes is a tenth of what pushes the ball out of the facet."""
    coarse = solve(pushed_against_a_ball(4, 1, above))
    assert 0 < coarse.summary["solution"]["active_contacts"] <= 4
    fine = solve(pushed_against_a_ball(32, 1, above))
    assert fine.summary["solution"]["active_contacts"] > 8
    coarse_energy, fine_energy = (s.summary["solution"]["energy"] for s in (coarse, fine))
    square = 2.0 * (fine_energy - coarse_energy)
    assert square > 100.0 * coarse.accuracy.discretisation**2 * coarse.accuracy.square
    added = coarse_contact(coarse.model, coarse.solution, coarse.nodes)
    assert 0.7 * square < added < 1.5 * square
