"""Answers whose place is one of several: the play that pressing points leave a body."""

from pathlib import Path

import pytest

import contact_app
from contact_app.results.undetermined import Undetermined, play_warnings
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.comparison import certified_in_and_slid
from tests.scenes_on_ranks import summary_of

FRICTION = {"friction": {"coulomb": 0.3}}


def between_walls(right: float = 1.2, **more: object) -> scenes.Config:
    """A block that is pressed onto a floor, 0.1 beside one wall and another on its right."""

    def plane(point: list[float], normal: list[float]) -> dict[str, object]:
        return {"obstacle": {"plane": {"point": point, "normal": normal}}}

    return {
        "dimension": 2,
        "bodies": [scenes.box("block", [1, 1], [4, 4], **more)],
        "conditions": [{"on": "block.y+", "pressure": 20.0}],
        "contacts": [
            {"on": "block.y-", **plane([0, 0], [0, 1])},
            {"on": "block.x-", **plane([-0.1, 0], [1, 0])},
            {"on": "block.x+", **plane([right, 0], [-1, 0])},
        ],
    }


def plays(made: scenes.Config) -> list[str]:
    """Warnings of a play."""
    answer = contact_app.solve(made)
    assert answer.certificate.passed
    return [w for w in answer.summary["certificate"]["warnings"] if "has a play of" in w]


@pytest.mark.parametrize("right", [1.2, 1.05])
def test_the_play_between_two_walls_causes_a_warning(right: float) -> None:
    """The block may lie anywhere between the walls; under the pressure it is wider by 0.0078."""
    (told,) = plays(between_walls(right))
    words = told.split()
    assert told.startswith("block has a play of")
    assert "along +x:" in told
    wide = 0.3 * 1.3 * 20.0 / 1000.0  # ν(1 + ν) p / E, plane strain
    assert float(words[5]) == pytest.approx(0.1 + right - 1.0 - wide, rel=5e-3)


def test_no_warning_where_the_position_is_determined() -> None:
    assert not plays(between_walls(hold=["x"]))
    pushed = between_walls()
    pushed["conditions"].append({"on": "block.x-", "traction": [1.0, 0]})
    assert not plays(pushed)
    rough = between_walls()
    rough["contacts"][0].update(FRICTION)
    assert not plays(rough)


def test_lengths_are_relative_to_the_displacement_without_the_play() -> None:
    """A slide between the walls leaves the certificate as it is.

    Relative to a large slide, a large penetration would be small.
    """
    made = between_walls()
    made["decomposition"] = {"subdomains": 4}
    solved = solve_scene(scenes.build(made))
    before, after = certified_in_and_slid(solved, 0.08)
    assert before[0].max_penetration > 1e-3
    assert after[1].displacement > 2.0 * before[1].displacement
    assert after[0].max_penetration == pytest.approx(before[0].max_penetration)
    assert after[1].deformations[0] == pytest.approx(before[1].deformations[0])


def test_a_motion_that_no_row_resists_is_no_play() -> None:
    alone = between_walls()
    del alone["contacts"][1:]
    assert not plays(alone)


@pytest.mark.parametrize("rough", [False, True])
def test_a_body_on_a_single_point_has_the_play_of_a_tilt(rough: bool) -> None:
    """Two feet under the middle and a load above them: the plate tilts until an end is down.

    Friction holds the feet, but does not resist the tilt.
    """
    made = between_walls(**({} if rough else {"hold": ["x"]}))
    made["conditions"][0]["pressure"] = 0.1
    made["bodies"][0]["boundaries"] = {"middle": {"where": "y < 1e-9 and abs(x - 0.5) < 0.1"}}
    made["contacts"] = [
        {**made["contacts"][0], "on": "block.middle", **(FRICTION if rough else {})},
        {"on": "block.y-", "obstacle": {"plane": {"point": [0, -0.01], "normal": [0, 1]}}},
    ]
    (told,) = plays(made)
    assert "at its point that moves most, along" in told
    assert "a turn about z" in told


def test_two_ranks_report_the_same_play(tmp_path: Path) -> None:
    one, two = (summary_of(between_walls(), tmp_path, ranks) for ranks in (1, 2))
    told = [[w for w in s["certificate"]["warnings"] if "play" in w] for s in (one, two)]
    assert len(told[0]) == 1
    assert told[0] == told[1]


def test_one_sentence_names_each_body_once_with_its_largest_play() -> None:
    found = [
        Undetermined("pin", "along +x", 0.1),
        Undetermined("pin", "along +y", 0.3),
        Undetermined("ring", "along +x", 0.2),
    ]
    (sentence,) = play_warnings(found, "friction")
    assert sentence.count("pin has a play of 0.3") == sentence.count("pin") == 1
    assert "ring has a play of 0.2" in sentence
    assert sentence.endswith("friction determines the position")
    assert play_warnings([], "friction") == []


def test_a_body_with_one_wall_can_move_away_without_limit() -> None:
    made = between_walls()
    del made["contacts"][2]
    warnings = contact_app.solve(made).summary["certificate"]["warnings"]
    assert any(w.startswith("block can move without limit, one way, along +x:") for w in warnings)
    assert not any("slides by" in w for w in warnings)
