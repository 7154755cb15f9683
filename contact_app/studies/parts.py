"""Contact compared with one linear solve of the same bodies and with PETSc's solvers.

``contact-app bench parts`` takes parts from a mesher, ``contact-app bench`` the paper's cube. Each
run is a process of its own, from the mesh file to the solution (`contact_app.studies.part_run`
defines the seconds), with one rank per core or with threads of BLAS on all cores. A scene with load
cases is solved with its last case. The first run for a type of cells may compile forms, which its
seconds contain: run the command twice on a new machine. The columns of the table:

"over linear"
    Seconds relative to ``linear-gamg``: conjugate gradients with GAMG to the same tolerance on the
    part glued at its contacts. For several bodies it uses one mesh through all, if that is drawn
    (noted ``fused``, with its own number of unknowns).
"CPU"
    CPU seconds, summed over ranks, which depend less on other work on the machine.
"iterations"
    Products with the stiffness, or with the dual operator of Total FETI.
"contact known"
    Products in one linear solve of this application: the active rows of the solution hold with
    equality, and the solve begins at zero.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.parts_meshes import Meshes
from contact_app.studies.peers import METHODS
from contact_app.studies.processes import RunError
from contact_app.studies.runs import printed_row
from contact_app.studies.single_run import OWN_METHODS
from contact_app.studies.tables import Row, plotting, read, write
from contact_app.studies.undecomposed import UnsuitableError

CONFIGS = Path(__file__).parents[2] / "configs"
PARTS = ("pillow_block", "pin_in_lug", "bolted_flange", "hub_on_shaft", "ball_in_grooves")
LINEAR = "linear-gamg"
CUBE = Path(__file__).with_name("data") / "paper_cube.yaml"
"""The paper's cube."""

CHOSEN = (LINEAR, "linear-boomeramg", "primal", "active-set", "tao-bnls", "tao-bntr", "snes-vi")
COLUMNS = ("part", "meshes", "degree", "method", "unknowns", "used", "read", "assembly", "solve",
           "seconds", "cpu", "iterations", "known", "memory", "ranks", "converged", "energy",
           "note")  # fmt: skip
"""Columns of the CSV: seconds, memory in GB summed over ranks, energy in the units of the scene."""

TEXTS = ("part", "meshes", "method", "used", "note")
"""Columns of words."""

HEADING = (
    "| part | unknowns | method | read | assembly | solve | seconds | over linear | CPU "
    "| over linear | iterations | contact known | GB | note |\n"
    "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|"
)


@dataclass(frozen=True)
class Settings:
    """Settings of all runs of a benchmark."""

    tolerance: float = 1e-8
    """Relative tolerance of all methods by their own tests, of this application by the
    certificate."""
    degree: int = 1
    limit: float = 120.0
    """Seconds a run may take, start-up included."""
    parallel: bool = True
    """Whether this application gets one rank per core instead of threads of BLAS, which are faster
    where subdomains are congruent. Methods of PETSc have their own rule."""


Run = Callable[[Path, str, Sequence[str], Settings], Row]
"""Function of scene, method, overrides and settings that returns the measured values. It raises
`RunError`."""


def run_part(path: Path, method: str, overrides: Sequence[str], settings: Settings) -> Row:
    """Run one method on one part in a process of its own."""
    parallel = settings.parallel if method in OWN_METHODS else METHODS[method].parallel
    words = ("--stages", "--method", method, "--tolerance", str(settings.tolerance))
    return printed_row(path, overrides, *words, parallel=parallel, limit=settings.limit)


