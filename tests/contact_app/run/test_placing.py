"""Rigid bodies that each new placement moves further: `contact_app.run.placing`."""

from typing import Any

import pytest

from contact_app.accuracy import solved_scene
from contact_app.accuracy.hertz import coarse_pressures
from contact_app.errors import NoEquilibriumError
from contact_app.run.placing import JUDGED, PLACINGS, Relaxation, never_placed
from contact_app.run.solve import solve_scene
from contact_app.run.summary import warned
from contact_app.scene.rigid import Placement
from tests import scenes


@pytest.mark.parametrize(("ratio", "leaves"), [(1.05, True), (0.9, False), (-1.0, False)])
def test_a_body_leaves_if_its_steps_do_not_shrink_and_keep_their_direction(
    ratio: float, leaves: bool
) -> None:
    """Steps that grow, that shrink, and that turn about."""
    relaxation, place, step, moves_on = Relaxation(), 0.0, 0.01, list[bool]()
    for _ in range(PLACINGS):
        now, computed = ([Placement((x, 0.0, 0.0))] for x in (place, place + step))
        (after,) = relaxation.towards(now, computed)
        moves_on.append(relaxation.moves_on)
        step *= ratio
        place = after.displacement[0]
    assert not any(moves_on[: JUDGED - 1])
    assert any(moves_on) is moves_on[JUDGED - 1] is leaves


def test_an_answer_that_is_never_placed_has_its_verdict_and_warnings_in_the_summary(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The summary was made anew with each warning, and contacts with few facets found anew."""
    found: list[int] = []

    def counting(*arguments: Any) -> Any:
        found.append(1)
        return coarse_pressures(*arguments)

    monkeypatch.setattr(solved_scene, "coarse_pressures", counting)
    ball = {"name": "ball", "rigid": {"sphere": {"center": [0, 1], "radius": 1}}}
    solved = solve_scene(scenes.build({
        "dimension": 2,
        "bodies": [scenes.box("block", [2, 0], [8, 4], [-2, -1]), ball],
        "conditions": [
            {"on": "block.y-", "displacement": [0, 0]},
            {"in": "ball", "displacement": [0, None], "rotation": 0},
            {"in": "ball", "total_force": [0, -10]},
        ],
        "contacts": [{"on": "block.y+", "against": "ball"}],
    }))  # fmt: skip
    assert found == [1]
    assert solved.summary["certificate"]["passed"]
    answer = never_placed(warned(solved, ["first"]))
    certificate = answer.summary["certificate"]
    assert not certificate["passed"]
    assert certificate["warnings"][-2] == "first"
    assert certificate["warnings"] == list(answer.solution.certificate.warnings)


def test_a_circle_that_rolls_away_is_refused_after_few_placements() -> None:
    """It ended with exit 1 after forty: relaxed steps were a little shorter later than before."""
    with pytest.raises(NoEquilibriumError, match=f"each of {JUDGED} solves.* moved the bodies"):
        solve_scene(scenes.build({
            "dimension": 2,
            "bodies": [
                scenes.box("block", [2, 0], [40, 4], [-2, -1]),
                {"name": "ball", "rigid": {"sphere": {"center": [0, 1], "radius": 1}}},
            ],
            "conditions": [
                {"on": "block.y-", "displacement": [0, 0]},
                {"in": "ball", "total_force": [0.5, -10]},
            ],
            "contacts": [{"on": "block.y+", "against": "ball", "friction": {"coulomb": 0.3}}],
        }))  # fmt: skip
