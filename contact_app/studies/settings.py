"""Scenes under several settings side by side: work, seconds, accuracy, agreement.

    python -m contact_app.studies.settings SCENE[;KEY=VALUE…] … --beside KEY=VALUE[;KEY=VALUE…] …

Each scene is solved unchanged and under each of the settings, in turns. Seconds are processor
seconds, the minimum of `ROUNDS` solves, with the search for planes of symmetry and without start-up
and writing files. "over the least" is their ratio to the fewest seconds of the scene. The last
column is the relative change of the energy from that of the first row. A scene with load cases
is solved with its last case.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from contact_app.errors import ContactError
from contact_app.run.answer import CaseAnswers, solve

ROUNDS = 3
"""Number of solves of each setting; a first one, which compiles forms, is not counted."""

AS_IT_IS = "as it is"
HEADING = (
    "| scene | settings | unknowns | subdomains | method | applications | tolerance | error of the "
    "mesh | of the solver | s | over the least | energy |\n|---|---|---:|---:|---|" + "---:|" * 7
)


def rows(
    scene: Path, keys: Sequence[str], settings: Sequence[str], rounds: int = ROUNDS
) -> Iterator[str]:
    """The rows of one scene: as it is, then under each setting."""
    label = " ".join([scene.stem, *keys])
    ways = {AS_IT_IS: list(keys), **{s: [*keys, *s.split(";")] for s in settings}}
    summaries: dict[str, dict[str, Any]] = {}
    least = dict.fromkeys(ways, float("inf"))
    refused: dict[str, str] = {}
    for turn in range(1 + rounds):
        for name, changes in ways.items():
            if name in refused:
                continue
            began = time.process_time()
            try:
                answer = solve(scene, changes, MPI.COMM_SELF)
            except ContactError as error:
                refused[name] = str(error).splitlines()[0]
                continue
            if turn or not rounds:
                least[name] = min(least[name], time.process_time() - began)
            last = [*answer.cases.values()][-1] if isinstance(answer, CaseAnswers) else answer
            summaries[name] = last.summary
    energies = [summary["solution"]["energy"] for summary in summaries.values()]
    fewest = min(least[name] for name in summaries) if summaries else 0.0
    for name in ways:
        if name in refused:
            yield f"| {label} | {name} | {refused[name]} |"
        else:
            change = (
                summaries[name]["solution"]["energy"] / energies[0] - 1.0 if energies[0] else 0.0
            )
            seconds = f"{least[name]:.2f} | {least[name] / fewest:.2f}"
            yield f"| {label} | {name} | {cells(summaries[name])} | {seconds} | {abs(change):.0e} |"


def cells(summary: dict[str, Any]) -> str:
    """Numbers of a summary, from the unknowns to the error of the solver."""
    solver, accuracy = summary["solver"], summary["accuracy"]
    solved = summary.get("symmetry", {}).get("solved", summary["mesh"])["dofs"]
    note = "" if summary["certificate"]["passed"] else ", not certified"
    return (
        f"{solved:,} | {summary['decomposition']['subdomains']:,} | {solver['method']}{note} | "
        f"{solver['hessian_multiplications']:,} | {solver['tolerance']:.1e} | "
        f"{100 * accuracy['discretisation']:.2g} % | {100 * accuracy['algebraic']:.2g} %"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Scenes under several settings side by side.")
    parser.add_argument("scenes", nargs="+", help="file, and keys after semicolons")
    parser.add_argument("--beside", nargs="*", default=[], help="keys, separated by semicolons")
    arguments = parser.parse_args()
    print(HEADING)
    for argument in arguments.scenes:
        name, *keys = argument.split(";")
        for row in rows(Path(name), keys, arguments.beside):
            print(row, flush=True)


if __name__ == "__main__":
    main()
