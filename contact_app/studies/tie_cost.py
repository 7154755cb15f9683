"""Cost of a tied pair compared with conforming meshes: whole solves in processor time.

    python -m contact_app.studies.tie_cost [ROW …]

A cantilever of two cubes that comes down on a rigid floor. The cubes have meshes of a³ and b³ cells
and are tied. The conforming cantilevers have 2 n × n × n cells: with n = a and n = b (their mean is
the cost of the same subdomains without a tie), and with n between them that divides evenly. Each
time is the median of three runs by turns, in processes of their own on one core, without imports.
Rows `file` have meshes in files whose subdomains are not congruent (`studies.perturbed`).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.perturbed import write_box
from contact_app.studies.processes import python

ROWS: dict[str, tuple[str, int, str, int, int, int]] = {
    "box": ("hexahedron", 1, "auto", 24, 28, 26),
    "box-large": ("hexahedron", 1, "auto", 40, 48, 44),
    "box-uneven": ("hexahedron", 1, "auto", 23, 29, 26),
    "box-degree-2": ("hexahedron", 2, "auto", 12, 16, 14),
    "box-degree-2-large": ("hexahedron", 2, "auto", 20, 24, 22),
    "multigrid": ("tetrahedron", 1, "primal", 17, 19, 18),
    "multigrid-degree-2": ("tetrahedron", 2, "primal", 9, 11, 10),
    "file": ("tetrahedron", 1, "auto", 17, 19, 18),
    "file-degree-2": ("tetrahedron", 2, "auto", 9, 11, 10),
}
"""Cell, degree, method, cells along an edge of the tied cubes, and of the conforming mesh."""

RUNS = 3


def cantilever(row: str, directory: Path, *edges: int) -> dict[str, Any]:
    """Two tied cubes of so many cells along an edge, or one body for one number.

    Mesh files are written to the directory.
    """
    cell, degree, method, *_ = ROWS[row]
    count, bodies = len(edges), []
    for k, n in enumerate(edges):
        lower, upper = [k, 0, 0], [k + 3 - count, 1, 1]
        mesh: dict[str, Any] = {"box": {"lower": lower, "upper": upper, "cell": cell,
                                        "cells": [n * (3 - count), n, n]}}  # fmt: skip
        if row.startswith("file"):
            mesh = {"file": str(directory / f"b{k}.vtu")}
            write_box(Path(mesh["file"]), lower, upper, n)
        where = {"left": f"x < {k} + 1e-9", "right": f"x > {upper[0]} - 1e-9", "below": "z < 1e-9"}
        bodies.append({"name": f"b{k}", "mesh": mesh, "degree": degree,
                       "boundaries": {name: {"where": text} for name, text in where.items()},
                       "material": {"young": 1000.0, "poisson": 0.3}})  # fmt: skip
    last = f"b{count - 1}"
    floor = {"plane": {"point": [0, 0, -0.05], "normal": [0, 0, 1]}}
    ties = [{"on": "b1.left", "against": "b0.right", "tied": True}]
    return {
        "title": "a tied cantilever", "dimension": 3, "bodies": bodies,
        "conditions": [{"on": "b0.left", "displacement": [0, 0, 0]},
                       {"on": f"{last}.right", "traction": [0, 0, -10]}],
        "contacts": [*ties[: count - 1], {"on": f"{last}.below", "obstacle": floor}],
        "solver": {"tolerance": 1e-8, "method": method},
    }  # fmt: skip


def solved(row: str, edges: Sequence[int], directory: Path) -> dict[str, Any]:
    """The summary of one solve in a process of its own; the scene is written to the directory."""
    directory.mkdir(parents=True, exist_ok=True)
    file = directory / "scene.yaml"
    file.write_text(json.dumps(cantilever(row, directory, *edges)), encoding="utf-8")
    return python("-m", "contact_app.studies.single_run", str(file), threads=1)


def measured(row: str, runs: int = RUNS) -> str:
    """A line of the table."""
    *_, a, b, even = ROWS[row]
    settings = ((a, b), (a,), (b,), (even,))
    with tempfile.TemporaryDirectory() as directory:
        turns = [
            [solved(row, edges, Path(directory) / str(k)) for k, edges in enumerate(settings)]
            for _ in range(runs)
        ]
    assert all(one["certificate"]["passed"] for turn in turns for one in turn)
    seconds = [[one["processor_seconds"] for one in turn] for turn in turns]
    tied, first, second, between = np.median(seconds, axis=0)
    same = 0.5 * (first + second)
    both = turns[0][0], turns[0][3]
    counts = [one["solver"]["hessian_multiplications"] for one in both]
    counts += [one["decomposition"]["congruence_classes"] for one in both]
    return (
        f"| {row} | {a}, {b} | {both[0]['mesh']['dofs']:,} | {' | '.join(map(str, counts))} | "
        f"{tied:.2f} | {same:.2f} | {between:.2f} | {tied / same:.2f} | {tied / between:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("rows", nargs="*", help=f"of {', '.join(ROWS)}; all unless given")
    arguments = parser.parse_args()
    for row in arguments.rows:
        if row not in ROWS:
            parser.error(f"unknown row {row}; known: {', '.join(ROWS)}")
    for row in arguments.rows or ROWS:
        print(measured(row), flush=True)


if __name__ == "__main__":
    main()
