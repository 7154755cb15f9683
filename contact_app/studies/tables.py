"""The rows of a study: CSV, tables of a page, and matplotlib for figures."""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
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


def plotting() -> Any:
    """Matplotlib's pyplot, drawing to files; without its complaint about a second installation."""
    import warnings

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Unable to import Axes3D")
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    return pyplot
