"""The rows of a benchmark: CSV, tables of a page, a figure of seconds and memory over unknowns."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def write(rows: Iterable[Row], columns: Sequence[str], path: Path) -> None:
    """Write these columns as CSV; missing values stay empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def read(path: Path, texts: Sequence[str] = ()) -> list[Row]:
    """Rows of a CSV by `write`, without empty cells except in the columns `texts`.

    Other columns hold numbers or True and False.
    """
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {key: text if key in texts else _value(text)
             for key, text in row.items() if text or key in texts}
            for row in csv.DictReader(file)
        ]  # fmt: skip


def _value(text: str) -> int | float | bool:
    if text in ("True", "False"):
        return text == "True"
    return int(text) if text.lstrip("-").isdigit() else float(text)


def fill(page: Path, tables: Mapping[str, str]) -> None:
    """Put tables in Markdown into the sections of a page, each in place of the section's first one.

    The text around them stays; sections that the page lacks are added to its end.
    """
    text = page.read_text(encoding="utf-8") if page.is_file() else ""
    for title, table in tables.items():
        section = rf"^## {re.escape(title)}\n(?:(?!## |\|).*\n)*"
        match = re.search(rf"({section})(?:\|.*\n)*", text, re.MULTILINE)
        if match:
            text = text[: match.end(1)] + table + text[match.end() :]
        else:
            text += f"\n## {title}\n\n{table}"
    page.write_text(text, encoding="utf-8")


@dataclass(frozen=True)
class Figure:
    """Content of a figure.

    Attributes
    ----------
    methods
        Methods; each has a colour.
    panels
        Function of a row of the table that returns the title of its row of axes.
    unknowns, memory
        Names of columns.
    """

    methods: Sequence[str]
    application: Sequence[str]
    linear: Sequence[str]
    panels: Callable[[Row], str]
    unknowns: str
    memory: str


def draw(rows: Sequence[Row], figure: Figure, path: Path) -> None:
    """Seconds and memory of rows with an answer: this application thick, linear methods dotted."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    titles = list(dict.fromkeys(figure.panels(row) for row in rows))
    if not titles:
        return
    drawn, grid = plt.subplots(
        len(titles), 2, figsize=(10, 0.6 + 3.4 * len(titles)), layout="constrained", squeeze=False
    )
    lines: dict[str, Any] = {}
    for pair, title in zip(grid, titles, strict=True):
        for number, method in enumerate(figure.methods):
            of_method = [r for r in rows if (figure.panels(r), r["method"]) == (title, method)]
            of_method.sort(key=lambda row: row[figure.unknowns])
            for axes, key in zip(pair, ("seconds", figure.memory), strict=True):
                if of_method:
                    (lines[method],) = axes.loglog(
                        [r[figure.unknowns] for r in of_method], [r[key] for r in of_method],
                        color=plt.get_cmap("tab10")(number % 10),
                        linewidth=2.8 if method in figure.application else 1.3,
                        linestyle=":" if method in figure.linear else "-",
                        marker="o" if method in figure.application else ".",
                    )  # fmt: skip
        for axes, what in zip(pair, ("seconds", "peak memory, GB"), strict=True):
            axes.set_title(title, fontsize=10)
            axes.set_ylabel(what)
            axes.grid(visible=True, which="both", alpha=0.25)
    for axes in grid[-1]:
        axes.set_xlabel("unknowns (dotted: linear, without contact)")
    drawn.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=5, fontsize=8)
    drawn.savefig(path, dpi=130)
    plt.close(drawn)
