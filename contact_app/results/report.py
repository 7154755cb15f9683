"""The report of a run: ``run.log``, ``summary.json``, and the table at its end."""

import json
import logging
import math
import platform
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from contact_app.machine.atomic_file import atomic
from contact_app.machine.exits import is_own_failure, mark_logged, message_of, print_message
from contact_app.results.percent import percent
from contact_app.results.repeated_sentences import shortened
from contact_app.results.report_rows import MOST, contact_force, force_of, named_rows, number

log = logging.getLogger("contact_app")

WIDEST = 1000
"""Largest number of characters in a line of a table."""


class _LogFile(logging.FileHandler):
    """A log file; a full disk truncates it with one message and does not end the run."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, mode="w", encoding="utf-8")
        self.fault: BaseException | None = None

    def handleError(self, record: logging.LogRecord) -> None:
        self.fault = self.fault or sys.exc_info()[1]

    def close(self) -> None:
        try:
            super().close()
        except OSError as error:
            self.fault = self.fault or error


@contextmanager
def run_log(path: Path | None, first: bool = True) -> Iterator[logging.Logger]:
    """Context manager that writes log messages and warnings of Python to a text file.

    Other packages' messages are kept from the terminal, their warnings in the file: compiling a
    form tells the root logger every command it runs. An exception that passes is logged, one that
    is an internal error with its traceback, by whichever rank meets it.

    Parameters
    ----------
    path
        ``run.log``; None where there is none.
    first
        Whether this rank writes it.
    """
    handler: logging.Handler = logging.NullHandler()
    if path is not None and first:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = _LogFile(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    handler.addFilter(_is_reported)
    root = logging.getLogger()
    handlers, level = root.handlers, log.level
    root.handlers = [handler]
    log.setLevel(logging.INFO)
    try:
        log.info("command: %s", " ".join(sys.argv))
        log.info("python %s on %s", platform.python_version(), platform.platform())
        with warnings.catch_warnings():
            warnings.showwarning = _log_warning
            yield log
    except BaseException as error:
        if path is not None:
            _log_end(error, path, first)
        raise
    finally:
        root.handlers = handlers
        log.setLevel(level)
        handler.close()
        fault = getattr(handler, "fault", None)
        if fault is not None:
            print_message(f"{path} is incomplete: {getattr(fault, 'strerror', None) or fault}")


def _log_end(error: BaseException, path: Path, first: bool) -> None:
    """Log the exception that ends a run; rank 0 logs those of other ranks."""
    is_own = is_own_failure(error)
    if first:
        log.error("%s", message_of(error), exc_info=error if is_own else None)
    elif is_own:
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write("on another rank:\n" + "".join(traceback.format_exception(error)))
        except OSError:
            return
    if is_own:
        mark_logged(error, path)


def _log_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Python's warnings as lines of the log; the signature is `warnings.showwarning`'s."""
    log.warning("%s: %s (%s:%d)", category.__name__, message, filename, lineno)


