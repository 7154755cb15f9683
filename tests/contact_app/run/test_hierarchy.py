"""Levels of contact rows: nested, only for slender bodies, and worth their active sets."""

import json

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.run.solve import solve_scene
from solver.problem.constraint_hierarchy import constraint_hierarchy
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.ranks import execute
from tests.scenes import Config, slender

LEVELS = """
import json
import sys

from mpi4py import MPI

from contact_app.model.model import build_model
from solver.problem.constraint_hierarchy import constraint_hierarchy
from tests import scenes

comm, counts = MPI.COMM_WORLD, []
problem = build_model(scenes.build(json.loads(sys.argv[1]), [6, 1, 1]), comm).problem
levels = constraint_hierarchy(problem, coarsened=True)
while not levels.finest:
    counts.append(comm.allreduce(int(levels.allowed.sum())))
    levels = levels.finer()
if comm.rank == 0:
    print(counts)
"""


def problem(made: Config, parts: list[int]) -> DualProblem:
    return scenes.problem(made, parts, comm=MPI.COMM_WORLD)


def test_levels_of_a_slender_body_are_nested_and_even() -> None:
    """Each level contains the rows of the one before and about as many more, evenly distributed."""
    dual = problem(slender(100.0, [200, 2]), [10, 1])
    levels = constraint_hierarchy(dual, coarsened=True)
    x = dual.contact.points[:, 0]
    before = np.zeros(dual.size, bool)
    counts = []
    while not levels.finest:
        assert not (before & ~levels.allowed).any()
        chosen = np.sort(x[levels.allowed[dual.inequality]])
        counts.append(len(chosen))
        assert np.diff(chosen).max() < 2.5 / len(chosen)
        before = levels.allowed
        levels = levels.finer()
    assert counts[0] <= 16
    assert len(counts) >= 4
    assert all(a < b <= 2.5 * a for a, b in zip(counts, counts[1:], strict=False))
    assert levels.allowed is dual.inequality


def plate(degree: int) -> Config:
    """A strip of tetrahedra 60 times as long as thick on a floor."""
    size, cell = [60, 4, 1], "tetrahedron"
    return {
        "dimension": 3,
        "bodies": [scenes.box("strip", size, size, cell=cell, young=1e5, degree=degree)],
        "conditions": [
            {"on": "strip.x-", "displacement": [0, 0, 0.1]},
            {"in": "strip", "force": [0, 0, -1e-3]},
        ],
        "contacts": [
            {"on": "strip.z-", "obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}
        ],
    }  # fmt: skip


@pytest.mark.parametrize("degree", [1, 2])
def test_thickness_counts_in_distances_between_rows(degree: int) -> None:
    """Cells of degree 2 have rows at their vertices alone, a quarter of the nodes that touch."""
    dual = problem(plate(degree), [1, 1, 1])
    assert int(dual.inequality.sum()) in (60 * 5, 61 * 5)
    levels = constraint_hierarchy(dual, coarsened=True)
    assert not levels.finest
    assert levels.allowed.sum() <= 16


@pytest.mark.parametrize("made", [scenes.wall("quadrilateral", 16), slender(5.0, [45, 9])])
def test_thick_bodies_have_none(made: Config) -> None:
    assert constraint_hierarchy(problem(made, [2, 1]), coarsened=True).finest


@pytest.mark.ratchet
def test_a_slender_body_costs_at_most_four_times_its_thick_twin() -> None:
    """Without levels it takes 5 times as many applications."""
    products = []
    for made in (slender(100.0, [200, 2]), slender(5.0, [45, 9])):
        summary = solve_scene(scenes.build(made, [10, 1])).summary
        assert summary["certificate"]["passed"]
        products.append(summary["solver"]["hessian_multiplications"])
    assert products[0] < 4 * products[1]


def pressed_box(box: Config, conditions: list[Config], contact: Config) -> Config:
    """A body with one contact."""
    body = {"name": "body", "mesh": {"box": box}, "material": {"young": 1000.0, "poisson": 0.3}}
    made = scenes.config("quadrilateral", [body], conditions, [contact])
    return {**made, "solver": {"tolerance": 1e-8}}


def strip_over(obstacle: Config, conditions: list[Config]) -> Config:
    """A strip in the plane, 50 times as long as thick."""
    box = {"lower": [0.0, 0.0], "upper": [50.0, 1.0], "cells": [128, 2], "cell": "quadrilateral"}
    return pressed_box(box, conditions, {"on": "body.y-", "obstacle": obstacle})


FLOOR = {"plane": {"point": [0.0, 0.0], "normal": [0.0, 1.0]}}
CYLINDER = {"sphere": {"center": [25.0, -50.001], "radius": 50.0}}
CLAMPED = {"on": "body.x-", "displacement": [0.0, 0.0]}
PRESSED = {"on": "body.y+", "pressure": 0.01}


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("obstacle", "held", "most"),
    [
        pytest.param(FLOOR, CLAMPED, 20, id="all contact stays: 27 on levels"),
        pytest.param(
            FLOOR,
            {"on": "body.x-", "displacement": [0.0, 0.5]},
            65,
            id="peels off: 129 on one level",
        ),
        pytest.param(CYLINDER, CLAMPED, 70, id="sets of a coarse level return: 184 on levels"),
    ],
)
def test_levels_are_for_contact_that_peels_off(obstacle: Config, held: Config, most: int) -> None:
    summary = solve_scene(scenes.build(strip_over(obstacle, [held, PRESSED]), [16, 1])).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= most


