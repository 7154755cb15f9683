"""Random scenes with friction: none is answered wrongly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from contact_app.run.solve import solve_scene
from tests.stability.friction_scenes import friction_scene
from tests.stability.fuzz_friction import judge

FAST, SLOW = 8, 200

SHARED = (4, 116)
"""Nodes in two or three frictional contacts, along which gaps close: active sets of points that
stick were inconsistent, and nothing was certified."""

LIFTED = (70,)
"""A block is moved off a ball and has no strains: its first set went on for ever."""

SECOND = (75, 89)
"""Three frictional contacts that share edges: the forces at an edge may be divided in several ways
among its contacts, and with them Coulomb's limits. There are several answers."""


@pytest.mark.parametrize("seed", [*range(FAST), *SHARED, *LIFTED])
def test_random_scene(seed: int) -> None:
    verdict = judge(seed)
    assert verdict.kind in ("agrees", "contradicts"), verdict


@pytest.mark.parametrize("seed", SECOND)
def test_several_answers(seed: int) -> None:
    """An answer that is not the reference's meets all conditions, and the reference stays there."""
    verdict = judge(seed)
    assert verdict.kind in ("agrees", "second"), verdict


@pytest.mark.slow
def test_200_random_scenes() -> None:
    verdicts = [judge(seed) for seed in range(FAST, FAST + SLOW)]
    assert [v for v in verdicts if v.fault] == []
    kinds = [v.kind for v in verdicts]
    assert kinds.count("agrees") > 0.8 * SLOW
    assert kinds.count("degraded") + kinds.count("undecided") < 0.02 * SLOW


def test_the_scenes_have_all_kinds() -> None:
    """Equal for equal seeds, and with something of everything."""
    made = [friction_scene(seed)[0] for seed in range(100)]
    assert made[7] == friction_scene(7)[0]
    laws = [contact["friction"] for scene in made for contact in scene["contacts"]]
    assert sum("tresca" in law for law in laws) > 20 < sum("coulomb" in law for law in laws)
    assert sum(len(scene["contacts"]) > 1 for scene in made) > 20
    assert sum(len(scene["bodies"]) > 1 for scene in made) > 20
    assert {scene["dimension"] for scene in made} == {2, 3}


def test_a_wrong_answer_is_a_fault() -> None:
    """The judge itself: displacements that are a little larger."""

    def wrong(scene: Any) -> Any:
        solved = solve_scene(scene)
        moved = 1.001 * solved.nodes.displacement
        return replace(solved, nodes=replace(solved.nodes, displacement=moved))

    seed = next(s for s in range(20) if judge(s).kind == "agrees")
    assert judge(seed, solve=wrong).kind == "certified wrongly"
