"""Results of two versions side by side: rows of the paper, or runs of scenes.

A directory of `contact-app reproduce svm` or `reproduce cube` has counts as CSV, one of runs has a
`summary.json` in each directory below it. Both are compared by what neither machine nor load
changes: Hessian multiplications and energies.

    python -m contact_app.studies.two_versions BEFORE AFTER
"""

from __future__ import annotations

import csv
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

COUNTS = ("svm_counts.csv", "cube_counts.csv")


def compare(before: Path, after: Path) -> Iterator[str]:
    """Lines of a Markdown table.

    Raises
    ------
    FileNotFoundError
        The two directories have no results of the same kind.
    """
    for name in COUNTS:
        if (before / name).is_file() and (after / name).is_file():
            yield from _rows(before / name, after / name)
            return
    found = sorted({f.parent.relative_to(before) for f in before.rglob("summary.json")})
    found = [path for path in found if (after / path / "summary.json").is_file()]
    if not found:
        raise FileNotFoundError(f"{before} and {after} hold no results of the same kind")
    yield "| run | operator applications, before | after | energy, before | relative change |"
    yield "|---|---:|---:|---:|---:|"
    for path in found:
        old, new = (json.loads((d / path / "summary.json").read_text()) for d in (before, after))
        if "solver" in old and "solver" in new:  # that of load cases has those of the cases below
            yield _run(str(path), old, new)


def _rows(before: Path, after: Path) -> Iterator[str]:
    """The rows of the paper by data set and expansion."""
    pairs: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    with before.open(encoding="utf-8") as one, after.open(encoding="utf-8") as other:
        for old, new in zip(csv.DictReader(one), csv.DictReader(other), strict=True):
            pairs[old["benchmark"], old["expansion"]].append(
                (int(old["hessian"]), int(new["hessian"]))
            )
    yield "| benchmark | expansion | rows | equal | median, before | after | largest change |"
    yield "|---|---|---:|---:|---:|---:|---:|"
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


if __name__ == "__main__":
    print("\n".join(compare(Path(sys.argv[1]), Path(sys.argv[2]))))
