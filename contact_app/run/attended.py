"""Log, progress, checkpoint and interruption of a run."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from contact_app.errors import CouldNotRunError
from contact_app.machine.exits import add_remedy
from contact_app.machine.ranks import on_first
from contact_app.results.report import run_log
from contact_app.run.files import log_caches, without_parts
from contact_app.run.progress import Interruption, Progress
from contact_app.run.result_directory import clear
from solver.contact.checkpoint import CHECKPOINT, Attention, Checkpoint


@dataclass(frozen=True, eq=False)
class Attended:
    """The parts of a run that react to its user."""

    progress: Progress
    interruption: Interruption
    checkpoint: Checkpoint
    attention: Attention
    """The monitor that stops a solve after an interruption and saves its state."""


@contextmanager
def attended(
    directory: Path, comm: MPI.Intracomm, resume: bool, every: float, saves: bool = False
) -> Iterator[Attended]:
    """Context manager of a run that writes to a directory (collective).

    Parameters
    ----------
    resume
        Whether files of an earlier run stay, so that this one goes on from them.
    every
        Seconds between two checkpoints.
    saves
        Whether a solve goes on from its checkpoint. In a run of several solves only the clock of
        the checkpoint is used, and nothing is saved within a solve.
    """
    first = comm.rank == 0
    on_first(comm, lambda: clear(directory, resume))
    checkpoint = Checkpoint(directory, comm, resume and saves, every)
    with (
        without_parts(directory),
        run_log(directory / "run.log", first),
        Progress(first) as progress,
        Interruption() as interruption,
    ):
        log_caches()
        attention = Attention(comm, lambda: interruption.requested, checkpoint)
        try:
            yield Attended(progress, interruption, checkpoint, attention)
        except (OSError, CouldNotRunError) as error:
            if (directory / CHECKPOINT).is_file():
                add_remedy(error, "--resume goes on from the checkpoint of this run")
            raise
