"""This application and PETSc's solvers side by side in one run: tables, CSV and figures.

The methods run one after another, each in a process of its own (or in one rank per core if that is
faster). Seconds count from the mesh to the certified solution, without start-up and without writing
files; memory is the largest resident set, summed over ranks. A method that exceeds the time limit
is left out on larger meshes, and the table says so.

There are two series: the cube of hexahedra, and a cube of tetrahedra from a mesh file whose inner
nodes are moved at random (`perturbed`), so that every subdomain has a factor of its own. For all
methods this file is read and checked before the clock starts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.peers import METHODS
from contact_app.studies.perturbed import write_cube
from contact_app.studies.processes import RunError
from contact_app.studies.runs import run_one
from contact_app.studies.tables import Figure, draw, read, write
from meshes.decompose import choose_parts

COLUMNS = ("series", "method", "cells", "dofs", "seconds", "peak_rss_gb", "steps", "applications",
           "energy", "energy_error", "penetration", "subdomains", "ranks", "note")  # fmt: skip
TEXTS = ("series", "method", "note")
"""Columns of words."""

OURS = "contact-app"
ONE_FACTOR = "one-factor"
"""This application without decomposition: one CHOLMOD factor of the body and MPRGP on its contact
rows."""

CONTACT = (ONE_FACTOR, *(name for name, m in METHODS.items() if m.contact))
LINEAR = tuple(name for name, m in METHODS.items() if not m.contact)

FIGURE = Figure(
    (OURS, *CONTACT, *LINEAR), (OURS,), LINEAR, lambda row: row["series"], "dofs", "peak_rss_gb"
)

MOST_DIRECT = ("snes-vi-cholmod", "snes-vi", ONE_FACTOR, "tao-bnls", "tao-bntr", OURS)
MOST_DIRECT_LINEAR = ("linear-cholmod", "linear-gamg", "linear-boomeramg")
"""Methods whose energy is the reference: the first one that was run."""


@dataclass(frozen=True)
class Series:
    """Meshes of one kind.

    Attributes
    ----------
    mesh
        Overrides of the scene for a number of cells along an edge; mesh files go to the directory.
    decomposition
        Decomposition in this application, from the number of unknowns.
    parallel
        Whether this application is faster on ranks than with threads, i.e. dense products are rare.
    """

    name: str
    mesh: Callable[[int, Path], tuple[str, ...]]
    decomposition: Callable[[int], str]
    parallel: bool


def _box(cells: int, _directory: Path) -> tuple[str, ...]:
    return (f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]",)


def _file(cells: int, directory: Path) -> tuple[str, ...]:
    path = directory.resolve() / f"cube-{cells}.vtu"
    write_cube(path, cells)
    faces = {"z-": "z < 1e-9", "z+": "z > 1 - 1e-9", "x+": "x > 1 - 1e-9"}
    boundaries = {name: {"where": where} for name, where in faces.items()}
    return (
        f"bodies.0.mesh={json.dumps({'file': str(path)})}",
        f"bodies.0.boundaries={json.dumps(boundaries)}",
    )


SERIES = (
    Series("hexahedra", _box, lambda dofs: "auto", False),
    Series(
        "tetrahedra",
        _file,
        lambda dofs: f"{{subdomains: {choose_parts(dofs // 3, 3, 2)}}}",
        True,
    ),
)

Run = Callable[[str, Series, Sequence[str], int, float, float], dict[str, Any]]
"""Method, series, overrides for the mesh, dofs, tolerance and limit; the row's measured values."""


def bench(
    output: Path,
    cells: Sequence[int],
    unstructured: Sequence[int],
    tolerance: float = 1e-8,
    limit: float = 60.0,
    methods: Sequence[str] | None = None,
    run: Run | None = None,
) -> Iterator[dict[str, Any]]:
    """Run every method on every size and yield rows; write ``bench.csv``, ``.md``, ``.png``.

    Rows that an earlier run left in ``bench.csv`` stay there unless they are measured again.

    Parameters
    ----------
    cells, unstructured
        Cells along an edge of each cube of hexahedra and of each cube of tetrahedra, whose files
        are written beside the table.
    tolerance
        Tolerance of all methods by their own tests; for this application by the certificate.
    limit
        Seconds a run may take, start-up included.
    methods
        Methods to run; all of them unless given.
    run
        Function that makes the row of one run, in place of `run_method`.
    """
    run = run or run_method
    output.mkdir(parents=True, exist_ok=True)
    table, picture = output / "bench.csv", output / "bench.png"
    chosen = [m for m in (OURS, *CONTACT, *LINEAR) if methods is None or m in methods]
    rows = {_key(row): row for row in (read(table, TEXTS) if table.exists() else [])}
    try:
        for series, sizes in zip(SERIES, (cells, unstructured), strict=True):
            if sizes:
                mesh = series.mesh(2, output)
                # compile all forms into the cache on disk before anything is timed
                for method in chosen:
                    _attempt(run, method, series, 2, mesh, tolerance, limit)
            out: dict[str, str] = {}
            for n in sorted(sizes):
                mesh = series.mesh(n, output)
                measured = [
                    _attempt(run, m, series, n, mesh, tolerance, limit, out.get(m, ""))
                    for m in chosen
                ]
                out |= {row["method"]: row["note"] for row in measured if row["note"]}
                rows |= {_key(row): row for row in measured}
                alike = [row for row in rows.values() if _key(row)[:2] == (series.name, n)]
                rows |= {_key(row): row for row in with_energy_error(alike)}
                write(_ordered(rows), COLUMNS, table)  # rows are saved even if the next mesh fails
                yield from (rows[_key(row)] for row in measured)
    finally:
        ordered = _ordered(rows)
        write(ordered, COLUMNS, table)
        table.with_suffix(".md").write_text(markdown(ordered), encoding="utf-8")
        draw([row for row in ordered if not row["note"]], FIGURE, picture)