def bench(
    output: Path,
    scenes: Sequence[Path],
    meshes: Sequence[Meshes],
    methods: Sequence[str] = CHOSEN,
    settings: Settings | None = None,
    run: Run = run_part,
) -> Iterator[str]:
    """Run every method on every mesh of every scene; write ``parts.csv``, ``.md``, ``.png``.

    Yields the lines of the table. A method without a solution on a mesh is left out on the scene's
    later meshes. Rows that an earlier run left in ``parts.csv`` stay there unless they are measured
    again.

    Parameters
    ----------
    meshes
        From coarse to fine.
    run
        Function that returns the measured values of one run.
    """
    settings = settings or Settings()
    output.mkdir(parents=True, exist_ok=True)
    table = output / "parts.csv"
    rows = {_key(row): row for row in (read(table, TEXTS) if table.exists() else [])}
    yield HEADING
    try:
        for path in scenes:
            out: set[str] = set()
            for chosen in meshes:
                overrides = chosen.overrides(path, settings.degree)
                head = {"part": path.stem, "meshes": chosen.name, "degree": settings.degree}
                for method in methods:
                    row = {**head, "method": method, "note": "left out after a coarser mesh"}
                    if method not in out:
                        row |= _attempt(path, method, overrides, settings, run)
                    if not row.get("converged"):
                        out.add(method)
                    rows[_key(row)] = row
                    write(rows.values(), COLUMNS, table)  # saved even if the next run fails
                    yield line(row, _linear(row, rows))
    finally:
        measured = list(rows.values())
        lines = [HEADING, *(line(row, _linear(row, rows)) for row in measured)]
        solved = [row for row in measured if row.get("converged")]
        lines += ["", *slopes(solved)]
        (output / "parts.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
        draw(solved, output / "parts.png")


def _attempt(
    path: Path, method: str, overrides: Sequence[str], settings: Settings, run: Run
) -> Row:
    """The measured values of one run; ``note`` holds a remark, or the reason of a failure."""
    try:
        row = run(path, method, overrides, settings)
    except RunError as error:
        reason = str(error)
        return {"note": reason.rpartition(f"{UnsuitableError.__name__}: ")[2] or reason}
    note = "" if row["used"] == method else row["used"]
    if not row["converged"]:
        note = "not certified" if method in OWN_METHODS else "did not converge"
    return {**row, "note": note}


def _key(row: Row) -> tuple[str, str, int, str]:
    return row["part"], row["meshes"], row["degree"], row["method"]


def _linear(row: Row, rows: dict[tuple[str, str, int, str], Row]) -> Row | None:
    """The linear solve of a row's mesh, if it converged."""
    linear = rows.get((*_key(row)[:3], LINEAR))
    return linear if linear is not None and linear.get("converged") else None


def line(row: Row, linear: Row | None) -> str:
    """A row of the table in Markdown, with ratios to the linear solve."""
    if "seconds" not in row:
        return f"| {row['part']} | | {row['method']} |" + " |" * 10 + f" {row['note']} |"

    def ratio(key: str) -> str:
        return "" if linear is None else f"{row[key] / linear[key]:.2f}"

    seconds = " | ".join(f"{row[key]:.3g}" for key in ("read", "assembly", "solve", "seconds"))
    return (
        f"| {row['part']} | {row['unknowns']:,} | {row['method']} | {seconds} | {ratio('seconds')} "
        f"| {row['cpu']:.3g} | {ratio('cpu')} | {row['iterations']} | {row.get('known', '')} "
        f"| {row['memory']:.2f} | {row['note']} |"
    )


def slopes(rows: Sequence[Row]) -> Iterator[str]:
    """Growth of time and memory with the unknowns: slopes in logarithms of each part and method.

    >>> rows = [{"part": "p", "degree": 1, "method": "m", "unknowns": n, "seconds": n, "memory": n}
    ...         for n in (10, 90)]
    >>> list(slopes(rows))
    ['Slopes of m on p of degree 1 in the unknowns: time 1.00, memory 1.00.']
    """
    for key in dict.fromkeys((row["part"], row["degree"], row["method"]) for row in rows):
        alike = [row for row in rows if (row["part"], row["degree"], row["method"]) == key]
        if len({row["unknowns"] for row in alike}) > 1:
            unknowns, seconds, memory = (
                np.log([row[name] for row in alike]) for name in ("unknowns", "seconds", "memory")
            )
            time, space = (np.polyfit(unknowns, values, 1)[0] for values in (seconds, memory))
            yield (
                f"Slopes of {key[2]} on {key[0]} of degree {key[1]} in the unknowns: "
                f"time {time:.2f}, memory {space:.2f}."
            )


def draw(rows: Sequence[Row], path: Path) -> None:
    """Seconds and memory of rows with an answer: this application thick, linear methods dotted."""
    plt = plotting()
    panels = dict.fromkeys((row["part"], row["degree"]) for row in rows)
    if not panels:
        return
    drawn, grid = plt.subplots(
        len(panels), 2, figsize=(10, 0.6 + 3.4 * len(panels)), layout="constrained", squeeze=False
    )
    linear = [name for name, method in METHODS.items() if not method.contact]
    lines: dict[str, Any] = {}
    for pair, (part, degree) in zip(grid, panels, strict=True):
        for number, method in enumerate((*OWN_METHODS, *METHODS)):
            key = part, degree, method
            of_method = [r for r in rows if (r["part"], r["degree"], r["method"]) == key]
            of_method.sort(key=lambda row: row["unknowns"])
            for axes, what in zip(pair, ("seconds", "memory"), strict=True):
                if of_method:
                    (lines[method],) = axes.loglog(
                        [r["unknowns"] for r in of_method], [r[what] for r in of_method],
                        color=plt.get_cmap("tab10")(number % 10),
                        linewidth=2.8 if method in OWN_METHODS else 1.3,
                        linestyle=":" if method in linear else "-",
                        marker="o" if method in OWN_METHODS else ".",
                    )  # fmt: skip
        for axes, what in zip(pair, ("seconds", "peak memory, GB"), strict=True):
            axes.set_title(f"{part}, degree {degree}", fontsize=10)
            axes.set_ylabel(what)
            axes.grid(visible=True, which="both", alpha=0.25)
    for axes in grid[-1]:
        axes.set_xlabel("unknowns (dotted: linear, without contact)")
    drawn.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=5, fontsize=8)
    drawn.savefig(path, dpi=130)
    plt.close(drawn)
