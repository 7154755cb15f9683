"""Scenes with and without an equilibrium, and displacements that meet obstacles."""

import numpy as np
import pytest

from tests import reference, scenes
from tests.comparison import same_displacement, solve


def free_block(cell: str, load: list[float]) -> scenes.Config:
    """A free block on a floor, loaded on its top."""
    made = scenes.sliding(cell, 4)
    made["conditions"] = [{"on": f"block.{scenes.up(cell)}", "traction": load}]
    return made


def expect_no_equilibrium(made: scenes.Config, subdomains: int | list[int]) -> str:
    from contact_app.errors import NoEquilibriumError

    with pytest.raises(NoEquilibriumError) as caught:
        solve(made, subdomains)
    message = str(caught.value)
    assert "block" in message, message
    return message


@pytest.mark.parametrize(("cell", "split"), [("hexahedron", [2, 2, 2]), ("triangle", [2, 2])])
@pytest.mark.parametrize("whole", [True, False], ids=["one", "split"])
def test_pulled_off(cell: str, split: list[int], whole: bool) -> None:
    message = expect_no_equilibrium(
        free_block(cell, scenes.vector(cell, 0, 0, 10)), 1 if whole else split
    )
    assert ("z" if scenes.dimension(cell) == 3 else "y") in message


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("cell", "split"), [("hexahedron", [2, 2, 2]), ("triangle", [2, 2])])
def test_pushed_sideways_on_a_frictionless_floor(cell: str, split: list[int], sign: int) -> None:
    message = expect_no_equilibrium(free_block(cell, scenes.vector(cell, sign, 0, -50)), split)
    assert "x" in message


def test_names_the_body_that_leaves() -> None:
    from contact_app.errors import NoEquilibriumError

    made = scenes.two_bodies("hexahedron", 4)
    made["contacts"] = [c for c in made["contacts"] if c["on"] != "stiff.y-"]
    with pytest.raises(NoEquilibriumError, match="stiff") as caught:
        solve(made, 3)
    assert "soft" not in str(caught.value)
    assert "y" in str(caught.value)


def test_a_scene_that_nothing_loads_is_refused() -> None:
    """Nothing would move: the configuration says so before anything is built."""
    from contact_app.errors import ConfigurationError

    with pytest.raises(ConfigurationError, match="load nothing"):
        scenes.build(free_block("hexahedron", [0.0, 0.0, 0.0]))


@pytest.mark.parametrize("subdomains", [1, [2, 2, 2]], ids=str)
def test_held_nodes_pushed_into_an_obstacle_are_refused(subdomains: int | list[int]) -> None:
    from contact_app.errors import ContactError

    made = scenes.sphere("hexahedron", 2)
    made["contacts"][0]["obstacle"] = scenes.plane("hexahedron", (0, 0, 1.01), (0, 0, -1))
    made["conditions"] = [{"on": "block.z+", "displacement": [0, 0, 0.02]}]
    with pytest.raises(ContactError, match=r"contacts\[0\]"):
        solve(made, subdomains)


def test_grazing_with_a_gap_that_is_not_a_float() -> None:
    """0.1 - 0.3 + 0.2 is not zero: round-off must not make a scene infeasible."""
    made = scenes.sphere("hexahedron", 3)
    made["contacts"][0]["obstacle"] = scenes.plane("hexahedron", (0.3, 0.2, 1.1), (0, 0, -3))
    made["conditions"] = [{"on": "block.z+", "displacement": [0, 0, 0.1]}]
    solution = solve(made, [1, 1, 3])
    assert solution.summary["certificate"]["passed"]
    np.testing.assert_allclose(solution.summary["solution"]["contact_force"], 0, atol=1e-6)


def test_contradicting_displacements_are_refused() -> None:
    from contact_app.errors import ContactError

    made = scenes.wall("hexahedron", 2)
    made["conditions"].append({"on": "block.x-", "displacement": [0.1, None, None]})
    with pytest.raises(ContactError, match=r"conditions\[0\].*conditions\[2\]"):
        solve(made, [2, 2, 2])


def test_agreeing_displacements_on_one_node_are_fine() -> None:
    made = scenes.wall("hexahedron", 4)
    made["conditions"].append({"on": "block.x-", "displacement": [0.0, None, None]})
    known = reference.solve(scenes.build(made))
    solution = solve(made, [2, 2, 2])
    same_displacement(known, solution)


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ([1, 0, 0], "+x"),
        ([0, 0, 1], "a turn about z"),
        ([0, 0.24, 1], "a turn about z off the middle of the body"),
        ([1, 0, 0.05], "+x and 0.05 a turn about z"),
        ([-0.14, 0, 0, 0, 1, 0], "a turn about y off the middle of the body"),
        ([0, 0.1, 0, 0, 1, 0], "0.1 +y and a turn about y"),
        ([0, 0, 0, 1, 1, 0], "a turn about x and a turn about y"),
    ],
)
def test_turns_off_the_middle_are_named(motion: list[float], words: str) -> None:
    from contact_app.model.equilibrium import directions_in_words

    assert directions_in_words(np.array(motion)[:, None]) == words


@pytest.mark.parametrize(
    ("degree", "at", "hint"), [(1, 0.7, None), (1, 1.2, False), (2, 0.7, True), (2, 1.2, False)]
)
def test_a_block_that_tips_in_the_mean_over_its_facets_gets_a_hint(
    degree: int, at: float, hint: bool | None
) -> None:
    """0.2 beside the middle of one facet: the pressure of degree 2 reaches to 0.167 on a pair.

    No hint where the load acts beside the facet: the block tips with contact at nodes, too.
    """
    from contact_app.errors import NoEquilibriumError

    boxes = {name: {"lower": [0, n], "upper": [1, n + 1], "cells": [1, 1]}
             for n, name in enumerate(("base", "block"))}  # fmt: skip
    made = {
        "title": "", "dimension": 2,
        "bodies": [
            {"name": name, "mesh": {"box": box}, "degree": degree,
             "material": {"young": 1000.0, "poisson": 0.3}} for name, box in boxes.items()
        ],
        "conditions": [
            {"on": "base.y-", "displacement": [0, 0]},
            {"on": "block.y+", "total_force": [0, -1], "at": [at, 2]},
        ],
        "contacts": [{"on": "block.y-", "against": "base.y+", "friction": {"coulomb": 0.3}}],
    }  # fmt: skip
    if hint is None:
        assert solve(made, None).summary["certificate"]["passed"]
        return
    with pytest.raises(NoEquilibriumError) as caught:
        solve(made, None)
    assert ("contacts[0]: this motion closes the gap at nodes" in str(caught.value)) == hint