@pytest.mark.mpi
def test_two_ranks_have_the_levels_of_one() -> None:
    """Rows of a rank touch columns of the other, which count where they are."""
    asked = json.dumps(plate(2))
    one, two = (execute(LEVELS, asked, ranks=ranks).strip() for ranks in (1, 2))
    assert one == two
    assert len(json.loads(one)) >= 3


@pytest.mark.ratchet
def test_friction_has_no_levels() -> None:
    """On levels the statuses of a pulled strip did not settle, and no answer was certified."""
    floor = {"on": "body.y-", "obstacle": FLOOR, "friction": {"coulomb": 0.3}}
    box = {"lower": [0.0, 0.0], "upper": [100.0, 1.0], "cells": [200, 2], "cell": "quadrilateral"}
    conditions = [
        {"on": "body.y+", "traction": [0.1, -2.0]},
        {"on": "body.x-", "displacement": [0.0, 0.0]},
        {"on": "body.x+", "traction": [5.0, 0.1]},
    ]
    made = pressed_box(box, conditions, floor)
    made["solver"] = {"method": "active-set"}
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 120


STRIP = {"lower": [0.0, 0.0], "upper": [20.0, 1.0], "cells": [60, 2], "cell": "quadrilateral"}
PULLED = [
    {"in": "body", "force": [0.0, -0.03]},
    {"on": "body.x-", "displacement": [0.0, 0.0]},
    {"on": "body.x+", "traction": [5.0, 0.5]},
]
PLATE = {"lower": [0.0] * 3, "upper": [200.0, 80.0, 4.0], "cells": [43, 17, 2]}
LIFTED = [
    {"in": "body", "force": [0.0, 0.0, -2e-3]},
    {"on": "body.x-", "displacement": [0.0, 0.0, None]},
    {"on": "body.x+", "displacement": [None, None, 0.5]},
]


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("box", "conditions", "most"),
    [
        pytest.param(STRIP, PULLED, 60, id="one row a set: 182 without a new beginning"),
        pytest.param(PLATE, LIFTED, 120, id="many rows a set: 1,421 without"),
    ],
)
def test_contact_with_friction_that_peels_off_begins_anew_without(
    box: Config, conditions: list[Config], most: int
) -> None:
    """The contact without friction has levels; with its rows few sets with friction remain."""
    d = len(box["lower"])
    floor = {"plane": {"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}}
    face = "body.y-" if d == 2 else "body.z-"
    contact = {"on": face, "obstacle": floor, "friction": {"coulomb": 0.3}}
    made = pressed_box(box, conditions, contact)
    made |= {"dimension": d, "solver": {"method": "primal", "tolerance": 1e-8}}
    made["bodies"][0]["material"]["young"] = 2.1e5
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] <= most
