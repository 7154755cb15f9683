"""Cost of a tied pair compared with conforming meshes: whole solves in processor time.

    OMP_NUM_THREADS=1 python -m contact_app.studies.tie_cost [ROW …] [--runs N]

A cantilever of two cubes that comes down on a rigid floor. The cubes have meshes of a³ and b³ cells
and are tied. The conforming cantilevers have 2 n × n × n cells: with n = a and n = b (their mean is
the cost of the same subdomains without a tie), and with n between them that divides evenly. All are
solved in one process, N times by turns after a first solve that does not count. Times are the least
ones: what else the machine does only adds to them. Under ``mpirun`` they are means over the ranks.
Rows `file` have meshes in files whose subdomains are not congruent (`studies.perturbed`).
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.studies.last_case import scene_of
from contact_app.studies.perturbed import write_box

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

RUNS = 5
"""Solves of each scene that count."""


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
            write_box(Path(mesh["file"]), n, lower, upper)
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


def written(row: str, edges: Sequence[int], directory: Path) -> Path:
    """The file of a scene, written to a new directory."""
    directory.mkdir(parents=True)
    file = directory / "scene.yaml"
    file.write_text(json.dumps(cantilever(row, directory, *edges)), encoding="utf-8")
    return file


def solved(file: Path, comm: MPI.Intracomm = MPI.COMM_WORLD) -> tuple[dict[str, Any], float]:
    """The summary of a scene and the processor seconds of a rank, on the average (collective)."""
    began = time.process_time()
    summary = solve_scene(scene_of(file, comm=comm), comm).summary
    seconds = comm.allreduce(time.process_time() - began) / comm.size
    assert summary["certificate"]["passed"]
    return summary, seconds


def measured(row: str, runs: int = RUNS, comm: MPI.Intracomm = MPI.COMM_WORLD) -> str:
    """A line of the table (collective)."""
    *_, a, b, even = ROWS[row]
    settings = ((a, b), (a,), (b,), (even,))
    with tempfile.TemporaryDirectory() as name:
        files = None
        if comm.rank == 0:
            files = [written(row, n, Path(name) / str(k)) for k, n in enumerate(settings)]
        files = comm.bcast(files)
        summaries = [solved(file, comm)[0] for file in files]
        seconds = [[solved(file, comm)[1] for file in files] for _ in range(runs)]
    tied, first, second, between = np.min(seconds, axis=0)
    same, both = 0.5 * (first + second), (summaries[0], summaries[3])
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
    parser.add_argument("--runs", type=int, default=RUNS, help="solves that count")
    arguments = parser.parse_args()
    for row in arguments.rows:
        if row not in ROWS:
            parser.error(f"unknown row {row}; known: {', '.join(ROWS)}")
    for row in arguments.rows or ROWS:
        line = measured(row, arguments.runs)
        if MPI.COMM_WORLD.rank == 0:
            print(line, flush=True)


if __name__ == "__main__":
    main()
