"""Random load histories with friction: ``python -m tests.stability.fuzz_histories 50``.

The scenes of `fuzz_friction` in two to five steps: what presses, what pushes and in space what
pushes aside go up, back and to the other side in turn. Every increment is held against the
Gauss-Seidel reference, which measures slips from the end of the last increment of the answer: each
increment is judged alone, and differences do not add up. Verdicts are those of `fuzz_friction`, of
the increment that is worst.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from contact_app.run.increments import SolvedIncrement, solved_increments
from contact_app.scene.scene import Scene
from tests import scenes
from tests.friction_reference import condense
from tests.stability import fuzz_friction, verdicts
from tests.stability.friction_scenes import at_factors, history_scene
from tests.stability.fuzz_friction import judged
from tests.stability.verdicts import GOOD


def solve_history(scene: Scene) -> list[SolvedIncrement]:
    """All increments of a scene."""
    return list(solved_increments(scene, MPI.COMM_WORLD, lambda place: None))


def _worst(
    made: scenes.Config, _scene: Scene, found: list[SolvedIncrement]
) -> tuple[str, str, int]:
    """The verdict on the increment that agrees least, and the operator applications of all."""
    before: np.ndarray | None = None
    ended: list[tuple[str, str]] = []
    for increment in found:
        whole = condense(scenes.build(at_factors(made, increment.factors), 1))
        tangential = np.zeros(len(whole.q), bool)
        tangential[whole.rows[:, 1:]] = True
        slip_before = np.zeros(len(whole.q)) if before is None else np.where(tangential, before, 0)
        kind, told, u = judged(replace(whole, q=whole.q - slip_before), increment.solved)
        before = whole.C @ u.ravel()
        ended.append((kind, f"increment {increment.place.number} of {len(found)}: {told}"))
    products = sum(f.solved.summary["solver"]["hessian_multiplications"] for f in found)
    worst = max(ended, key=lambda end: GOOD.index(end[0]) if end[0] in GOOD else len(GOOD))
    return *worst, products


judge = partial(
    fuzz_friction.judge, solve=solve_history, patience=240.0, draw=history_scene, compare=_worst
)
"""Solve a random load history and hold its increments against the reference (collective)."""


if __name__ == "__main__":
    sys.exit(verdicts.main(__doc__, judge, method="auto", variant=0))
