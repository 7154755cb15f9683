"""The least motion among the answers of equal energy: `solver.problem.least_motion`."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import contact_app
from contact_app.run.solve import solve_scene
from solver.problem.least_motion import with_least_motion
from tests import scenes
from tests.scenes_on_ranks import summary_of
from tests.stability.feature_scenes import feature_scene

METHODS = ["auto", "active-set", "smalbe", "primal"]

WIDER = 0.3 * 1.3 * 20.0 / 1000.0
"""How much wider a block of these scenes becomes: ν(1 + ν) p / E in plane strain."""


def plane(point: list[float], normal: list[float]) -> scenes.Config:
    return {"obstacle": {"plane": {"point": point, "normal": normal}}}


def blocks(*lower: float, left: float, right: float) -> scenes.Config:
    """Blocks of size one, pressed onto a floor in a row between two walls."""
    names = "abc"[: len(lower)]
    bodies = [
        scenes.box(name, [x + 1.0, 1.0], [3 + n, 3], [x, 0.0])
        for n, (name, x) in enumerate(zip(names, lower, strict=True))
    ]
    return {
        "dimension": 2,
        "bodies": bodies,
        "conditions": [{"on": f"{name}.y+", "pressure": 20.0} for name in names],
        "contacts": [
            *({"on": f"{name}.y-", **plane([0, 0], [0, 1])} for name in names),
            {"on": "a.x-", **plane([left, 0], [1, 0])},
            {"on": f"{names[-1]}.x+", **plane([right, 0], [-1, 0])},
            *({"on": f"{a}.x+", "against": f"{b}.x-"} for a, b in pairwise(names)),
        ],
    }


def moved(made: scenes.Config, method: str) -> list[float]:
    """Mean displacement of each block along x."""
    answer = contact_app.solve({**made, "solver": {"method": method}})
    assert answer.certificate.passed
    return [answer.displacement[np.unique(cells), 0].mean() for cells in answer.cells]


@pytest.mark.parametrize("method", METHODS)
def test_a_block_with_play_on_both_sides_stays(method: str) -> None:
    assert moved(blocks(0.0, left=-0.1, right=1.2), method) == pytest.approx([0.0], abs=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_overlaps_a_wall_moves_until_it_touches_the_wall(method: str) -> None:
    expected = [0.02 + WIDER / 2.0]
    assert moved(blocks(0.0, left=0.02, right=1.2), method) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_a_block_pushes_the_next_one_no_farther_than_it_must(method: str, rough: bool) -> None:
    """The second one gives way to the first and to the wider sides of both, the third stays.

    So it does where the third block has friction, which does not hold the others.
    """
    made = blocks(0.0, 1.01, 2.3, left=0.03, right=3.5)
    if rough:
        made["contacts"][2]["friction"] = {"coulomb": 0.3}
    first = 0.03 + WIDER / 2.0
    expected = [first, first - 0.01 + WIDER, 0.0]
    assert moved(made, method) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("subdomains", [1, 4])
@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_slides_freely_stays_in_the_mean(method: str, subdomains: int) -> None:
    """It bulges more on one side; the nodes that hold it differ between decompositions.

    Friction holds the block beside it.
    """
    made = blocks(0.0, 3.0, left=-1.0, right=5.0)
    made["contacts"] = made["contacts"][:2]
    made["contacts"][1]["friction"] = {"coulomb": 0.3}
    made["conditions"][0] = {"on": "a.y+", "total_force": [0.0, -20.0], "total_moment": 0.5}
    made["decomposition"] = {"subdomains": subdomains}
    assert moved(made, method)[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("method", ["auto", "primal"])
def test_rigid_bodies_without_a_drive_neither_turn_nor_rise(method: str) -> None:
    """A cylinder that may turn by 0.68 about x before it meets the block below it."""
    made, subdomains = feature_scene(104050)
    made["solver"]["method"] = method
    solved = solve_scene(scenes.build(made, None if method == "primal" else subdomains))
    assert solved.solution.converged
    (motion,) = solved.summary["rigid_bodies"].values()
    assert motion["rotation"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert solved.solution.measures.displacement < 1e-12


def test_contact_forces_of_rounding_errors_hold_no_body() -> None:
    """By multigrid the second body has a single force, 1e-15 of that on the first one."""
    largest = []
    for method in ("auto", "primal"):
        made, subdomains = feature_scene(104106)
        made["solver"]["method"] = method
        solved = solve_scene(scenes.build(made, None if method == "primal" else subdomains))
        assert solved.solution.converged
        largest.append(solved.solution.measures.displacements)
    assert largest[0] == pytest.approx(largest[1], rel=1e-6)


def test_forces_and_energy_stay_and_no_gap_closes_beyond_zero() -> None:
    made = blocks(0.0, 1.01, left=0.03, right=2.2)
    solved = solve_scene(scenes.build({**made, "decomposition": {"subdomains": 4}}))
    problem, least = solved.model.problem, solved.solution
    slid = [u.copy() for u in least.displacements]
    for u in slid:
        u[0::2] += 0.05
    again = with_least_motion(problem, replace(least, displacements=slid))
    for found, expected in zip(again.displacements, least.displacements, strict=True):
        assert found == pytest.approx(expected, abs=1e-8)
    assert again.multiplier is least.multiplier
    assert again.measures.energy == pytest.approx(least.measures.energy, rel=1e-12)
    assert again.certificate.max_penetration < least.certificate.max_penetration + 1e-9


def test_two_ranks_find_the_same_place(tmp_path: Path) -> None:
    made = blocks(0.0, 1.01, left=0.03, right=2.2)
    made["output"] = {"probes": {"corner": [2.01, 1.0]}}
    one, two = (summary_of(made, tmp_path, ranks)["probes"] for ranks in (1, 2))
    expected = 0.03 + 2.0 * WIDER - 0.01
    for probes in (one, two):
        assert probes["corner"]["displacement"][0] == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("method", ["auto", "primal"])
def test_a_block_stays_where_a_load_has_brought_it(method: str, rough: bool) -> None:
    """Pushed to the right wall in the first step, without the push in the second one.

    Another block, far from the first one, may have friction.
    """
    made = blocks(0.0, left=-0.1, right=1.2)
    if rough:
        made["bodies"].append(scenes.box("b", [5.0, 1.0], [3, 3], [4.0, 0.0]))
        floor = plane([0, 0], [0, 1])
        made["contacts"].append({"on": "b.y-", **floor, "friction": {"coulomb": 0.3}})
        made["conditions"].append({"on": "b.y+", "pressure": 20.0})
    made["conditions"] += [{"on": "a.x-", "traction": [1.0, 0.0], "name": "push"}]
    made["steps"] = [{"push": 1.0}, {"push": 0.0}]
    answers = contact_app.solve({**made, "solver": {"method": method}}).increments
    near = answers[0].points[:, 0] < 1.0 + 1e-9
    pushed, released = (answer.displacement[near, 0] for answer in answers)
    assert pushed.max() == pytest.approx(0.2, abs=1e-7)
    assert released.mean() == pytest.approx(pushed.mean(), abs=1e-3)
    assert released.max() <= 0.2 + 1e-7
