"""Whether claims of accuracy hold: random scenes solved to targets, their errors measured.

``python -m contact_app.studies.claims plane 200`` draws that many random scenes
(`claims_scenes`), solves each to an accuracy of 0.3, 0.15 and 0.08, measures the error of every
answer against a fine mesh (`claims_reference`), prints a row per scene and target, and a summary:
of the runs that claim to have met their target (exit code 0), how many exceed it, and by what.
``spatial 60`` does so in space. ``--first`` is the first seed, ``--targets`` the accuracies,
``--limit`` the seconds after which a run is given up.

Scenes without equilibrium, with contradictory conditions, or with a reference that does not
converge are left out and counted. So are targets below three times the error of the reference.
"""

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.errors import ContactError
from contact_app.machine.time_limit import OutOfTime, time_limit
from contact_app.run.solve import solve_scene
from contact_app.scene import configuration
from contact_app.scene.build import build_scene
from contact_app.scene.scene import Scene
from contact_app.studies.claims_reference import FineSolution, fine_solution
from contact_app.studies.claims_scenes import ClaimScene, claim_scene
from solver import QPError

TARGETS = (0.3, 0.15, 0.08)
LIMIT = {2: 60.0, 3: 240.0}
"""Time limit of a run or a reference in seconds, by dimension."""

SLIGHT, GROSS = 1.05, 1.25
"""Ratios of measured error and target: one claim in twenty may exceed the first, no claim the
second."""


@dataclass(frozen=True)
class Claim:
    """A run to a target."""

    seed: int
    target: float
    claimed: float
    measured: float
    """Relative errors in energy norm: as reported by the run, and as measured."""
    missed: str
    """The run's reason why the target was not met; empty if it claims to have met it."""
    levels: int
    dofs: int
    seconds: float

    @property
    def met(self) -> bool:
        """Whether the run ends with exit code 0."""
        return not self.missed

    @property
    def ratio(self) -> float:
        """Measured error over target."""
        return self.measured / self.target

    def row(self, words: str) -> str:
        """The row of the table."""
        outcome = "met" if self.met else self.missed
        return (
            f"| {self.seed} | {words} | {100 * self.target:g} % | {100 * self.claimed:.2f} % | "
            f"{100 * self.measured:.2f} % | {self.ratio:.2f} | {outcome} | {self.levels} | "
            f"{self.dofs:,} | {self.seconds:.1f} |"
        )


HEADER = (
    "| seed | scene | target | claimed | measured | measured / target | exit | levels | unknowns "
    "| seconds |\n|---|---|---|---|---|---|---|---|---|---|"
)


def scene_of(claim: ClaimScene, target: float | None) -> Scene:
    """The scene as `contact-app run` reads it."""
    made = dict(claim.config)
    if target is not None:
        made["accuracy"] = target
    return build_scene(configuration.Configuration.model_validate(made))


def run_claim(claim: ClaimScene, target: float, reference: FineSolution) -> Claim:
    """Solve to a target and measure."""
    began = time.perf_counter()
    refined = solve_to_accuracy(scene_of(claim, target), partial(solve_scene, comm=MPI.COMM_SELF))
    seconds = time.perf_counter() - began
    last = refined.levels[-1]
    return Claim(
        claim.seed, target, last.error, reference.relative_error(refined.solved), refined.missed,
        len(refined.levels), last.dofs, seconds,
    )  # fmt: skip


def study(
    dimension: int, seeds: range, options: argparse.Namespace, claims: list[Claim]
) -> Iterator[str]:
    """Run the scenes of seeds; yields rows and fills `claims`."""
    limit = options.limit or LIMIT[dimension]
    for seed in seeds:
        claim = claim_scene(seed, dimension)
        try:
            with time_limit(4 * limit):
                reference = fine_solution(claim, scene_of(claim, None))
        except (ContactError, QPError, OutOfTime, RuntimeError) as error:
            yield f"left out: {seed}: {claim.words}: {_message(error)}"
            continue
        for target in options.targets:
            if not reference.judges(target):
                yield f"not judged: {seed}: {claim.words}: {target:g}: the reference is too coarse"
                continue
            try:
                with time_limit(limit):
                    result = run_claim(claim, target, reference)
            except (ContactError, QPError, OutOfTime) as error:
                yield f"no answer: {seed}: {claim.words}: {target:g}: {_message(error)}"
                continue
            claims.append(result)
            yield result.row(claim.words)


def _message(error: Exception) -> str:
    return (str(error) or "the time was up").splitlines()[0][:150]


def summary(claims: list[Claim]) -> Iterator[str]:
    """Summary of the claims and their errors."""
    met = [claim for claim in claims if claim.met]
    yield (
        f"{len({c.seed for c in claims})} scenes, {len(claims)} runs, of which {len(met)} claim to "
        f"have met their target; {sum(c.seconds for c in claims):.0f} s"
    )
    if not met:
        return
    ratios = np.array([claim.ratio for claim in met])
    for bound in (1.0, SLIGHT, GROSS):
        yield (
            f"measured error over {bound:g} times the target: {int((ratios > bound).sum())} of "
            f"{len(met)} ({100 * float((ratios > bound).mean()):.1f} %)"
        )
    worst = met[int(ratios.argmax())]
    yield (
        f"largest: {worst.ratio:.3f} times (seed {worst.seed}, target {worst.target:g}); "
        f"median {float(np.median(ratios)):.2f}"
    )
    reasons = Counter(claim.missed.split(":")[0][:60] for claim in claims if not claim.met)
    yield from (f"not met, {number}: {reason}" for reason, number in reasons.items())


def main() -> None:
    """Print the table and the summary."""
    parser = argparse.ArgumentParser(description="Whether claims of accuracy hold.")
    parser.add_argument("space", choices=("plane", "spatial"))
    parser.add_argument("number", type=int, help="how many scenes")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--targets", type=float, nargs="+", default=list(TARGETS))
    parser.add_argument("--limit", type=float, default=None, help="seconds of a run")
    options = parser.parse_args()
    dimension = 2 if options.space == "plane" else 3
    claims: list[Claim] = []
    print(HEADER)
    seeds = range(options.first, options.first + options.number)
    for line in study(dimension, seeds, options, claims):
        print(line, flush=True)
    print()
    for line in summary(claims):
        print(line)


if __name__ == "__main__":
    main()
