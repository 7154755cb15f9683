"""Two scenes with friction, for this application and as bare arrays for other programs.

* roller: NAFEMS R0094 with friction (`configs/roller_on_block.yaml`, μ = 0.1), one half, pressed in
  increments. Meshes are those of `contact-app verify roller_with_friction`, round edges with
  degree 2.
* block: an elastic block on a rough rigid floor, z ≥ 0, one half of it, y ≥ 0. Its top is pressed
  down and then pushed along x. Hexahedra.

``python -m contact_app.studies.rough_scenes NAME LEVEL DEGREE FILE.npz`` solves one on a mesh,
saves an `Outcome` and prints the last ``summary.json`` in one line.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.run.increments import solved_increments
from contact_app.scene.bodies import Body
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from contact_app.scene.scene import Scene
from contact_app.scene.yaml_reader import read
from contact_app.studies.rough_models import Fixed, Outcome, PlainBody, PlainScene
from contact_app.studies.verification import ROOT, ROUND, coarse_mesh
from meshes import CellMesh

INCREMENTS = {"roller": 4, "block": 4}
"""Increments of pressing the roller, and of pushing the block."""

PRESSURE = 350.0
"""Pressure on the equator of the roller."""

YOUNG, POISSON, COEFFICIENT = 1000.0, 0.3, 0.3
PRESS, PUSH = -0.01, 0.006
"""Displacements of the top of the block."""


@dataclass(frozen=True)
class Rough:
    """A scene on a series of meshes."""

    name: str
    levels: tuple[float, ...]
    """Size of a cell, or cells along an edge of length one; the coarsest first."""
    finest: tuple[float, int]
    """The level and degree of the reference."""


ROUGH = {
    "roller": Rough("roller", (4.0, 2.0, 1.0, 0.5), (0.25, 2)),
    "block": Rough("block", (4, 8, 16), (16, 2)),
}


def scene_of(name: str, level: float, degree: int) -> Scene:
    """One of the scenes on one of its meshes."""
    return _roller(level, degree) if name == "roller" else _block(round(level), degree)


def _roller(size: float, degree: int) -> Scene:
    from contact_app.studies.refine_on_sphere import refined_round

    file, times = coarse_mesh("roller_on_block", size)
    made: dict[str, Any] = read(ROOT / "configs" / "roller_on_block.yaml")[0]
    for body in made["bodies"]:
        body["mesh"]["file"], body["degree"] = str(file), degree
    made["contacts"][0]["friction"] = {"coulomb": 0.1}
    made["conditions"][3]["name"] = "press"
    made["steps"] = [{"press": 1, "increments": INCREMENTS["roller"]}]
    scene = build_scene(Configuration.model_validate(made))
    bodies = []
    for body, sides in zip(scene.bodies, ROUND["roller_on_block"], strict=True):
        assert isinstance(body.mesh, CellMesh)
        bodies.append(replace(body, mesh=refined_round(body.mesh, times, sides, degree == 2)))
    return replace(scene, bodies=tuple(bodies))


def _block(cells: int, degree: int) -> Scene:
    box = {"lower": [0, 0, 0], "upper": [2, 0.5, 1], "cells": [2 * cells, cells // 2, cells]}
    top = {"on": "block.z+"}
    made = {
        "title": "a block pressed and pushed on a rough floor",
        "dimension": 3,
        "bodies": [
            {
                "name": "block", "mesh": {"box": box}, "degree": degree,
                "material": {"young": YOUNG, "poisson": POISSON},
            }
        ],
        "conditions": [
            {"on": "block.y-", "displacement": [None, 0, None]},
            {"name": "press", **top, "displacement": [None, None, PRESS]},
            {"name": "push", **top, "displacement": [PUSH, None, None]},
        ],
        "contacts": [
            {
                "on": "block.z-", "obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}},
                "friction": {"coulomb": COEFFICIENT},
            }
        ],
        "steps": [{"press": 1}, {"push": 1, "increments": INCREMENTS["block"]}],
    }  # fmt: skip
    return build_scene(Configuration.model_validate(made))


def plain_body(body: Body, degree: int) -> PlainBody:
    """A body as plain arrays."""
    mesh, (material,) = body.mesh, body.materials
    if not isinstance(mesh, CellMesh):
        mesh = mesh.shape(1).cell_mesh()
    shape = mesh.shape(degree)
    facets = {key: shape.topology.facets[rows] for key, rows in shape.sides.items()}
    return PlainBody(
        shape.cell, degree, shape.points, shape.cells, facets, material.young, material.poisson
    )


def plain(name: str, level: float, degree: int) -> PlainScene:
    """The scene as plain arrays."""
    count = INCREMENTS[name]
    bodies = [plain_body(body, degree) for body in scene_of(name, level, degree).bodies]
    if name == "roller":
        return PlainScene(
            bodies, 0.1, (0, "face"), (1, "face"),
            [Fixed(1, "foot", 1, 0.0, ""), Fixed(1, "axis", 0, 0.0, ""),
             Fixed(0, "axis", 0, 0.0, "")],
            (0, "top", PRESSURE), [{"press": (k + 1) / count} for k in range(count)],
        )  # fmt: skip
    factors = [{"press": 1.0, "push": k / count} for k in range(count + 1)]
    fixed = [Fixed(0, "y-", 1, 0.0, ""), Fixed(0, "z+", 2, PRESS, "press"),
             Fixed(0, "z+", 0, PUSH, "push")]  # fmt: skip
    return PlainScene(bodies, COEFFICIENT, (0, "z-"), None, fixed, None, factors)


def solve(name: str, level: float, degree: int) -> tuple[Outcome, dict[str, Any]]:
    """The answer of this application at the end of its increments, and its summary."""
    scene = scene_of(name, level, degree)
    *_, last = solved_increments(scene, MPI.COMM_SELF, lambda place: None)
    solved, nodes = last.solved, last.solved.nodes
    ends = [*solved.model.partition.first_node[: len(scene.bodies)], len(nodes.points)]
    parts = [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    d = scene.dimension
    at = np.flatnonzero(~np.isnan(nodes.gap))
    at = at[at < ends[1]]
    outcome = Outcome(
        [nodes.points[p, :d] for p in parts],
        [nodes.displacement[p] for p in parts],
        nodes.points[at, :d],
        nodes.friction_traction[at],
        np.asarray(solved.summary["contacts"][0]["force"][:d]),
    )
    return outcome, solved.summary


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve and save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", choices=ROUGH)
    parser.add_argument("level", type=float)
    parser.add_argument("degree", type=int)
    parser.add_argument("file", type=Path)
    options = parser.parse_args(arguments)
    outcome, summary = solve(options.name, options.level, options.degree)
    outcome.save(options.file)
    print(json.dumps(summary), flush=True)


if __name__ == "__main__":
    main()
