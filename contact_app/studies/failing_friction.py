"""Scenes with friction on which methods fail, each named after the failure (`failing_scenes`).

Every scene is solved by `auto` with and without decomposition, by multigrid on the undecomposed
body (`primal`), and by SMALBE-M with MPRGP on discs of friction forces (`smalbe`), which has no
statuses of points. The reference is a run without decomposition at tolerance 1e-10. The tests
compare it with Gauss-Seidel sweeps over contact points, which share no code with this application.
"""

import copy
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.studies.failing_scenes import (
    FLOOR,
    REFUSED,
    Case,
    Config,
    box_body,
    moved,
    plane_contact,
    pulled,
    scene_of,
    square,
)
from contact_app.studies.outcomes import APPLICATION, WHOLE, Outcome, built, shortened

FRICTION_METHODS = {
    APPLICATION: "auto", WHOLE: "auto", "multigrid": "primal", "SMALBE-M": "smalbe",
}  # fmt: skip
"""`solver.method` of each column."""

PRESS, LIMIT = 10.0, 0.4
"""Pressure on a body that friction alone holds, and its coefficient of friction."""


def _floor(coefficient: float) -> Config:
    return {**FLOOR, "friction": {"coulomb": coefficient}}


def held(coefficient: float, n: int = 12, push: float = 30.0) -> Config:
    """A block held at one side, pressed and pushed on a floor."""
    conditions = [moved("block.x-", 0.0, 0.0), pulled("block.y+", push, -60.0)]
    return scene_of([square(n)], conditions, [_floor(coefficient)])


def smooth() -> Config:
    """The scene without friction."""
    made = held(0.0)
    del made["contacts"][0]["friction"]
    return made


def floating(share: float) -> Config:
    """A block held by friction alone, pushed by a share of the load at which it slides."""
    body = box_body("block", [0.0, 0.0], [2.0, 0.25], [32, 4])
    load = pulled("block.y+", share * LIMIT * PRESS, -PRESS)
    return scene_of([body], [load], [_floor(LIMIT)])


def alternating() -> Config:
    """A block whose top is pressed down and moved to and fro, so that all of its foot slips."""
    made = held(0.3, 8)
    made["conditions"] = [
        {"name": "press", "on": "block.y+", "displacement": [None, -0.01]},
        {"name": "push", "on": "block.y+", "displacement": [0.02, None]},
    ]
    made["steps"] = [{"press": 1}, {"push": 1}, {"push": -1}, {"push": 1}, {"push": 0}]
    return made


def two_floors(dimension: int) -> Config:
    """A clamped block pushed into a corner of two rough planes."""
    flat, n, axes = dimension == 2, 12 if dimension == 2 else 4, np.eye(dimension).tolist()
    down, up = ("y-", "y+") if flat else ("z-", "z+")
    load = [30.0, -60.0] if flat else [30.0, 10.0, -60.0]
    floor = plane_contact(f"block.{down}", [0.0] * dimension, axes[-1])
    wall = plane_contact("block.x+", axes[0], [-v for v in axes[0]])
    body = box_body("block", [0.0] * dimension, [1.0] * dimension, [n] * dimension)
    return scene_of(
        [body],
        [moved("block.x-", *[0.0] * dimension), pulled(f"block.{up}", *load)],
        [{**floor, "friction": {"coulomb": 0.3}}, {**wall, "friction": {"coulomb": 0.4}}],
    )


def edge() -> Config:
    """A cube moved down and aside on a floor that is tilted: it touches along one edge."""
    floor = plane_contact("block.z-", [1.0, 0.0, 0.0], [-0.2, 0.0, 1.0])
    return scene_of(
        [box_body("block", [0.0] * 3, [1.0] * 3, [4] * 3)],
        [{"on": "block.z+", "displacement": [0.01, 0.005, -0.02]}],
        [{**floor, "friction": {"coulomb": 0.5}}],
    )


FRICTION_CASES = (
    Case("friction with μ = 0", lambda: held(0.0), mild=smooth),
    Case("friction with μ = 1", lambda: held(1.0, push=90.0), mild=lambda: held(0.3, push=90.0)),
    Case(
        "at 0.999 of the load that slides",
        lambda: floating(0.999),
        (4, 1),
        mild=lambda: floating(0.5),
    ),
    Case("at 1.001 of the load that slides", lambda: floating(1.001), (4, 1), expected=REFUSED),
    Case("held by friction alone", lambda: floating(0.1), (4, 1)),
    Case("slip to and fro", alternating),
    Case("a node in two frictional planes", lambda: two_floors(2)),
    Case("an edge in two frictional planes", lambda: two_floors(3), (2, 2, 2)),
    Case("an edge in contact", edge, (2, 2, 1)),
)


def solve_rough(method: str, made: Config, subdomains: Any) -> Outcome:
    """Verdict of a method on a scene with friction, over all its increments."""
    from contact_app.run.increments import solved_increments
    from contact_app.run.solve import solve_scene

    made = copy.deepcopy(made)
    made["solver"]["method"] = FRICTION_METHODS[method]
    scene = built(made, 1 if method == "multigrid" else subdomains)
    if scene.steps:
        answers = [i.solved for i in solved_increments(scene, MPI.COMM_SELF, lambda place: None)]
    else:
        answers = [solve_scene(scene, MPI.COMM_SELF)]
    summaries = [solved.summary for solved in answers]
    bad = next((s for s in summaries if not s["certificate"]["passed"]), None)
    return Outcome(
        "fails" if bad else "", shortened(bad["solver"]["reason"]) if bad else "",
        sum(s["solver"]["hessian_multiplications"] for s in summaries),
        sum(s["solution"]["energy"] for s in summaries),
        max(s["certificate"]["max_penetration"] for s in summaries),
    )  # fmt: skip
