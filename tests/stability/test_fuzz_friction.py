"""Random scenes with friction: none is answered wrongly."""

from dataclasses import replace
from typing import Any

import pytest

from contact_app.run.solve import solve_scene
from tests import scenes
from tests.friction_reference import condense
from tests.ranks import execute
from tests.stability import fuzz_histories
from tests.stability.friction_scenes import friction_scene
from tests.stability.fuzz_friction import OPTIMAL, forces_of, judge

FAST, SLOW = 8, 200

HISTORIES = (39, 55)
"""Load histories: a block in two contacts, and a pair beside a wall."""

SHARED = (4, 116)
"""Nodes in two or three frictional contacts, along which gaps close: active sets of points that
stick were inconsistent, and nothing was certified."""

LIFTED = (70,)
"""A block is moved off a ball and has no strains: its first set went on for ever."""

STALLED = (33075,)
"""Conjugate gradients stall in subdomains: multigrid is the last way."""

LIKE = 3
"""A scene that has the same answer in other units and decompositions."""

TRIANGLES = 55
"""A pair of triangles, where a row may have its largest entry on the other body."""

SECOND = (75, 89)
"""Three frictional contacts that share edges: the forces at an edge may be divided in several ways
among its contacts, and with them Coulomb's limits. There are several answers."""


@pytest.mark.parametrize("seed", [*range(FAST), *SHARED, *LIFTED, *STALLED])
def test_random_scene(seed: int) -> None:
    verdict = judge(seed)
    assert verdict.kind in ("agrees", "contradicts"), verdict


@pytest.mark.parametrize("seed", SECOND)
def test_several_answers(seed: int) -> None:
    """An answer that is not the reference's meets all conditions, and the reference stays there."""
    verdict = judge(seed)
    assert verdict.kind in ("agrees", "second"), verdict


def test_forces_of_a_pair_meet_the_conditions() -> None:
    """Contact forces of an answer have the signs that rows of the reference have."""
    made, subdomains = friction_scene(TRIANGLES)
    scene = scenes.build(made, subdomains)
    condensed = condense(scene)
    assert condensed.residual(forces_of(condensed, solve_scene(scene))) < OPTIMAL


def test_other_units_and_decompositions() -> None:
    made, _ = friction_scene(LIKE)
    other, _ = friction_scene(LIKE, 1)
    assert made["bodies"][0]["material"] != other["bodies"][0]["material"]
    assert [c["friction"].keys() for c in made["contacts"]] == [
        c["friction"].keys() for c in other["contacts"]
    ]
    verdict = judge(LIKE, variant=1)
    assert verdict.kind == "agrees", verdict


@pytest.mark.mpi
def test_random_scenes_on_two_ranks() -> None:
    """The reference of the first rank decides for both."""
    program = "from tests.stability.fuzz_friction import judge; print(judge({}).kind)"
    told = execute(program.format(SHARED[0]), ranks=2).splitlines()
    assert told == ["agrees", "agrees"]


@pytest.mark.parametrize("seed", HISTORIES)
def test_random_history(seed: int) -> None:
    verdict = fuzz_histories.judge(seed)
    assert verdict.kind == "agrees", verdict


def test_slips_measured_from_elsewhere_are_a_fault() -> None:
    """The judge of histories itself: an increment that forgets what slipped before."""

    def forgets(scene: Any) -> Any:
        found = fuzz_histories.solve_history(scene)
        alone = [solve_scene(scene.under(scene.loading_at(i.place.step - 1, 1.0))) for i in found]
        return [replace(i, solved=s) for i, s in zip(found, alone, strict=True)]

    assert fuzz_histories.judge(HISTORIES[0], solve=forgets).fault


def test_a_wrong_answer_is_a_fault() -> None:
    """The judge itself: displacements that are a little larger."""

    def wrong(scene: Any) -> Any:
        solved = solve_scene(scene)
        moved = 1.001 * solved.nodes.displacement
        return replace(solved, nodes=replace(solved.nodes, displacement=moved))

    seed = next(s for s in range(20) if judge(s).kind == "agrees")
    assert judge(seed, solve=wrong).kind == "certified wrongly"
