"""A load history over its time: forces of contacts, displacements of probes, and statuses.

Drawn from ``increments.csv`` alone, the table that a run with `steps` leaves. Time counts steps:
the first one ends at 1. All begin at zero, without load.
"""

import csv
from pathlib import Path
from typing import Any

from contact_app.errors import ContactError

TABLE = "increments.csv"

LARGEST = 12
"""Largest number of lines in a legend; further lines are drawn without a name."""

Column = list[float]


class HistoryError(ContactError):
    """The table of increments cannot be read."""


def draw_history(table: Path, target: Path, title: str = "") -> Path:
    """Draw a load history; return the picture's path.

    Raises
    ------
    HistoryError
        The table is incomplete.
    """
    from matplotlib.figure import Figure

    columns = read_table(table)
    shown = {name: lines for name, lines in panels(columns).items() if lines}
    figure = Figure(figsize=(8.0, 2.2 * len(shown) + 0.6), layout="constrained")
    all_axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, lines) in zip(all_axes, shown.items(), strict=True):
        _draw(axes, columns["time"], lines)
        axes.set_ylabel(name)
    figure.align_ylabels(all_axes)
    all_axes[0].set_title(title or "load history")
    all_axes[-1].set_xlabel("time: completed steps")
    figure.savefig(target, dpi=150, format="png")
    return target


def read_table(table: Path) -> dict[str, Column]:
    """The columns of ``increments.csv``; missing values are zero, as before their step."""
    try:
        with table.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        names = rows[0].keys()
        columns = {name: [float(row[name] or 0.0) for row in rows] for name in names}
        assert columns["time"][-1] > 0.0, "no time has passed"
    except (OSError, ValueError, LookupError, TypeError, AssertionError) as error:
        raise HistoryError(f"{table} is no table of increments: {error!r}") from error
    return columns


def panels(columns: dict[str, Column]) -> dict[str, dict[str, Column]]:
    """Content of each panel: names and columns."""
    axes = ("_x", "_y", "_z")
    of_all_bodies = {"max_displacement", "energy", "dissipated_work"}
    of_panel = [name for name in columns if name.endswith(axes) and name not in of_all_bodies]
    forces = [name for name in of_panel if name.startswith("contacts[") and "_force_" in name]
    probes = [name for name in of_panel if name not in forces and not name.startswith("factor_")]
    statuses = [n for n in columns if n.endswith(("_stick", "_slip")) and n.startswith("contacts[")]
    factors = [name for name in columns if name.startswith("factor_")]
    rough = "dissipated_work" in columns

    def of(names: list[str], drop: str = "") -> dict[str, Column]:
        some = {name: columns[name] for name in names if any(columns[name])}
        return {name.removeprefix(drop).replace("_", " "): line for name, line in some.items()}

    return {
        "factors": of(factors, "factor_"),
        "force on the body": of(forces),
        "displacement of probes" if probes else "largest displacement": of(
            probes or ["max_displacement"]
        ),
        "nodes": {
            name if rough else name.replace("slip", "in contact"): line
            for name, line in of(statuses).items()
        },
        "work lost to friction": of([n for n in ("dissipated_work",) if n in columns]),
    }


def _draw(axes: Any, time: Column, lines: dict[str, Column]) -> None:
    """The lines of a panel, from the unloaded state on, with a rule where each step ends."""
    for name, values in lines.items():
        axes.plot([0.0, *time], [0.0, *values], marker="o", markersize=3.0, label=name)
    for end in range(1, round(time[-1]) + 1):
        axes.axvline(end, color="#bbbbbb", linewidth=0.8, zorder=0)
    axes.axhline(0.0, color="#bbbbbb", linewidth=0.8, zorder=0)
    if len(lines) <= LARGEST:
        axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
