"""Strong scaling: the same cube on one rank and on several, with one thread each.

``python -m contact_app.studies.strong_scaling [SERIES [CELLS [RANKS…]]]`` prints the table of
docs/benchmarks/scaling.md: a series of `contact-app bench` (hexahedra), cells along an edge of the
cube (60) and numbers of ranks (1 2). Every run is a process of its own. Seconds count from the mesh
to the certified solution; they are the minimum of `REPEATS` runs, or of the runs that begin within
`PATIENCE` seconds.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from contact_app.studies.bench import SERIES, Series, config
from contact_app.studies.processes import python
from contact_app.studies.runs import STAGES, from_summary

REPEATS = 20
PATIENCE = 240.0


def strong(
    series: Series, cells: int, ranks: Sequence[int], tolerance: float = 1e-6
) -> Iterator[dict[str, Any]]:
    """Summaries of the fastest run on each number of ranks.

    Numbers of ranks take turns, so that changes of the machine's speed affect all of them.
    """
    overrides = [
        f"decomposition={series.decomposition(3 * (cells + 1) ** 3)}",
        f"solver.tolerance={tolerance}",
    ]
    with tempfile.TemporaryDirectory() as directory:
        overrides += series.mesh(cells, Path(directory))
        given = [part for override in overrides for part in ("--set", override)]
        found: list[list[dict[str, Any]]] = []
        began = time.perf_counter()
        while len(found) < REPEATS and time.perf_counter() < began + PATIENCE:
            found.append(
                [
                    python(
                        "-m", "contact_app.studies.single_run", str(config()), *given,
                        ranks=n, threads=1,
                    )
                    for n in ranks
                ]
            )  # fmt: skip
    for runs in zip(*found, strict=True):
        yield min(runs, key=lambda summary: from_summary(summary)["seconds"])


def main() -> None:
    """Print the table."""
    name, *numbers = sys.argv[1:] or ["hexahedra"]
    series = next(series for series in SERIES if series.name == name)
    cells, *ranks = [int(word) for word in numbers] or [60]
    counts = ranks or [1, 2]
    first = None
    stages = " | ".join(f"{stage} (s)" for stage in STAGES)
    print(f"| unknowns | ranks | {stages} | all (s) | speed-up | applications | GB |")
    print("|---:" * (len(STAGES) + 6) + "|")
    for summary in strong(series, cells, counts):
        row = from_summary(summary)
        first = first or row["seconds"]
        stages = " | ".join(f"{summary['timings'][stage]:.2f}" for stage in STAGES)
        print(
            f"| {row['dofs']:,} | {row['ranks']} | {stages} | {row['seconds']:.2f} "
            f"| {first / row['seconds']:.2f} | {row['applications']} | {row['peak_rss_gb']:.2g} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
