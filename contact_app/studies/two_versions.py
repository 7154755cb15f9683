"""Two versions side by side: shipped scenes, cubes, the paper's own problem and its rows.

Each version first runs all of them, one process after another. Runs with results in the directory
are skipped, so that an interrupted series can be continued. The log holds the start and end of each
run::

    python -m contact_app.studies.two_versions --run CHECKOUT DIRECTORY SVM_DATA

CHECKOUT is a checkout of this project with its `contact` launcher; SVM_DATA are the data of
`reproduce svm --data`. Two such directories are then compared by operator applications and
energies, which depend neither on the machine nor on its load::

    python -m contact_app.studies.two_versions BEFORE AFTER
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

COUNTS = "*_counts.csv"
EXPANSIONS = (
    "projcg", "gfgf-opt", "gfgr-opt", "grgr-opt", "gfgr-optapprox", "grgr-optapprox", "fixed",
)  # fmt: skip
"""Rows of the paper's tables, the quickest first."""


def jobs(checkout: Path, data: Path) -> Iterator[tuple[str, list[str]]]:
    """Directory and arguments of each run."""
    for scene in sorted((checkout / "configs").glob("*.yaml")):
        yield f"scenes/{scene.stem}", ["run", str(scene)]
    cube = str(checkout / "configs" / "cube.yaml")
    for cells in (40, 60):
        cells_key = f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]"
        yield f"scenes/cube{cells}", ["run", cube, "--set", cells_key]
    yield "svm", ["reproduce", "svm", "--data", str(data)]
    for expansion in EXPANSIONS:
        yield f"rows/{expansion}", ["reproduce", "cube", "--expansion", expansion]
    for rule in ("ours", "paper"):
        yield f"whole/{rule}", ["reproduce", "cube", "--scale", "paper", "--settings", rule]


def run(checkout: Path, output: Path, data: Path) -> Iterator[str]:
    """Run all runs without results in the directory; a sentence for each run."""
    for name, arguments in jobs(checkout, data):
        directory = output / name
        if (directory / "done").is_file():
            continue
        directory.mkdir(parents=True, exist_ok=True)
        yield f"{time.strftime('%H:%M:%S')} {name}"
        with (directory / "output.log").open("w", encoding="utf-8") as log:
            code = subprocess.run(
                [str(checkout / "contact"), *arguments, "-o", str(directory)],
                stdout=log, stderr=subprocess.STDOUT, check=False,
            ).returncode  # fmt: skip
        yield f"{time.strftime('%H:%M:%S')} {name} ended with exit code {code}"
        if code in (0, 1):
            (directory / "done").touch()


def compare(before: Path, after: Path) -> Iterator[str]:
    """Lines of Markdown tables: one of the runs, one of the rows of the paper.

    Raises
    ------
    FileNotFoundError
        The two directories have no results of the same kind.
    """
    tables = _both(before, after, COUNTS)
    within = {table.parent for table in tables}
    runs = [
        path
        for path in _both(before, after, "summary.json")
        if within.isdisjoint(path.parents)  # rows of the paper have summaries, too
    ]
    if not runs and not tables:
        raise FileNotFoundError(f"{before} and {after} hold no results of the same kind")
    if runs:
        yield "| run | operator applications, before | after | energy, before | relative change |"
        yield "|---|---:|---:|---:|---:|"
        for path in runs:
            old, new = (json.loads((d / path).read_text()) for d in (before, after))
            if "solver" in old and "solver" in new:  # an overview of load cases has no solver
                yield _run(str(path.parent), old, new)
    if runs and tables:
        yield ""
    if tables:
        yield "| benchmark | expansion | rows | equal | median, before | after | largest change |"
        yield "|---|---|---:|---:|---:|---:|---:|"
        for path in tables:
            yield from _rows(before / path, after / path)


def _both(before: Path, after: Path, pattern: str) -> list[Path]:
    found = sorted(file.relative_to(before) for file in before.rglob(pattern))
    return [path for path in found if (after / path).is_file()]


def _rows(before: Path, after: Path) -> Iterator[str]:
    """The rows of the paper by data set and expansion."""
    pairs: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    with before.open(encoding="utf-8") as one, after.open(encoding="utf-8") as other:
        for old, new in zip(csv.DictReader(one), csv.DictReader(other), strict=True):
            pairs[old["benchmark"], old["expansion"]].append(
                (int(old["hessian"]), int(new["hessian"]))
            )
    for (benchmark, expansion), counts in pairs.items():
        same = sum(old == new for old, new in counts)
        medians = [median(column) for column in zip(*counts, strict=True)]
        most = max(abs(new / old - 1.0) for old, new in counts)
        yield (
            f"| {benchmark} | `{expansion}` | {len(counts)} | {same} | {medians[0]:g} | "
            f"{medians[1]:g} | {100.0 * most:.3g} % |"
        )


def _run(name: str, old: dict[str, Any], new: dict[str, Any]) -> str:
    counts = [s["solver"]["hessian_multiplications"] for s in (old, new)]
    first, second = (s["solution"]["energy"] for s in (old, new))
    change = abs(second - first) / abs(first) if first else abs(second)
    shown = f"{change:.1e}" if change else "0"
    return f"| {name} | {counts[0]} | {counts[1]} | {first:.10g} | {shown} |"


def main(arguments: list[str]) -> None:
    """Run one version, or compare two."""
    if arguments[:1] == ["--run"]:
        lines = run(*(Path(argument).resolve() for argument in arguments[1:4]))
    else:
        lines = compare(Path(arguments[0]), Path(arguments[1]))
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
