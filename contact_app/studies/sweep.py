"""Is the decomposition chosen for the user a good one? A measured sweep beside it.

``python -m contact_app.studies.sweep CONFIG…`` solves each scene with the decomposition that
`auto` picks and with coarser and finer ones, and prints the seconds of each (the least of several
solves by turns, output left out) and how far `auto` is from the best.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.model import build_model
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Decomposition, Scene
from solver.driver import solve

STEPS = (1 / 4, 1 / 2, 2 / 3, 1.0, 3 / 2, 2.0)
"""Subdomains along an edge tried, over those of `auto`."""

ROUNDS, ENOUGH = 9, 2.0
"""Solves of each decomposition, two at least: until they took so many seconds on average."""


@dataclass(frozen=True)
class Trial:
    """One decomposition: what was asked for, subdomains made, seconds, Hessian multiplications."""

    asked: str
    subdomains: int
    seconds: float
    applications: int
    converged: bool


def sweep(scene: Scene, comm: MPI.Intracomm = MPI.COMM_WORLD) -> list[Trial]:
    """Solve a scene with `auto`, which comes first, and with decompositions around it."""
    auto = _trial(scene, None, comm)
    trials: dict[tuple[int, ...] | None, Trial] = {
        None: auto
    }  # compiled forms and caches are there from now on
    dimension = scene.dimension
    for step in STEPS:
        edge = max(1, round((auto.subdomains * step**dimension) ** (1.0 / dimension)))
        asked = (edge,) * dimension
        if asked in trials:
            continue
        try:
            trials[asked] = _trial(scene, asked, comm)
        except ConfigurationError as error:  # more subdomains than cells
            print(f"  {asked}: {error}", file=sys.stderr)
    for done in range(1, ROUNDS):
        spent = sum(trial.seconds for trial in trials.values()) * done
        if done > 1 and spent > ENOUGH * len(trials):
            break
        for split, trial in trials.items():
            again = _trial(scene, split, comm)
            trials[split] = min(trial, again, key=lambda t: t.seconds)
    return list(trials.values())


def _trial(scene: Scene, asked: tuple[int, ...] | None, comm: MPI.Intracomm) -> Trial:
    scene = replace(scene, decomposition=Decomposition(asked))
    began = time.perf_counter()
    model = build_model(scene, comm)
    solution = solve(model.problem, scene.solver, None)
    seconds = time.perf_counter() - began
    name = "auto" if asked is None else str(asked)
    return Trial(name, model.partition.count, seconds, solution.counts.hessian, solution.converged)


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        name, *overrides = argument.split(";")
        found = sweep(build_scene(load(Path(name), overrides)))
        best = min((t.seconds for t in found if t.converged), default=math.nan)
        print(f"{argument}: auto {found[0].seconds / best:.2f} times the best")
        for t in found:
            print(
                f"  {t.asked:>14} {t.subdomains:6} subdomains {t.seconds:8.3f} s "
                f"{t.applications:6} applications{'' if t.converged else '  not converged'}",
                flush=True,
            )
