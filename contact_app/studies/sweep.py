"""Is the decomposition chosen for the user a good one? A measured sweep beside it.

``python -m contact_app.studies.sweep CONFIG…`` solves each scene with the decomposition that
`auto` picks and with coarser and finer ones, and prints the seconds of each (the better of two
solves, output left out) and how far `auto` is from the best.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from contact_app.configuration import load
from contact_app.errors import ConfigurationError
from contact_app.model import build_model
from contact_app.scene import Decomposition, Scene, build_scene
from contact_app.solve import solve

STEPS = (1 / 4, 1 / 2, 2 / 3, 1.0, 3 / 2, 2.0)
"""Subdomains along an edge tried, over those of `auto`."""

REPEATS = 2


@dataclass(frozen=True)
class Trial:
    """One decomposition: what was asked for, subdomains made, seconds, Hessian multiplications."""

    asked: str
    subdomains: int
    seconds: float
    products: int
    converged: bool


def sweep(scene: Scene, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Iterator[Trial]:
    """Solve a scene with `auto` first, then with decompositions around it."""
    first = _trial(scene, None, "auto", comm)
    yield first
    seen: set[int] = set()
    for step in STEPS:
        edge = max(1, round((first.subdomains * step**scene.dimension) ** (1.0 / scene.dimension)))
        if edge in seen:
            continue
        seen.add(edge)
        asked = (edge,) * scene.dimension
        try:
            yield _trial(scene, asked, str(asked), comm)
        except ConfigurationError as error:  # more subdomains than cells
            print(f"  {asked}: {error}", file=sys.stderr)


def _trial(
    scene: Scene, asked: None | int | tuple[int, ...], name: str, comm: MPI.Intracomm
) -> Trial:
    scene = replace(scene, decomposition=Decomposition(asked))
    best = math.inf
    for _ in range(REPEATS):
        began = time.perf_counter()
        model = build_model(scene, comm)
        solution = solve(model.problem, scene.solver, None)
        best = min(best, time.perf_counter() - began)
    return Trial(name, model.partition.count, best, solution.counts.hessian, solution.converged)


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        name, *overrides = argument.split(";")
        found = list(sweep(build_scene(load(Path(name), overrides))))
        best = min((t.seconds for t in found if t.converged), default=math.nan)
        print(f"{argument}: auto {found[0].seconds / best:.2f} times the best")
        for t in found:
            print(
                f"  {t.asked:>14} {t.subdomains:6} subdomains {t.seconds:8.3f} s "
                f"{t.products:6} products{'' if t.converged else '  not converged'}",
                flush=True,
            )
