"""Two checkouts of this repository side by side: energy, operator applications, seconds.

    python -m contact_app.studies.two_commits OLD NEW [SCENE[;KEY=VALUE…] …] [--rounds 3] [--paper]

Each scene is solved in both checkouts by turns, in processes of their own on one core (`single_run`
of each checkout; a scene with load cases with its last case). Seconds are the medians of the stages
in `runs.STAGES`, and the last column is their ratio. Unless scenes are named, all scenes of NEW
with a mesh and the cube of 40³ and 60³ cells are taken. ``--paper`` adds the rows of ``reproduce
svm`` and ``reproduce cube``: how many of them have equal counts, and the largest change.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.processes import RunError, python
from contact_app.studies.runs import STAGES
from contact_app.studies.svm import find_data
from contact_app.studies.tables import read

CUBES = tuple(f"configs/cube.yaml;bodies.0.mesh.box.cells=[{n},{n},{n}]" for n in (40, 60))
HEADING = (
    "| scene | energy | change | applications, old | new | s, old | new | new / old |\n"
    "|---|---:|---:|---:|---:|---:|---:|---:|"
)


def scenes_of(checkout: Path) -> list[str]:
    """The shipped scenes of one step, and the large cubes."""
    files = sorted((checkout / "configs").glob("*.yaml"))
    single = [file for file in files if "\nsteps:" not in file.read_text(encoding="utf-8")]
    return [*(f"configs/{file.name}" for file in single), *CUBES]


def row(scene: str, checkouts: Sequence[Path], rounds: int) -> str:
    """The row of a scene."""
    file, *keys = scene.split(";")
    settings = [part for key in keys for part in ("--set", key)]
    runs: list[list[dict[str, Any]]] = [[] for _ in checkouts]
    try:
        for _ in range(rounds):
            for checkout, of_checkout in zip(checkouts, runs, strict=True):
                command = ("-m", "contact_app.studies.single_run", file, *settings)
                of_checkout.append(python(*command, threads=1, directory=checkout))
    except RunError as error:
        return f"| {scene} | {error} |"
    (old, *_), (new, *_) = runs
    energies = [summary["solution"]["energy"] for summary in (old, new)]
    counts = [summary["solver"]["hessian_multiplications"] for summary in (old, new)]
    before, after = (
        float(np.median([sum(s["timings"][stage] for stage in STAGES) for s in of_checkout]))
        for of_checkout in runs
    )
    return (
        f"| {scene} | {energies[1]:.9g} | {abs(energies[1] / energies[0] - 1.0):.0e} | "
        f"{counts[0]:,} | {counts[1]:,} | {before:.2f} | {after:.2f} | {after / before:.2f} |"
    )


def counts_of(checkout: Path, benchmark: str) -> list[int]:
    """Hessian multiplications of the rows of a benchmark of the paper."""
    data = ["--data", str(find_data(None))] if benchmark == "svm" else []
    with tempfile.TemporaryDirectory() as to:
        subprocess.run(
            [sys.executable, "-m", "contact_app", "reproduce", benchmark, "-o", to, *data],
            cwd=checkout, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=True,
            stdout=subprocess.DEVNULL,
        )  # fmt: skip
        rows = read(Path(to) / f"{benchmark}_counts.csv", texts=("benchmark", "expansion"))
    return [row["hessian"] for row in rows]


def paper_rows(benchmark: str, checkouts: Sequence[Path]) -> str:
    """A sentence on the rows of a benchmark of the paper."""
    old, new = (counts_of(checkout, benchmark) for checkout in checkouts)
    changes = [after / before - 1.0 for before, after in zip(old, new, strict=True)]
    equal = sum(change == 0.0 for change in changes)
    return (
        f"{benchmark}: {equal} of {len(changes)} rows have equal Hessian multiplications, the "
        f"largest change is {100 * max(changes, key=abs):+.1f} %"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Two checkouts side by side.")
    parser.add_argument("checkouts", nargs=2, type=Path)
    parser.add_argument("scenes", nargs="*", help="file, and keys after semicolons")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--paper", action="store_true", help="the rows of the paper as well")
    arguments = parser.parse_args()
    checkouts = [checkout.resolve() for checkout in arguments.checkouts]
    print(HEADING)
    for scene in arguments.scenes or scenes_of(checkouts[1]):
        print(row(scene, checkouts, arguments.rounds), flush=True)
    if arguments.paper:
        for benchmark in ("svm", "cube"):
            print(paper_rows(benchmark, checkouts), flush=True)


if __name__ == "__main__":
    main()
