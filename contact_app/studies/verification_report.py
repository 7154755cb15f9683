"""The tables of ``contact-app verify`` in docs/benchmarks/verification.md, and its figure."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from contact_app.studies.tables import fill
from contact_app.studies.verification import Case, Row, find, rate, study

SETTLED = 0.2
"""Rate below which an error counts as constant."""


def write(results: Sequence[tuple[Case, Sequence[Row]]], directory: Path) -> list[Path]:
    """Write the tables of ``verification.md``, and ``pictures/verification.png``."""
    (directory / "pictures").mkdir(parents=True, exist_ok=True)
    text = directory / "verification.md"
    fill(text, {case.title: _table(rows) for case, rows in results})
    return [text, _figure(results, directory / "pictures" / "verification.png")]


def _table(rows: Sequence[Row]) -> str:
    names = [q.name for q in rows[0].quantities]
    lines = [
        "| mesh | dofs | " + " | ".join(names) + " | equilibrium | certified |",
        "|---|---:" + "|---:" * len(names) + "|---:|---|",
    ]
    for row in rows:
        numbers = " | ".join(f"{q.computed:.5g} ({_percent(q.error)})" for q in row.quantities)
        lines.append(
            f"| {row.level} | {row.dofs:,} | {numbers} | {row.equilibrium:.0e} "
            f"| {'yes' if row.certified else 'no'} |"
        )
    theory = " | ".join(f"{q.theory:.5g}" for q in rows[-1].quantities)
    orders = " | ".join(_order(rows, i) for i in range(len(names)))
    lines += [f"| theory | | {theory} | | |", f"| rate | | {orders} | | |", ""]
    return "\n".join(lines)


def _percent(error: float) -> str:
    return f"{error:+.2%}" if abs(error) > 5e-6 else f"{error:+.0e}"


def _order(rows: Sequence[Row], number: int) -> str:
    order = rate(rows, number)
    if order is None:
        return "exact"
    return f"{order:.1f}" if order >= SETTLED else "settled"


def _figure(results: Sequence[tuple[Case, Sequence[Row]]], target: Path) -> Path:
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    columns = min(3, len(results))
    lines = -(-len(results) // columns)
    figure = Figure(figsize=(4.4 * columns, 3.6 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, (case, rows) in zip(panels, results, strict=False):
        dofs = [row.dofs for row in rows]
        for i, quantity in enumerate(rows[0].quantities):
            errors = np.maximum([abs(row.quantities[i].error) for row in rows], 1e-13)
            axes.loglog(dofs, errors, marker="o", markersize=4, label=quantity.name)
        axes.axhline(0.02, color="grey", linewidth=0.8, linestyle="--")
        axes.set_title(case.title, fontsize=9)
        axes.set(xlabel="degrees of freedom", ylabel="relative error")
        if dofs[-1] < 10 * dofs[0]:  # the axis needs a power of ten to label
            axes.set_xticks(dofs, [f"{n:,}" for n in dofs])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=7)
    for axes in panels[len(results) :]:
        axes.set_axis_off()
    figure.savefig(target, dpi=120)
    return target


def verify(names: Sequence[str], directory: Path) -> Iterator[str]:
    """Run cases, yield lines of progress, write ``verification.md`` and its figure."""
    results: list[tuple[Case, list[Row]]] = []
    for case in find(names):
        rows = []
        for row in study(case):
            rows.append(row)
            errors = ", ".join(f"{q.name} {q.error:+.2%}" for q in row.quantities)
            yield f"{case.name} {row.level}: {row.dofs:,} dofs, {row.seconds:.1f} s: {errors}"
        results.append((case, rows))
        # partial results are saved, should a later case fail
        written = write(results, directory)
    for path in written:
        yield f"wrote {path}"
