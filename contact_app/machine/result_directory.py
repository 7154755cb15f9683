"""The directory of a run: cleared of older results, and free of files that are not whole.

A run begins by removing what an earlier one left there, so that a summary beside a failed run is
never that of the last scene. Only files with the names that this program gives are touched. A file
is written under another name, ``.NAME.part``, and renamed when it is whole; a run that is killed
leaves such a part, and the next one removes it. `run.log` and `history.csv` grow during the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

RESULTS = (
    "summary.json",
    "solution.xdmf",
    "solution.h5",
    "history.csv",
    "run.log",
    "bodies.png",
    "contact_pressure.png",
)
"""Files of a run and of ``contact-app plot``, in the order in which they are removed."""

CHECKPOINT, VECTORS = "checkpoint.json", "checkpoint-*.vectors"

LOG, HISTORY = "run.log", "history.csv"


def part_of(path: Path) -> Path:
    """Name of a file that is not whole yet.

    >>> str(part_of(Path("out/summary.json")))
    'out/.summary.json.part'
    """
    return path.with_name(f".{path.name}.part")


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The name to write a file under, which is renamed at the end of the block.

    If the block ends by an exception the part is removed and an older file stays.
    """
    part = part_of(path)
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def clear(directory: Path, resume: bool) -> None:
    """Make a directory, and remove the results of an earlier run and parts of files from it.

    Parameters
    ----------
    resume
        Keep the checkpoint, and the history that belongs to it.
    """
    directory.mkdir(parents=True, exist_ok=True)
    going_on = resume and (directory / CHECKPOINT).is_file()
    for name in RESULTS:
        if not (going_on and name == HISTORY):
            (directory / name).unlink(missing_ok=True)
    if not going_on:
        remove_checkpoint(directory)
    remove_parts(directory)


def remove_checkpoint(directory: Path) -> None:
    """Remove a checkpoint with its vectors."""
    for file in (directory / CHECKPOINT, *directory.glob(VECTORS)):
        file.unlink(missing_ok=True)


def remove_parts(directory: Path) -> None:
    """Remove files that are not whole."""
    for name in (*RESULTS, CHECKPOINT):
        part_of(directory / name).unlink(missing_ok=True)
