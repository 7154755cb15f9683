"""Log, progress and interruption of a run of several solves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from contact_app.results.report import run_log
from contact_app.run.communication import on_first
from contact_app.run.files import log_caches, without_parts
from contact_app.run.progress import Interruption, Progress
from contact_app.run.result_directory import clear
from solver.contact.checkpoint import Attention, Checkpoint


@contextmanager
def attended(
    directory: Path, comm: MPI.Intracomm, resume: bool, every: float
) -> Iterator[tuple[Progress, Attention]]:
    """Context manager of a run of several solves that writes to a directory (collective).

    Parameters
    ----------
    resume
        Whether files of an earlier run stay, so that this one goes on from them.
    every
        Seconds between two tests for an interruption; nothing is saved then.
    """
    first = comm.rank == 0
    on_first(comm, lambda: clear(directory, resume))
    with (
        without_parts(directory),
        run_log(directory / "run.log", first),
        Progress(first) as progress,
        Interruption() as interruption,
    ):
        log_caches()
        # only its clock is used: nothing is saved within a solve
        clock = Checkpoint(directory, comm, False, every)
        yield progress, Attention(comm, lambda: interruption.requested, clock)