def _is_reported(record: logging.LogRecord) -> bool:
    """Accept messages of this package, and warnings of others."""
    return record.name == log.name or record.levelno >= logging.WARNING


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Write ``summary.json`` in one step: it is never incomplete.

    JSON knows neither NaN nor infinity: they become null.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(plain(summary), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """A value in the types of JSON; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


#: Names of the certificate's numbers in the table.
CERTIFICATE = {
    "max_penetration": "penetration / largest displacement",
    "max_gluing_jump": "gluing jump / largest displacement",
    "min_multiplier": "most negative contact force / load",
    "complementarity": "complementarity / (load × displacement)",
    "equilibrium": "equilibrium residual / load",
    "duality_gap": "duality gap / energy",
}

#: Names of the further numbers with friction.
FRICTION = {
    "friction_cone": "friction beyond its limit / load",
    "slip_alignment": "slip against friction / (load × displacement)",
}


def print_summary(
    summary: Mapping[str, Any],
    tolerance: float | None = None,
    files: Iterable[Path | str] = (),
    console: Console | None = None,
) -> None:
    """Print a summary as a short table.

    Parameters
    ----------
    summary
        Content of ``summary.json``.
    tolerance
        ``solver.tolerance``: with it each line of the certificate says whether it is met.
    files
        Paths of the written files.
    console
        Where to; standard output when not given.
    """
    console = console or Console(highlight=False)
    console.print(summary_table(summary, tolerance))
    solver = summary["solver"]
    if not solver["converged"]:
        text = Text.assemble(("not converged: ", "bold red"), str(solver["reason"]))
        console.print(text, soft_wrap=True)
    sides = [c[side] for c in summary.get("contacts", ()) for side in ("on", "with")]
    bodies = {str(side).split(".")[0] for side in sides}
    for warning in shortened(summary["certificate"]["warnings"], bodies):
        console.print(Text.assemble(("warning: ", "bold yellow"), str(warning)), soft_wrap=True)
    for path in files:
        console.print(Text(f"wrote {path}"), soft_wrap=True)


def summary_table(summary: Mapping[str, Any], tolerance: float | None = None) -> Table:
    """Make the table of `print_summary`."""
    mesh, pieces = summary["mesh"], summary["decomposition"]
    solver, solution = summary["solver"], summary["solution"]
    certificate, timings = summary["certificate"], summary["timings"]
    environment = summary["environment"]
    table = Table(
        title=Text(str(summary["scene"]["title"])),
        title_justify="left",
        show_header=False,
        box=None,
        pad_edge=False,
    )
    table.add_column("quantity")
    table.add_column("value")
    table.add_column("verdict")

    def row(name: str, value: str, verdict: Text | str = "") -> None:
        table.add_row(name, Text(value), verdict)

    row("nodes", f"{mesh['nodes']:,}")
    row("degrees of freedom", f"{mesh['dofs']:,}")
    row("subdomains", f"{pieces['subdomains']:,}")
    row("Hessian multiplications", f"{solver['hessian_multiplications']:,}")
    row("largest displacement", number(solution["max_displacement"]))
    if pieces["contact"]:
        row("nodes in contact", f"{solution['active_contacts']:,} of {pieces['contact']:,}")
    for name, value in named_rows(summary):
        row(name, value)
    frictional = {key: name for key, name in FRICTION.items() if key in certificate}
    for key, name in (CERTIFICATE | frictional).items():
        value = certificate.get(key)
        met = None
        if certificate["passed"]:
            met = True
        elif tolerance is not None:
            met = value is not None and abs(value) <= tolerance
        row(name, number(value), _verdict(met))
    decides = f"decided by {certificate['decided_by']}" if "decided_by" in certificate else ""
    row("certificate", decides, _verdict(bool(certificate["passed"])))
    accuracy = summary["accuracy"]
    row("error of the mesh (estimate)", _percent(accuracy["discretisation"]))
    row("error of the solver (bound)", _percent(accuracy["algebraic"]))
    if "guaranteed" in accuracy:
        bound = accuracy["guaranteed"]
        row(
            "error of both (guaranteed bound)",
            "none" if bound is None else at_most(bound),
            _verdict(bound is not None),
        )
    if "target" in accuracy:
        row("error of both", _percent(accuracy["total"]), _verdict(bool(accuracy["met"])))
        for level in summary["levels"]:
            error = _percent(level.get("guaranteed", level["total"]))
            row(
                f"  {level['dofs']:,} degrees of freedom",
                f"{error}, {level['hessian_multiplications']:,} Hessian multiplications, "
                f"{level['seconds']:.1f} s" + (", from the last" if level["warm"] else ""),
            )
    row("time", f"{timings['total']:.1f} s, {timings['solve']:.1f} s of it solving")
    ranks = environment["ranks"]
    row("memory", f"{environment['peak_rss_gb']:.2f} GB" + (" on a rank" if ranks > 1 else ""))
    return table


def print_cases(
    summary: Mapping[str, Any], warnings: Iterable[str] = (), files: Iterable[Path | str] = ()
) -> None:
    """Print the overview of load cases as a table.

    Parameters
    ----------
    summary
        Content of the ``summary.json`` beside the directories of the cases.
    warnings
        Warnings of the certificates, each with its cases.
    """
    console = Console(highlight=False)
    _print_whole(console, cases_table(summary))
    for key, name in (("von_mises", "von Mises stress"), ("contact_pressure", "contact pressure")):
        peak = summary["envelope"][key]
        if peak["case"] is not None:
            console.print(f"largest {name}: {number(peak['value'])}, case {peak['case']}")
    timings = summary["timings"]
    console.print(f"time: {timings['total']:.1f} s, {timings['solve']:.1f} s of it solving")
    for name, case in summary["cases"].items():
        if not case["certificate"]["passed"]:
            text = Text.assemble((f"case {name}: ", "bold red"), str(case["solver"]["reason"]))
            console.print(text, soft_wrap=True)
    for warning in warnings:
        console.print(Text.assemble(("warning: ", "bold yellow"), warning), soft_wrap=True)
    for path in files:
        console.print(Text(f"wrote {path}"), soft_wrap=True)


def print_steps(summary: Mapping[str, Any], files: Iterable[Path | str] = ()) -> None:
    """Print the increments of a load history as a table, and the last one as of a single scene."""
    _print_whole(Console(highlight=False), steps_table(summary["steps"]))
    print_summary(summary, summary["solver"]["tolerance"], files)


def steps_table(records: Sequence[Mapping[str, Any]]) -> Table:
    """Make the table of `print_steps`."""
    table = Table(box=None, pad_edge=False)
    rough = any("dissipated_work" in record["solution"] for record in records)
    statuses = ("stick", "slip", "dissipated") if rough else ("in contact",)
    for head in ("step", "factor", "largest |u|", "contact force", *statuses, ""):
        table.add_column(head, no_wrap=True)
    for record in records:
        solution, contacts = record["solution"], record["contacts"]
        counts = [contact.get("nodes", {}) for contact in contacts]
        slip, stick = (str(sum(n.get(key, 0) for n in counts)) for key in ("slip", "stick"))
        work = solution.get("dissipated_work")
        table.add_row(
            str(record["step"]),
            f"{record['factor']:.4g}",
            number(solution["max_displacement"]),
            contact_force(record),
            *((stick, slip, "" if work is None else number(work)) if rough else (slip,)),
            _verdict(bool(record["certificate"]["passed"])),
        )
    return table


def _print_whole(console: Console, table: Table) -> None:
    """Print a table as wide as it is: a narrow terminal breaks its lines and cuts no number."""
    options = console.options.update(max_width=WIDEST)
    width = console.width
    console.width = max(width, Measurement.get(console, options, table).maximum)
    console.print(table)
    console.width = width


def cases_table(summary: Mapping[str, Any]) -> Table:
    """Make the table of `print_cases`."""
    table = Table(
        title=Text(str(summary["scene"]["title"])), title_justify="left", box=None, pad_edge=False
    )
    heads = ("case", "displacement", "von Mises", "pressure", "contact force")
    for head in (*heads, "certificate"):
        table.add_column(head, no_wrap=True)
    for name, case in summary["cases"].items():
        solution, contacts = case["solution"], case.get("contacts", [])
        table.add_row(
            Text(name),
            number(solution["max_displacement"]),
            number(solution["max_von_mises"]),
            number(solution["max_contact_pressure"]),
            contact_force(case) if len(contacts) < 2 else "",
            _verdict(bool(case["certificate"]["passed"])),
        )
        for contact in contacts[:MOST] if len(contacts) > 1 else ():
            name, pressure = f"  {contact['on']} on {contact['with']}", contact["max_pressure"]
            table.add_row(Text(name), "", "", number(pressure), force_of(contact))
        if len(contacts) > MOST:
            table.add_row(f"  and {len(contacts) - MOST} more in summary.json")
    return table


def _percent(value: float | None) -> str:
    return "unknown" if value is None else percent(value)


def at_most(value: float) -> str:
    """A bound in percent, three digits, rounded up."""
    digits = 2 - math.floor(math.log10(100.0 * value)) if value > 0.0 else 0
    return f"{math.ceil(100.0 * value * 10.0**digits) / 10.0**digits:.3g} %"


def _verdict(met: bool | None) -> Text:
    if met is None:
        return Text("")
    return Text("passed", style="green") if met else Text("failed", style="bold red")
