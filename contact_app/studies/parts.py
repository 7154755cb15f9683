"""Parts from a mesher: multigrid on undecomposed bodies beside Total FETI.

    python -m contact_app.studies.parts [SCENE …] [--meshes DIR] [--degree N] [--tolerance T]

Each run is a process of its own, from the scene to the certified answer. Without scenes the parts
of the tutorials are taken, each in its first load case. ``--meshes`` reads the meshes of the same
names from another directory, where ``meshes/samples/make_parts.py --size`` has drawn finer ones.
"contact known" counts the products with the stiffness of one linear solve: the rows that press in
the answer hold with equality, and the solve begins at zero.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.machine.environment import peak_rss_gb
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.scene.yaml_reader import read
from contact_app.studies.processes import RunError, python
from solver.contact.driver import solve

CONFIGS = Path(__file__).parents[2] / "configs"
PARTS = ("pin_in_lug", "bolted_flange", "ball_in_grooves", "pillow_block", "hub_on_shaft")
METHODS = ("primal", "active-set")
LIMIT = 1800.0


def scene_of(path: Path, overrides: Sequence[str], meshes: Path | None) -> Scene:
    """A scene, in its first load case, with the meshes of another directory."""
    values = list(overrides)
    if meshes is not None:
        bodies = read(path)[0]["bodies"]
        values += [
            f"bodies.{i}.mesh.file={meshes.resolve() / Path(body['mesh']['file']).name}"
            for i, body in enumerate(bodies)
        ]
    scene = build_scene(load(path, values))
    return scene.under(scene.cases[0]) if scene.cases else scene


def run(scene: Scene) -> dict[str, Any]:
    """Solve a scene by its method; what it took."""
    began = time.perf_counter()
    solved = solve_scene(scene, MPI.COMM_WORLD)
    solution, seconds = solved.solution, time.perf_counter() - began
    found = {
        "unknowns": solved.model.dofs,
        "method": solved.summary["solver"]["method"],
        "applications": solution.counts.hessian,
        "certified": bool(solution.certificate.passed),
        "energy": solved.summary["solution"]["energy"],
        "seconds": round(seconds, 2),
        "solve": round(solved.timings.seconds["solve"], 2),
        "memory": round(peak_rss_gb(MPI.COMM_WORLD), 2),
        "known": None,
    }
    if found["method"] == "primal":
        pressing = np.where(solution.multiplier > 0.0, solution.multiplier, 0.0)
        again = solve(solved.model.problem, scene.solver, start=pressing)
        found["known"] = again.counts.hessian
    return found


def table(rows: Sequence[dict[str, Any]]) -> str:
    """In Markdown."""
    lines = [
        "| part | unknowns | method | applications | contact known | seconds | of these solving "
        "| GB | certified |",
        "|---|---:|---|---:|---:|---:|---:|---:|---|",
    ]
    for row in rows:
        if "error" in row:
            lines.append(f"| {row['part']} | | {row['asked']} | {row['error']} | | | | | |")
            continue
        lines.append(
            f"| {row['part']} | {row['unknowns']:,} | {row['method']} | {row['applications']} "
            f"| {row['known'] or ''} | {row['seconds']} | {row['solve']} | {row['memory']} "
            f"| {'yes' if row['certified'] else 'no'} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or with one method run one scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help=f"files; the parts {', '.join(PARTS)} if none")
    parser.add_argument("--meshes", type=Path)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--tolerance", type=float, default=1e-8)
    parser.add_argument("--method", choices=METHODS, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    scenes = given.scenes or [str(CONFIGS / f"{name}.yaml") for name in PARTS]
    if given.method:
        bodies = range(len(read(Path(scenes[0]))[0]["bodies"]))
        overrides = [f"bodies.{i}.degree={given.degree}" for i in bodies]
        overrides += [f"solver.tolerance={given.tolerance}", f"solver.method={given.method}"]
        print(json.dumps(run(scene_of(Path(scenes[0]), overrides, given.meshes))))
        return
    rows = []
    for scene in scenes:
        for method in METHODS:
            options = ["--method", method, "--degree", str(given.degree)]
            options += ["--tolerance", str(given.tolerance)]
            options += ["--meshes", str(given.meshes)] if given.meshes else []
            row: dict[str, Any] = {"part": Path(scene).stem, "asked": method}
            try:
                row |= python("-m", "contact_app.studies.parts", scene, *options, limit=LIMIT)
            except RunError as error:
                row["error"] = str(error)
            rows.append(row)
    print(table(rows))


if __name__ == "__main__":
    main()
