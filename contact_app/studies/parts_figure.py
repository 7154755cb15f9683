"""The figure of a benchmark of parts: seconds and memory over unknowns, a line for each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from contact_app.studies.part_run import OURS
from contact_app.studies.peers import METHODS


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the rows that have an answer, a row of axes for each part and degree."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    done = [row for row in rows if row.get("converged")]
    kinds = list(dict.fromkeys((row["part"], row["degree"]) for row in done))
    if not kinds:
        return
    figure, grid = plt.subplots(
        len(kinds), 2, figsize=(10, 0.6 + 3.4 * len(kinds)), layout="constrained", squeeze=False
    )
    lines: dict[str, Any] = {}
    for pair, (part, degree) in zip(grid, kinds, strict=True):
        for number, method in enumerate((*OURS, *METHODS)):
            mine = [
                r for r in done if (r["part"], r["degree"], r["method"]) == (part, degree, method)
            ]
            mine.sort(key=lambda row: row["unknowns"])
            for axes, key in zip(pair, ("seconds", "memory"), strict=True):
                if mine:
                    unknowns = [r["unknowns"] for r in mine]
                    style = _style(method, number)
                    (lines[method],) = axes.loglog(unknowns, [r[key] for r in mine], **style)
        for axes, what in zip(pair, ("seconds", "peak memory, GB"), strict=True):
            axes.set_title(f"{part}, degree {degree}", fontsize=10)
            axes.set_ylabel(what)
            axes.grid(visible=True, which="both", alpha=0.25)
    for axes in grid[-1]:
        axes.set_xlabel("unknowns (dotted: linear, glued where it may touch)")
    figure.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=5, fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _style(method: str, number: int) -> dict[str, Any]:
    """Of a line: ours thick, linear methods dotted."""
    import matplotlib.pyplot as plt

    ours, linear = method in OURS, method in METHODS and not METHODS[method].contact
    return {
        "color": plt.get_cmap("tab10")(number % 10),
        "linewidth": 2.8 if ours else 1.3,
        "linestyle": ":" if linear else "-",
        "marker": "o" if ours else ".",
    }
