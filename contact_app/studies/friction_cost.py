"""Cost of friction: operator applications compared with those of the scene without friction.

    python -m contact_app.studies.friction_cost [NAME …] [--methods active-set,primal]

Each scene is solved without and with friction to its own tolerance. The limit is three times the
applications of the frictionless solve with Tresca's law and six times with Coulomb's law, but at
least 60. A scene without equilibrium in the absence of friction has the limit 60. Ten increments of
a load history may take twelve times the applications of a single increment to the same loads.

The rows of a scene begin with the method that `solver.method: auto` takes.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

from contact_app.errors import ContactError
from contact_app.model.method import with_chosen_method
from contact_app.run.increments import solved_increments
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from contact_app.scene.scene import Scene
from contact_app.scene.yaml_reader import read
from solver.qp.result import Step

CONFIGS = Path(__file__).parents[2] / "configs"

METHODS = ("active-set", "primal")

ENOUGH = 60
"""Applications that every scene with friction may take."""

TIMES = {"tresca": 3, "coulomb": 6}
"""Largest applications of a scene with friction, relative to the frictionless scene."""

TEN = 12
"""Largest applications of ten increments, relative to one increment."""


class FrictionScene(NamedTuple):
    """A scene, and the friction of its contacts."""

    scene: dict[str, Any] | str
    """A mapping, or the name of a shipped scene."""
    friction: dict[str, float] | None = None
    """Friction of all contacts; None if the scene has its own."""
    settings: tuple[str, ...] = ()
    """Overrides, as in ``--set``."""


def _box(cells: Sequence[int], upper: Sequence[float], cell: str, **rest: Any) -> dict[str, Any]:
    """A box from the origin on."""
    box = {"lower": [0] * len(cells), "upper": list(upper), "cells": list(cells), "cell": cell}
    return {"mesh": {"box": box | rest}, "material": {"young": 1000, "poisson": 0.3}}


def _on_floor(body: dict[str, Any], conditions: list[dict[str, Any]], axis: str) -> dict[str, Any]:
    """A body on a floor at zero along an axis."""
    size = len(body["mesh"]["box"]["cells"])
    normal = [int(name == axis) for name in "xyz"[:size]]
    plane = {"plane": {"point": [0] * size, "normal": normal}}
    return {
        "dimension": 3 if size == 3 else "plane_strain",
        "bodies": [{"name": "body"} | body],
        "conditions": conditions,
        "contacts": [{"on": f"body.{axis}-", "obstacle": plane}],
    }


def _two_boxes(cell: str) -> dict[str, Any]:
    """A box pressed on a larger one and pushed along it."""
    lower = _box([8, 8, 4], [2, 2, 1], cell)
    upper = _box([7, 7, 5], [1.6, 1.6, 2], cell, lower=[0.4, 0.4, 1])
    return {
        "dimension": 3,
        "bodies": [{"name": "lower"} | lower, {"name": "upper"} | upper],
        "conditions": [
            {"on": "lower.z-", "displacement": [0, 0, 0]},
            {"on": "upper.z+", "displacement": [0.02, 0.01, -0.05]},
        ],
        "contacts": [{"on": "upper.z-", "against": "lower.z+"}],
    }


def _pushed_boxes() -> dict[str, Any]:
    """The two boxes of tetrahedra, pressed and pushed one after the other."""
    made = _two_boxes("tetrahedron")
    moved = {"press": [None, None, -0.05], "push": [0.02, 0.01, None]}
    driven = [{"name": n, "on": "upper.z+", "displacement": u} for n, u in moved.items()]
    return {**made, "conditions": [made["conditions"][0], *driven]}


def _strips() -> dict[str, Any]:
    """A strip that is pressed on another one and stretched along it."""
    lower = _box([80, 4], [20, 1], "quadrilateral")
    upper = _box([60, 3], [18, 2], "quadrilateral", lower=[2, 1])
    return {
        "dimension": "plane_strain",
        "bodies": [{"name": "lower"} | lower, {"name": "upper"} | upper],
        "conditions": [
            {"on": "lower.y-", "displacement": [0, 0]},
            {"on": "upper.y+", "traction": [0, -4]},
            {"on": "upper.x-", "displacement": [0, None]},
            {"on": "upper.x+", "traction": [10, 0]},
        ],
        "contacts": [{"on": "upper.y-", "against": "lower.y+"}],
    }


SHEET = _on_floor(
    _box([30, 30, 2], [30, 30, 1], "hexahedron"),
    [
        {"on": "body.z+", "traction": [0, 0, -2]},
        {"on": "body.x-", "displacement": [0, 0, None]},
        {"on": "body.x+", "traction": [10, 4, 0]},
    ],
    "z",
)

BAR = _on_floor(
    _box([60, 3, 3], [30, 1.5, 1.5], "tetrahedron"),
    [
        {"on": "body.z+", "traction": [0, 0, -2]},
        {"on": "body.x-", "displacement": [0, 0, None]},
        {"on": "body.x+", "traction": [4, 1, 0]},
    ],
    "z",
)

HISTORY_CUBE = {
    "dimension": 3,
    "bodies": [{"name": "cube"} | _box([10, 10, 10], [1, 1, 1], "hexahedron")],
    "conditions": [
        {"on": "cube.z-", "displacement": [0, 0, 0]},
        {"name": "press", "on": "cube.z+", "traction": [0, 0, -5]},
        {"name": "push", "on": "cube.z+", "traction": [0, 1, 0]},
    ],
    "contacts": [
        {"on": "cube.x+", "obstacle": {"plane": {"point": [1, 0, 0], "normal": [-1, 0, 0]}}}
    ],
}

SCENES = {
    "cube_coulomb_0.1": FrictionScene("cube", {"coulomb": 0.1}),
    "cube_coulomb_0.3": FrictionScene("cube", {"coulomb": 0.3}),
    "cube_coulomb_1": FrictionScene("cube", {"coulomb": 1.0}),
    "cube_tresca_1": FrictionScene("cube", {"tresca": 1.0}),
    "cube_tresca_30": FrictionScene("cube", {"tresca": 30.0}),
    "bracket_tresca": FrictionScene("bracket", {"tresca": 3.0e3}),
    "bracket_coulomb_0.3": FrictionScene("bracket", {"coulomb": 0.3}),
    "sheet_tresca": FrictionScene(SHEET, {"tresca": 0.5}),
    "sheet_coulomb_0.3": FrictionScene(SHEET, {"coulomb": 0.3}),
    "strips_coulomb_0.3": FrictionScene(_strips(), {"coulomb": 0.3}),
    "strips_tresca": FrictionScene(_strips(), {"tresca": 1.0}),
    "rough_rod": FrictionScene("rough_rod"),
    "bar_coulomb_0.3": FrictionScene(BAR, {"coulomb": 0.3}),
    "bar_tresca": FrictionScene(BAR, {"tresca": 0.3}),
    "friction_block": FrictionScene("friction_block"),
    "friction_block_coulomb_1": FrictionScene("friction_block", {"coulomb": 1.0}),
    "boxes_hexahedra": FrictionScene(_two_boxes("hexahedron"), {"coulomb": 0.3}),
    "boxes_tetrahedra": FrictionScene(_two_boxes("tetrahedron"), {"coulomb": 0.3}),
    "boxes_tresca": FrictionScene(_two_boxes("hexahedron"), {"tresca": 5.0}),
    "pin_in_lug": FrictionScene("pin_in_lug", {"coulomb": 0.1}),
    "pillow_block": FrictionScene("pillow_block", {"coulomb": 0.3}),
    "bracket_tresca_300": FrictionScene("bracket", {"tresca": 300.0}),
    "pillow_block_tresca": FrictionScene("pillow_block", {"tresca": 3.0}),
    "pin_in_lug_tresca": FrictionScene("pin_in_lug", {"tresca": 20.0}),
    "hub_on_shaft_tresca": FrictionScene("hub_on_shaft", {"tresca": 5.0}),
    "bolted_flange_tresca": FrictionScene("bolted_flange", {"tresca": 3.0}),
    "ball_in_grooves_tresca": FrictionScene("ball_in_grooves", {"tresca": 10.0}),
}
"""Solved in one step."""

HISTORIES = {
    "press_and_push": FrictionScene(
        "press_and_push", settings=("steps=[{press: 1}, {push: 1, increments: N}]",)
    ),
    "cube_pushed": FrictionScene(
        HISTORY_CUBE, {"coulomb": 0.3}, ("steps=[{press: 1, push: 1, increments: N}]",)
    ),
    "cube_turned": FrictionScene(
        HISTORY_CUBE, {"coulomb": 0.3}, ("steps=[{press: 1}, {push: 1, increments: N}]",)
    ),
    "boxes_pushed": FrictionScene(
        _pushed_boxes(), {"coulomb": 0.3}, ("steps=[{press: 1}, {push: 1, increments: N}]",)
    ),
}
"""Solved in N = 10 increments and in one."""


@dataclass(frozen=True)
class Work:
    """Work of a solve."""

    applications: int | None = None
    """Applications of the operator; None without equilibrium."""
    passed: bool = True
    """Whether all solutions are certified."""
    sets: int = 0
    """Number of active sets."""


def scene_of(rubbed: FrictionScene, method: str, rough: bool = True, increments: int = 1) -> Scene:
    """The scene, with friction or without.

    Parameters
    ----------
    increments
        The number N of increments in the settings.
    """
    made: dict[str, Any]
    if isinstance(rubbed.scene, str):
        made = read(CONFIGS / f"{rubbed.scene}.yaml")[0]
        for body in made["bodies"]:
            if "file" in body.get("mesh", {}):
                body["mesh"]["file"] = str((CONFIGS / body["mesh"]["file"]).resolve())
    else:
        made = {"title": "friction", **rubbed.scene}
    made["contacts"] = [
        {**{k: v for k, v in c.items() if k != "friction"},
         **({"friction": rubbed.friction or c["friction"]} if rough else {})}
        for c in made["contacts"]
    ]  # fmt: skip
    made.pop("cases", None)
    settings = [s.replace("N", str(increments)) for s in rubbed.settings]
    return build_scene(from_mapping(made, [f"solver.method={method}", *settings]))


def counted(scene: Scene) -> Work:
    """Solve a scene, or all its increments."""
    sets: set[tuple[int, int | None]] = set()

    def solved_in(increment: int) -> Callable[[Step], None]:
        return lambda step: sets.add((increment, step.outer or step.active_set))

    try:
        if scene.steps:
            increments = solved_increments(
                scene, MPI.COMM_SELF, lambda place: solved_in(place.number)
            )
            summaries = [made.solved.summary for made in increments]
        else:
            summaries = [solve_scene(scene, MPI.COMM_SELF, solved_in(0)).summary]
    except ContactError:
        return Work(sets=len(sets))
    return Work(
        sum(s["solver"]["hessian_multiplications"] for s in summaries),
        all(s["certificate"]["passed"] for s in summaries), len(sets),
    )  # fmt: skip


def row(name: str, method: str) -> str:
    """The row of one scene in the table."""
    if name in HISTORIES:
        one, ten = (counted(scene_of(HISTORIES[name], method, increments=n)) for n in (1, 10))
        most: float = TEN * (one.applications or 0)
    else:
        rubbed = SCENES[name]
        one, ten = (counted(scene_of(rubbed, method, rough)) for rough in (False, True))
        most = max(ENOUGH, TIMES[law_of(rubbed)] * (one.applications or 0))
    return _cells(name, method, one, ten, most)


def law_of(rubbed: FrictionScene) -> str:
    """The key of the friction of a scene."""
    law = rubbed.friction
    if law is None:
        assert isinstance(rubbed.scene, str)
        law = read(CONFIGS / f"{rubbed.scene}.yaml")[0]["contacts"][0]["friction"]
    return next(iter(law))


def _cells(name: str, method: str, before: Work, after: Work, most: float) -> str:
    applications, without = after.applications, before.applications
    told_method = f"{method} (auto)" if method == method_of_auto(name) else method
    cells = [name, told_method, "none" if without is None else f"{without}"]
    passed = "" if after.passed else ", not certified"
    shown = "no answer" if applications is None else f"{applications}{passed}"
    over = "" if applications is None or applications <= most else " (above)"
    ratio = f"{applications / without:.1f}" if applications is not None and without else ""
    return "| " + " | ".join([*cells, shown, f"{most:.0f}{over}", ratio, f"{after.sets}"]) + " |"


def table(names: Sequence[str], methods: Sequence[str]) -> Iterator[str]:
    """Rows of a table for a page."""
    yield "| scene | method | frictionless / one | friction / ten | limit | ratio | active sets |"
    yield "|---|---|---:|---:|---:|---:|---:|"
    for name in names:
        for method in sorted(methods, key=lambda m: m != method_of_auto(name)):
            yield row(name, method)


def method_of_auto(name: str) -> str:
    """The method that `auto` chooses."""
    method = with_chosen_method(scene_of((SCENES | HISTORIES)[name], "auto")).solver.method
    return "active-set" if method == "auto" else method


def main() -> None:
    """The command."""
    names = [*SCENES, *HISTORIES]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(names)}; all unless given")
    parser.add_argument("--methods", default=",".join(METHODS))
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(names))
    if unknown:
        parser.error(f"unknown scene {unknown[0]}; known: {', '.join(names)}")
    for line in table(arguments.names or names, arguments.methods.split(",")):
        print(line, flush=True)


if __name__ == "__main__":
    main()
