"""How random scenes end, and the command that judges many of them."""

import argparse
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from contact_app.errors import ContactError
from contact_app.machine.time_limit import OutOfTime, time_limit
from tests import scenes

GOOD = (
    "agrees", "second", "undecided", "degraded", "contradicts", "escapes", "slides", "refused",
)  # fmt: skip
"""Verdicts that are no faults; of two increments of a history the later verdict here counts."""

QUIET = ("agrees", "contradicts", "escapes")
"""Verdicts that the command prints only in its counts."""


@dataclass(frozen=True)
class Verdict:
    """How one scene ended: one of :data:`GOOD`, or a fault; with details and seconds.

    Applications of the operator, and the method that answered, where one did.
    """

    seed: int
    kind: str
    detail: str
    seconds: float
    applications: int = 0
    method: str = ""

    @property
    def fault(self) -> bool:
        return self.kind not in GOOD


@dataclass(frozen=True)
class Attempt:
    """A scene and what a solve made of it: an answer, an error of the program, or a fault."""

    seconds: float
    scene: Any = None
    solved: Any = None
    error: ContactError | None = None
    fault: tuple[str, str] | None = None


def attempt(
    made: scenes.Config, subdomains: Any, solve: Callable[[Any], Any], patience: float
) -> Attempt:
    """Build and solve a scene within some seconds of processor time."""
    scene = solved = error = fault = None
    began = time.process_time()
    try:
        with time_limit(patience):
            scene = scenes.build(made, subdomains)
            solved = solve(scene)
    except ContactError as raised:
        error = raised
    except OutOfTime:
        fault = "hangs", f"{subdomains}"
    except Exception as raised:
        fault = "crashes", f"{raised!r} at {traceback.extract_tb(raised.__traceback__)[-1]}"
    return Attempt(time.process_time() - began, scene, solved, error, fault)


def summary(verdicts: Sequence[Verdict]) -> str:
    """Counts of verdicts, a table in Markdown, and the hardest scenes."""
    slowest = max(verdicts, key=lambda v: v.seconds)
    hardest = max(verdicts, key=lambda v: v.applications)
    methods = Counter(v.method for v in verdicts if v.method).most_common()
    by = ", ".join(f"{count} by {method}" for method, count in methods)
    return "\n".join(
        [
            f"| seeds {verdicts[0].seed} to {verdicts[-1].seed} | {len(verdicts)} |",
            "|---|---:|",
            *(f"| {kind} | {n} |" for kind, n in Counter(v.kind for v in verdicts).most_common()),
            "",
            f"Slowest: seed {slowest.seed}, {slowest.seconds:.0f} s ({slowest.kind}); most "
            f"operator applications: seed {hardest.seed}, {hardest.applications:,} "
            f"({hardest.kind}).{by and f' Solved: {by}.'} "
            f"Not certified: {_seeds(verdicts, 'degraded')}; "
            f"undecided: {_seeds(verdicts, 'undecided')}.",
        ]
    )


def _seeds(verdicts: Sequence[Verdict], kind: str) -> str:
    return ", ".join(str(v.seed) for v in verdicts if v.kind == kind) or "none"


def main(document: str, judge: Callable[..., Verdict], **options: Any) -> int:
    """Judge the scenes that the command line asks for; exit code 1 if one is a fault (collective).

    Parameters
    ----------
    document
        Docstring of the program; its first line is the help text.
    judge
        Of a seed and these options.
    options
        Default values of further options of the command line.
    """
    parser = argparse.ArgumentParser(description=document.split("\n", 1)[0])
    parser.add_argument("scenes", type=int, nargs="?", default=100)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    for name, value in options.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    arguments = vars(parser.parse_args())
    count, first = arguments.pop("scenes"), arguments.pop("first")
    verdicts = []
    for seed in range(first, first + count):
        verdict = judge(seed, **arguments)
        verdicts.append(verdict)
        if MPI.COMM_WORLD.rank == 0 and (verdict.kind not in QUIET or verdict.seconds > 10.0):
            print(f"{seed}: {verdict.kind} ({verdict.seconds:.1f} s) {verdict.detail}", flush=True)
    if MPI.COMM_WORLD.rank == 0:
        print(summary(verdicts))
    return int(any(v.fault for v in verdicts))