def _key(row: dict[str, Any]) -> tuple[str, int, str]:
    return row["series"], row["cells"], row["method"]


def _ordered(rows: dict[tuple[str, int, str], dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows.values(), key=lambda row: _place(*_key(row)))


def _place(series: str, cells: int, method: str) -> tuple[int, int, int]:
    """Position of a row in the table."""
    names, methods = [s.name for s in SERIES], (OURS, *CONTACT, *LINEAR)
    return names.index(series), cells, methods.index(method)


def _attempt(
    run: Run,
    method: str,
    series: Series,
    n: int,
    mesh: Sequence[str],
    tolerance: float,
    limit: float,
    failed: str = "",
) -> dict[str, Any]:
    """Row of one run, or a row with the reason why it was not run."""
    dofs = 3 * (n + 1) ** 3
    row = {"series": series.name, "method": method, "cells": n, "dofs": dofs, "note": ""}
    if failed:
        return {**row, "note": "left out after a smaller mesh"}
    try:
        return row | run(method, series, mesh, dofs, tolerance, limit)
    except RunError as error:
        return {**row, "note": str(error)}


def run_method(
    method: str, series: Series, mesh: Sequence[str], dofs: int, tolerance: float, limit: float
) -> dict[str, Any]:
    """Time and memory of one method on one mesh, in a separate process."""
    parts = "{subdomains: 1}" if method == ONE_FACTOR else series.decomposition(dofs)
    overrides = (*mesh, f"decomposition={parts}")
    parallel = series.parallel and method == OURS
    return run_one(method, config(), overrides, tolerance, limit, parallel=parallel)


def with_energy_error(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Add to the rows of one mesh the difference of each energy from the most direct method's.

    Differences are relative. Methods with contact are compared with each other, and so are linear
    methods.
    """
    energy = {row["method"]: row["energy"] for row in rows if not row["note"]}
    result = []
    for row in rows:
        family = MOST_DIRECT_LINEAR if row["method"] in LINEAR else MOST_DIRECT
        best = next((energy[m] for m in family if m in energy), None)
        if best is not None and not row["note"]:
            row = {**row, "energy_error": abs(row["energy"] / best - 1.0)}
        result.append(row)
    return result


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Seconds and memory of all methods, a table for each series, a line for each mesh."""
    lines = []
    for series in SERIES:
        of_series = {(r["dofs"], r["method"]): r for r in rows if r["series"] == series.name}
        methods = [m for m in (OURS, *CONTACT, *LINEAR) if any(m == k[1] for k in of_series)]
        if not methods:
            continue
        lines += [f"**{series.name}**", "", "| unknowns | " + " | ".join(methods) + " |",
                  "|---:" * (len(methods) + 1) + "|"]  # fmt: skip
        for dofs in sorted({key[0] for key in of_series}):
            cells = []
            for method in methods:
                row = of_series.get((dofs, method), {"note": "not run"})
                cells.append(row["note"] or f"{row['seconds']:.3g} s, {row['peak_rss_gb']:.2g} GB")
            lines.append(f"| {dofs:,} | " + " | ".join(cells) + " |")
        errors = [row["energy_error"] for row in of_series.values() if "energy_error" in row]
        if errors:
            lines += ["", f"Energies differ by {max(errors):.1e} at most, relatively.", ""]
        lines += [*slopes([row for row in of_series.values() if not row["note"]]), ""]
    return "\n".join(lines)


def slopes(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Growth of time and memory of each method with the unknowns: slopes in logarithms.

    >>> list(slopes([{"method": "m", "dofs": n, "seconds": n, "peak_rss_gb": n} for n in (10, 90)]))
    ['Slopes of m in the unknowns: time 1.00, memory 1.00.']
    """
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method]
        dofs, seconds, memory = (
            np.log([row[key] for row in of_method]) for key in ("dofs", "seconds", "peak_rss_gb")
        )
        if len(of_method) > 1:
            time, space = (np.polyfit(dofs, value, 1)[0] for value in (seconds, memory))
            yield f"Slopes of {method} in the unknowns: time {time:.2f}, memory {space:.2f}."


def config() -> Path:
    """The cube's scene."""
    return Path(__file__).with_name("data") / "paper_cube.yaml"


def line(row: dict[str, Any]) -> str:
    """One row of the table on the terminal; `HEADING` stands above."""
    head = f"{row['method']:17} {row['dofs']:9,}"
    if row["note"]:
        return f"{head}  {row['note']}"
    error = row.get("energy_error", math.nan)
    return (
        f"{head} {row['seconds']:8.2f} {row['peak_rss_gb']:6.2f} {row['steps']:6} "
        f"{row['applications']:12}  {row['energy']:.9f}  {error:8.1e}"
    )


HEADING = (
    f"{'method':17} {'dofs':>9} {'seconds':>8} {'GB':>6} {'steps':>6} {'applications':>12}  "
    f"{'energy':12}  {'error':>8}"
)
