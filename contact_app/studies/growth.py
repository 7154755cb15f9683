"""Growth of time and memory of this application with the unknowns, on the cube of hexahedra.

Each size is a run in a process of its own. Further runs, such as the paper's cube of 81,812,703
unknowns, are added by their ``summary.json``. The slope is that of the straight line through
log(seconds) against log(unknowns): 1 where time grows as the unknowns do.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contact_app.errors import ConfigurationError
from contact_app.studies.bench import OURS, config
from contact_app.studies.processes import RunError
from contact_app.studies.runs import from_summary, run_one
from contact_app.studies.tables import write

COLUMNS = ("dofs", "subdomains", "ranks", "seconds", "peak_rss_gb", "applications", "steps",
           "energy", "source")  # fmt: skip


def growth(
    output: Path,
    cells: Sequence[int],
    summaries: Sequence[Path] = (),
    tolerance: float = 1e-6,
    limit: float | None = None,
) -> Iterator[dict[str, Any]]:
    """Run every size, read every summary, yield the rows; write ``growth.csv`` and ``growth.png``.

    Parameters
    ----------
    cells
        Cells along an edge.
    summaries
        Files, or directories that hold a ``summary.json`` anywhere below.

    Raises
    ------
    ConfigurationError
        A summary is missing or no summary of this application.
    """
    output.mkdir(parents=True, exist_ok=True)
    found = read_summaries(summaries)
    rows: list[dict[str, Any]] = []
    try:
        for n in cells:
            settings = [f"bodies.0.mesh.box.cells=[{n},{n},{n}]", "decomposition=auto"]
            try:
                row = run_one(OURS, config(), settings, tolerance, limit)
            except RunError as error:
                yield {"dofs": 3 * (n + 1) ** 3, "note": str(error)}
                continue
            rows.append({**row, "source": "this run"})
            yield rows[-1]
        rows += found
        yield from found
    finally:
        rows.sort(key=lambda row: row["dofs"])
        write(rows, COLUMNS, output / "growth.csv")
        if len(rows) > 1:
            draw(rows, output / "growth.png")


def read_summaries(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Rows of further certified runs."""
    rows = []
    for path in paths:
        files = sorted(path.rglob("summary.json")) if path.is_dir() else [path]
        if not files:
            raise ConfigurationError(f"--summaries {path}: no summary.json is there")
        for file in files:
            try:
                row = from_summary(json.loads(file.read_text(encoding="utf-8")))
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise ConfigurationError(f"--summaries {file}: no summary: {error}") from error
            except RunError:
                continue
            rows.append({**row, "source": str(file)})
    return rows


def slope(dofs: ArrayLike, values: ArrayLike) -> float:
    """Slope of the least-squares line through logarithms.

    >>> round(slope([1e4, 1e5, 1e6], [1.0, 10.0, 100.0]), 6)
    1.0
    """
    return float(np.polyfit(np.log(dofs), np.log(values), 1)[0])


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Seconds and memory against unknowns, each beside the line of slope 1."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    dofs = np.array([row["dofs"] for row in rows], float)
    figure, panels = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for axes, key, label in zip(
        panels,
        ("seconds", "peak_rss_gb"),
        ("seconds from mesh to certified solution", "peak memory, GB"),
        strict=True,
    ):
        values = np.array([row[key] for row in rows], float)
        axes.loglog(dofs, values, "o-", label=f"measured, slope {slope(dofs, values):.2f}")
        axes.loglog(dofs, values[-1] * dofs / dofs[-1], ":", color="0.4", label="slope 1")
        axes.set_xlabel("degrees of freedom")
        axes.set_ylabel(label)
        axes.grid(visible=True, which="both", alpha=0.25)
        axes.legend()
    figure.savefig(path, dpi=130)
    plt.close(figure)
