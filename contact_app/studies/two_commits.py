"""Two checkouts of this repository side by side: energy, operator applications, seconds.

    python -m contact_app.studies.two_commits OLD NEW [SCENE[;KEY=VALUE…] …] [--rounds 3]
        [--paper] [--data DIR]

Each scene is solved by ``contact-app run`` in both checkouts by turns, in processes of their own on
one core, so that OLD may be any commit with that command. Of load cases and increments the last
energy and the sum of operator applications count. Seconds are the medians of the stages in
`runs.STAGES`, and the last column is their ratio. Unless scenes are named, all shipped scenes that
both checkouts have and the cube of 40³ and 60³ cells are taken. ``--paper`` adds
``reproduce svm`` (data sets in DIR, as there) and ``reproduce cube``: for each expansion how many
rows have equal Hessian multiplications, and the change of their median.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from contact_app.studies.processes import RunError, output
from contact_app.studies.runs import STAGES
from contact_app.studies.svm import find_data
from contact_app.studies.tables import read

CUBES = tuple(f"configs/cube.yaml;bodies.0.mesh.box.cells=[{n},{n},{n}]" for n in (40, 60))
HEADING = (
    "| scene | energy | change | applications, old | new | s, old | new | new / old |\n"
    "|---|---:|---:|---:|---:|---:|---:|---:|"
)
PAPER_HEADING = (
    "| benchmark, expansion | rows of equal counts | median, old | new | change |\n"
    "|---|---:|---:|---:|---:|"
)


def scenes_of(checkouts: Sequence[Path]) -> list[str]:
    """The shipped scenes of all checkouts, and the large cubes."""
    names = [{file.name for file in (c / "configs").glob("*.yaml")} for c in checkouts]
    return [*(f"configs/{name}" for name in sorted(set.intersection(*names))), *CUBES]


def summary_of(checkout: Path, scene: str) -> dict[str, Any]:
    """Energy, operator applications and seconds of one run."""
    file, *keys = scene.split(";")
    settings = [part for key in keys for part in ("--set", key)]
    with tempfile.TemporaryDirectory() as to:
        output("-m", "contact_app", "run", file, "-o", to, *settings, threads=1, directory=checkout)
        summary = json.loads((Path(to) / "summary.json").read_text(encoding="utf-8"))
    answers = summary.get("steps") or [*summary.get("cases", {}).values()] or [summary]
    return {
        "energy": answers[-1]["solution"]["energy"],
        "applications": sum(a["solver"]["hessian_multiplications"] for a in answers),
        "seconds": sum(summary["timings"][stage] for stage in STAGES),
    }


def row(scene: str, checkouts: Sequence[Path], rounds: int) -> str:
    """The row of a scene."""
    runs: list[list[dict[str, Any]]] = [[] for _ in checkouts]
    try:
        for _ in range(rounds):
            for checkout, of_checkout in zip(checkouts, runs, strict=True):
                of_checkout.append(summary_of(checkout, scene))
    except RunError as error:
        return f"| {scene} | {error} |"
    (old, *_), (new, *_) = runs
    before, after = (median(run["seconds"] for run in of_checkout) for of_checkout in runs)
    return (
        f"| {scene} | {new['energy']:.9g} | {abs(new['energy'] / old['energy'] - 1.0):.0e} | "
        f"{old['applications']:,} | {new['applications']:,} | {before:.2f} | {after:.2f} | "
        f"{after / before:.2f} |"
    )


def counts_of(checkout: Path, benchmark: str, data: Path | None) -> dict[str, list[int]]:
    """Hessian multiplications of the rows of a benchmark of the paper, by set and expansion."""
    sets = ["--data", str(find_data(data).resolve())] if benchmark == "svm" else []
    with tempfile.TemporaryDirectory() as to:
        command = ("-m", "contact_app", "reproduce", benchmark, "-o", to, *sets)
        output(*command, threads=1, directory=checkout)
        return grouped(Path(to) / f"{benchmark}_counts.csv")


def grouped(file: Path) -> dict[str, list[int]]:
    """Hessian multiplications in a CSV of `reproduce`, by set and expansion."""
    counts: dict[str, list[int]] = {}
    for entry in read(file, texts=("benchmark", "expansion")):
        counts.setdefault(f"{entry['benchmark']} {entry['expansion']}", []).append(entry["hessian"])
    return counts


def paper_rows(old: dict[str, list[int]], new: dict[str, list[int]]) -> Iterator[str]:
    """Rows of a benchmark of the paper: equal counts and medians of each expansion."""
    for name, before in old.items():
        equal = sum(a == b for a, b in zip(before, new[name], strict=True))
        first, second = median(before), median(new[name])
        yield (
            f"| {name} | {equal} of {len(before)} | {first:g} | {second:g} | "
            f"{100.0 * (second / first - 1.0):+.1f} % |"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Two checkouts side by side.")
    parser.add_argument("checkouts", nargs=2, type=Path)
    parser.add_argument("scenes", nargs="*", help="file, and keys after semicolons")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--paper", action="store_true", help="the rows of the paper as well")
    parser.add_argument("--data", type=Path, help="directory of the SVM data sets")
    arguments = parser.parse_args()
    checkouts = [checkout.resolve() for checkout in arguments.checkouts]
    print(HEADING)
    for scene in arguments.scenes or scenes_of(checkouts):
        print(row(scene, checkouts, arguments.rounds), flush=True)
    if arguments.paper:
        print(f"\n{PAPER_HEADING}")
        for benchmark in ("svm", "cube"):
            old, new = (counts_of(c, benchmark, arguments.data) for c in checkouts)
            print(*paper_rows(old, new), sep="\n", flush=True)


if __name__ == "__main__":
    main()
