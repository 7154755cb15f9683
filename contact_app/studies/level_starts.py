"""Savings in a run to an accuracy when each level begins with the solution of the last one.

    python -m contact_app.studies.level_starts

Every level is solved twice: from the initial active set of a Winkler foundation (or from columns of
F if bodies are undecomposed and held), and from the last level's tractions.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene

ROOT = Path(__file__).parents[2]


class Case(NamedTuple):
    """A scene by its file and its overrides, with a name for the table."""

    name: str
    path: str
    accuracy: float
    changes: tuple[str, ...]


def _cube(name: str, accuracy: float, *changes: str) -> Case:
    start = "bodies.0.mesh.box.cells=[6,6,6]"
    return Case(f"cube, {name}", "configs/cube.yaml", accuracy, (start, *changes))


FIRST, EIGHT = "bodies.0.degree=1", "decomposition.subdomains=8"
BLOCKS, TETRAHEDRA = "decomposition.subdomains=[2,2,2]", "bodies.0.mesh.box.cell=tetrahedron"
BALL, HERTZ = "configs/sphere.yaml", "contact_app/studies/data/hertz.yaml"
COARSE = "bodies.0.mesh.box.cells=[8,8,4]"
ROLLER, DISC = "configs/roller_on_block.yaml", "configs/hertz_disc.yaml"

CASES = (
    _cube("8 parts", 0.05, EIGHT),
    _cube("hexahedra of degree 1", 0.05, FIRST, BLOCKS),
    _cube("tetrahedra of degree 1", 0.07, FIRST, BLOCKS, TETRAHEDRA),
    Case("ball, 8 parts", BALL, 0.1, (COARSE, EIGHT)),
    Case("ball, hexahedra of degree 1", BALL, 0.15, (COARSE, FIRST, "decomposition.subdomains=4")),
    Case("Hertz, 8 parts", HERTZ, 0.01, (EIGHT,)),
    Case("Hertz, degree 1", HERTZ, 0.02, (FIRST, "decomposition.subdomains=[4,4]")),
    Case("punch, 8 parts", "contact_app/studies/data/flat_punch.yaml", 0.05, (EIGHT,)),
    Case("roller on block, 12 parts", ROLLER, 0.02, ("decomposition.subdomains=12",)),
    Case("roller on block, whole", ROLLER, 0.02, ("decomposition.subdomains=2",)),
    Case("disc on plane, 8 parts", DISC, 0.02, (EIGHT,)),
    Case("disc on plane, whole", DISC, 0.02, ("decomposition.subdomains=1",)),
    Case("bushing", "configs/bushing.yaml", 0.1, ()),
    Case("cantilever", "contact_app/studies/data/cantilever.yaml", 0.05, ()),
)
TOLERANCES = ("auto", "1e-6")


def applications(solved: SolvedScene) -> int:
    """Hessian multiplications of a solve."""
    summary = solved.summary
    if not solved.solution.converged:
        raise RuntimeError(f"{summary['scene']['title']}: {summary['solver']['reason']}")
    return int(summary["solver"]["hessian_multiplications"])


def compared(case: Case, tolerance: str) -> list[tuple[int, int]]:
    """Operator applications of each level, from the initial active set and from the last level."""
    changes = [f"accuracy={case.accuracy}", f"solver.tolerance={tolerance}", *case.changes]
    found: list[tuple[int, int]] = []

    def solve(scene: Scene, *, start: LastLevel | None) -> SolvedScene:
        solved = solve_scene(scene, MPI.COMM_SELF)
        cold = warm = applications(solved)
        if start is not None:
            solved = solve_scene(scene, MPI.COMM_SELF, start=start)
            warm = applications(solved)
        found.append((cold, warm))
        return solved

    missed = solve_to_accuracy(build_scene(load(ROOT / case.path, changes)), solve).missed
    if missed:
        raise RuntimeError(f"{case.name}: {missed}")
    return found


def table() -> Iterator[str]:
    """Rows of a table for a page, and the sums."""
    yield (
        "| scene | accuracy | tolerance | applications by level, anew | from the last level | "
        "sum, anew | from the last level |"
    )
    yield "|---|---|---|---|---|---|---|"
    for tolerance in TOLERANCES:
        sums = [0, 0]
        for case in CASES:
            ways = list(zip(*compared(case, tolerance), strict=True))
            levels = [" ".join(map(str, way)) for way in ways]
            sums = [total + sum(way) for total, way in zip(sums, ways, strict=True)]
            yield (
                f"| {case.name} | {100 * case.accuracy:g} % | {tolerance} | {levels[0]} | "
                f"{levels[1]} | {sum(ways[0])} | {sum(ways[1])} |"
            )
        yield f"| all | | {tolerance} | | | {sums[0]} | {sums[1]} |"


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
