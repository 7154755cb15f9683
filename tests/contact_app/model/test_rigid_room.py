"""Held nodes that leave a rigid body no room: no displacement satisfies all conditions."""

import pytest

from contact_app.errors import NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import scenes


def plane_at_a_held_side(moved: float | None, pivot: float) -> scenes.Config:
    """A plane against a held side of a block; it may turn about a point at the height `pivot`."""
    block = scenes.block("quadrilateral", 4)
    plane = {"name": "plate", "rigid": {"plane": {"point": [0, pivot], "normal": [1, 0]}}}
    conditions = [
        {"on": "block.x-", "displacement": [0, 0]},
        {"in": "plate", "displacement": [moved, 0], "rotation": None},
        {"on": "block.x+", "pressure": 1.0},
    ]
    contacts = [{"on": "block.x-", "against": "plate"}]
    return scenes.config("quadrilateral", [block, plane], conditions, contacts)


def test_a_plane_that_may_turn_but_not_draw_back_is_refused() -> None:
    """Whatever its turn, it enters nodes above its pivot or below it."""
    made = plane_at_a_held_side(0.01, 0.4)
    with pytest.raises(NoEquilibriumError) as found:
        solve_scene(scenes.build(made))
    assert "leave the rigid body plate no room" in str(found.value)
    assert "contacts[0]" in str(found.value)
    assert "by 0.01 or more" in str(found.value)


@pytest.mark.parametrize(("moved", "pivot"), [(0.01, 2.0), (0.0, 0.5), (None, 0.5)])
def test_a_plane_that_may_turn_away_or_touches_alone_has_room(
    moved: float | None, pivot: float
) -> None:
    """From a pivot above the side the plane turns away from all of it."""
    answer = solve_scene(scenes.build(plane_at_a_held_side(moved, pivot)))
    assert answer.summary["certificate"]["passed"]
