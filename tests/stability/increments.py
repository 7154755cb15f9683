"""Effect of the size of increments: ``python -m tests.stability.increments 60``.

Each random scene of `friction_scenes` is loaded in one, two and twelve increments. Beside the share
of the points with Coulomb friction that close or open under the load stand the changes of friction
forces, over their limits, and of displacements, over the largest, from one increment to two and to
twelve. The constants of `contact_app.run.path_dependence`, `contact_app.run.other_increments` and
`contact_app.run.model_warnings` rest on these numbers.
"""

import argparse
import copy
import logging
import sys

import numpy as np

import contact_app
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.results.friction import closing_points
from tests import scenes
from tests.stability.friction_scenes import friction_scene

TOLERANCE = 1e-7


def loaded_in(made: scenes.Config, increments: int) -> SolvedScene | None:
    """The answer to a scene that is loaded in some increments; None where it is not certified."""
    made = copy.deepcopy(made)
    names = [f"load {number}" for number in range(len(made["conditions"]))]
    for condition, name in zip(made["conditions"], names, strict=True):
        condition["name"] = name
    made["steps"] = [{**dict.fromkeys(names, 1), "increments": increments}]
    made["solver"] = {"tolerance": TOLERANCE}
    answer = contact_app.solve(made)
    last = answer.increments[-1].solved  # type: ignore[union-attr]
    return last if answer.converged else None


def changes(one: SolvedScene, other: SolvedScene) -> tuple[float, float]:
    """Changes of friction forces over their limits, and of displacements over the largest."""
    points, multiplier = one.model.problem.friction, one.solution.multiplier
    assert points is not None
    forces = points.forces(other.solution.multiplier) - points.forces(multiplier)
    limits = points.slip_limits(multiplier).sum()
    moved = np.abs(other.nodes.displacement - one.nodes.displacement).max()
    largest = np.abs(one.nodes.displacement).max()
    return float(points.sizes(forces).sum() / limits) if limits else 0.0, float(moved / largest)


def row(seed: int) -> str:
    """Report on a random scene; empty if it has no certified answer to compare."""
    made, _ = friction_scene(seed)
    try:
        one, two, twelve = (loaded_in(made, count) for count in (1, 2, 12))
    except NoEquilibriumError:
        return ""
    if one is None or two is None or twelve is None:
        return ""
    changed, touching = closing_points(one.model.problem, one.solution, None)
    told = [f"forces {100 * f:5.1f} %, displacements {100 * u:5.2f} %"
            for f, u in (changes(one, two), changes(one, twelve))]  # fmt: skip
    return f"{changed:3d} of {touching:3d} close or open | 2: {told[0]} | 12: {told[1]}"


def main() -> int:
    """Print a row for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenes", type=int, nargs="?", default=60)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    for seed in range(arguments.first, arguments.first + arguments.scenes):
        print(f"{seed:4d}: {row(seed) or 'no answer to compare'}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
