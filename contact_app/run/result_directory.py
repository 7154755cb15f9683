"""The directory of a run: removal of older results and of incomplete files.

A run begins by removing the results of an earlier run, so that the summary in the directory of a
failed run never belongs to another scene. Only files with names of this program are touched. A file
is written as ``.NAME.part`` and renamed when it is complete; a killed run leaves such a part, and
the next run removes it. `run.log` and `history.csv` grow during the run.
"""

import json
import re
from pathlib import Path

from contact_app.machine.atomic_file import part_of
from solver.contact.checkpoint import CHECKPOINT, remove_checkpoint

RESULTS = (
    "summary.json",
    "solution.xdmf",
    "solution.h5",
    "solution.vtu",
    "envelope.xdmf",
    "envelope.h5",
    "envelope.vtu",
    "envelope.png",
    "history.csv",
    "run.log",
    "bodies.png",
    "contact_pressure.png",
    "contact_status.png",
    "increments.csv",
    "solution.pvd",
)
"""Files of a run and of ``contact-app plot``, in the order in which they are removed."""

OF_INCREMENTS = re.compile(r"solution-\d+\.(h5|vtu)")
"""Files of the increments of a load history."""

HISTORY = "history.csv"


def clear(directory: Path, resume: bool) -> None:
    """Make a directory, and remove results of an earlier run and incomplete files from it.

    Parameters
    ----------
    resume
        Whether to keep the checkpoint with its history and finished increments.
    """
    directory.mkdir(parents=True, exist_ok=True)
    _clear_cases(directory)
    going_on = resume and (directory / CHECKPOINT).is_file()
    retained = _retained(directory) if going_on else ()
    increments = [path.name for path in directory.iterdir() if OF_INCREMENTS.fullmatch(path.name)]
    for name in (*RESULTS, *increments):
        if name not in retained:
            (directory / name).unlink(missing_ok=True)
    if not going_on:
        remove_checkpoint(directory)
    remove_parts(directory)


def _retained(directory: Path) -> set[str]:
    """The files that a resumed run keeps in its directory."""
    retained = {HISTORY}
    try:
        saved = json.loads((directory / CHECKPOINT).read_text(encoding="utf-8"))
        finished = len(saved["records"])
    except (OSError, ValueError, KeyError, TypeError):
        return retained
    retained |= {"summary.json", "increments.csv", "solution.xdmf", "solution.h5", "solution.pvd"}
    numbers = range(1, finished + 1)
    return retained | {f"solution-{n}.{suffix}" for n in numbers for suffix in ("h5", "vtu")}


def _clear_cases(directory: Path) -> None:
    """Remove the results of the load cases that an earlier run's summary names."""
    try:
        summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        names = [str(name) for name in summary.get("cases", {})]
    except (OSError, ValueError, AttributeError):
        return
    for name in names:
        of_case = directory / name
        if Path(name).name == name and (of_case / "summary.json").is_file():
            clear(of_case, resume=False)
            if not any(of_case.iterdir()):
                of_case.rmdir()


def remove_parts(directory: Path) -> None:
    """Remove incomplete files."""
    for name in RESULTS:
        part_of(directory / name).unlink(missing_ok=True)
    for path in directory.glob(".solution-*.part"):
        path.unlink()
