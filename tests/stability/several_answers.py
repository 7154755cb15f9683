"""How often Coulomb's law has several answers: ``python -m tests.stability.several_answers 40``.

In each random scene of `friction_scenes` with Coulomb friction all coefficients become the same,
and the Gauss-Seidel reference goes to its answer from four starts. Their displacements are
compared. The constant of `contact_app.run.model_warnings` rests on these counts.
"""

import argparse
import sys

import numpy as np

from contact_app.errors import ContactError
from contact_app.machine.time_limit import OutOfTime, time_limit
from tests import scenes
from tests.friction_reference import Condensed, condense, sweep
from tests.reference import ReferenceError
from tests.stability.friction_scenes import friction_scene

APART = 1e-5
"""Difference of displacements, over the largest, from which on answers are two."""

PATIENCE = 6.0
"""Seconds of processor time for a scene."""


def spread(seed: int, coefficient: float) -> float | None:
    """How far answers of a scene are apart; None without Coulomb friction or without answers."""
    made, subdomains = friction_scene(seed)
    laws = [contact["friction"] for contact in made["contacts"] if "coulomb" in contact["friction"]]
    for law in laws:
        law["coulomb"] = coefficient
    try:
        with time_limit(PATIENCE):
            return apart(condense(scenes.build(made, subdomains)), seed) if laws else None
    except (ContactError, OutOfTime, ReferenceError):
        return None


def apart(condensed: Condensed, seed: int) -> float:
    """Largest difference of displacements that sweeps from four starts end with, relative."""
    size, scale = len(condensed.q), condensed.scale
    starts = (
        (np.zeros(size), False),
        (np.full(size, scale), True),
        (np.full(size, -scale), True),
        (scale * np.random.default_rng(seed).normal(size=size), False),
    )
    found = [condensed.answer(sweep(condensed, start, back)).u for start, back in starts]
    largest = np.abs(found[0]).max()
    return float(max(np.abs(u - found[0]).max() for u in found[1:]) / largest)


def main() -> int:
    """Print a row for each coefficient."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenes", type=int, nargs="?", default=40)
    parser.add_argument("--coefficients", type=float, nargs="+", default=[0.5, 1.0, 1.5, 3.0])
    arguments = parser.parse_args()
    for coefficient in arguments.coefficients:
        found = [spread(seed, coefficient) for seed in range(arguments.scenes)]
        known = [value for value in found if value is not None]
        several = sum(value > APART for value in known)
        print(f"{coefficient:g}: {several} of {len(known)} have several answers", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
