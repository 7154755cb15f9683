"""The checkpoint of a stopped run: the state of the solver at one of its steps.

A checkpoint is written every 30 seconds and when the run is asked to stop, at any step of any
algorithm. `Attention` decides at each step, on all ranks together, and the running algorithm then
gives its state. The penalty ρ distinguishes two kinds of states:

- ρ > 0: SMALBE, within an outer iteration or at its end. x and μ, and all scalars.
- ρ = 0: conjugate gradients on an active set, or MPRGP alone. x is λ itself, and the second vector
  is 1 in active contact rows and 0 elsewhere.

Two files: the vectors (`vector_file`) and the scalars in JSON, written last and renamed into place,
so that a run killed while it writes leaves the previous checkpoint intact. Rows have another order
on another number of ranks, so a run goes on with as many as wrote its checkpoint.
"""

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from solver import Counts
from solver.contact.vector_file import read_vectors, write_vectors
from solver.qp.outer_state import Restart
from solver.qp.result import Step
from solver.vectors import Array, Mask

CHECKPOINT, VECTORS = "checkpoint.json", "checkpoint-*.vectors"
"""Names of the file of the scalars and of the files of vectors."""

EVERY_SECONDS = 30.0
"""Seconds of solving between two checkpoints: a killed run loses no more."""

SAME = 1e-6
"""Relative difference up to which the numbers that describe two problems count as equal."""

log = logging.getLogger("contact_app")


class CheckpointError(Exception):
    """A checkpoint cannot be used; the text says why and what to do."""


class Checkpoint:
    """Writes, reads and removes the checkpoint of one run; methods are collective.

    Parameters
    ----------
    directory
        Directory of ``checkpoint.json`` and its vectors.
    resume
        Whether a run goes on from a checkpoint in the directory.
    every
        Seconds between two writes.

    Attributes
    ----------
    due
        Whether the running algorithm has to `save` its state now; the same on all ranks.
    """

    def __init__(
        self, directory: Path, comm: MPI.Intracomm, resume: bool, every: float = EVERY_SECONDS
    ) -> None:
        self.comm, self.every, self.resume = comm, every, resume
        self.path = directory / CHECKPOINT
        self.due = False
        self._written = time.monotonic()
        self._held: Restart | None = None
        self._description: dict[str, float] | None = None

    @property
    def exists(self) -> bool:
        """Whether a checkpoint to resume from exists, as rank 0 sees it (not collective)."""
        return self.resume and self.path.is_file()

    @property
    def overdue(self) -> bool:
        """Whether the next checkpoint is due, by the clock of this rank (not collective)."""
        return time.monotonic() - self._written >= self.every

    def load(self, size: int, description: dict[str, float]) -> Restart | None:
        """The state to go on from; None without a checkpoint or if `resume` is false.

        Parameters
        ----------
        size
            Rows of this rank.
        description
            Numbers that identify the problem, equal on all ranks.

        Raises
        ------
        CheckpointError
            The checkpoint belongs to another problem, or cannot be read.
        """
        self._description = description
        saved = self._read(description) if self.comm.rank == 0 else None
        saved = self.comm.bcast(saved)
        if isinstance(saved, CheckpointError):
            raise saved
        if saved is None:
            return None
        try:
            path = self.path.with_name(saved["vectors"])
            x, multiplier = read_vectors(path, self.comm, size, 2)
            state = saved["state"]
            state["lagrangian"] = -math.inf if state["lagrangian"] is None else state["lagrangian"]
            state["counts"] = Counts(**state["counts"])
            return Restart(**{**state, "sizes": tuple(state["sizes"])}, x=x, multiplier=multiplier)
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise CheckpointError(self._unreadable(error)) from error

    def _read(self, description: dict[str, float]) -> dict[str, Any] | CheckpointError | None:
        """Rank 0: the scalars of the checkpoint, or why they cannot be used."""
        if not self.exists:
            return None
        try:
            saved: dict[str, Any] = json.loads(self.path.read_text(encoding="utf-8"))
            saved_description, ranks = saved["problem"], saved["ranks"]
            if ranks != self.comm.size:
                return CheckpointError(
                    f"{self.path}: the checkpoint was written on {ranks} ranks, and on "
                    f"{self.comm.size} its rows have another order; resume on as many ranks, or "
                    "run without --resume"
                )
            if set(description) == set(saved_description) and all(
                math.isclose(
                    description[name], saved_description[name], rel_tol=SAME, abs_tol=1e-300
                )
                for name in description
            ):
                return saved
        except (OSError, KeyError, TypeError, ValueError) as error:
            return CheckpointError(self._unreadable(error))
        return CheckpointError(
            f"{self.path}: the checkpoint is of another problem (its scene, mesh or "
            "decomposition differ); run without --resume, or into another directory"
        )

    def _unreadable(self, error: Exception) -> str:
        return f"{self.path}: no readable checkpoint: {error}; run without --resume"

    def save(self, state: Restart) -> None:
        """Write a state; a failure to write is logged and does not end the run."""
        self._held, self.due = None, False
        self._written = time.monotonic()
        try:
            self._write(state)
        except OSError as error:
            if self.comm.rank == 0:
                log.warning("no checkpoint could be written: %s", error)

    def hold(self, state: Restart) -> None:
        """Remember the final state of a solve, for `save_held` (not collective).

        Vectors are not copied: the caller leaves them as they are.
        """
        self._held = state

    def save_held(self) -> None:
        """Write the remembered state, if no other state has been written since."""
        if self._held is not None:
            self.save(self._held)

    def remove(self) -> None:
        """Remove the checkpoint: the run has ended."""
        self._held = None
        if self.comm.rank == 0:
            remove_checkpoint(self.path.parent)

    def _write(self, state: Restart) -> None:
        if self._description is None:
            return
        previous = sorted(self.path.parent.glob(VECTORS))
        path = self.path.with_name(self.comm.bcast(_next_name(previous)))
        write_vectors(path, self.comm, [state.x, state.multiplier])
        scalars = {k: v for k, v in state.__dict__.items() if k not in ("x", "multiplier")}
        scalars["counts"] = asdict(state.counts)
        scalars["lagrangian"] = state.lagrangian if math.isfinite(state.lagrangian) else None
        text = {
            "problem": self._description, "ranks": self.comm.size, "vectors": path.name,
            "state": scalars,
        }  # fmt: skip
        fault = None
        if self.comm.rank == 0:
            try:
                part = _part(self.path)
                part.write_text(json.dumps(text, indent=2) + "\n", encoding="utf-8")
                part.replace(self.path)
                stale = previous
            except OSError as error:
                fault, stale = error, [path, _part(self.path)]
            for old in stale:
                old.unlink(missing_ok=True)
        fault = self.comm.bcast(fault)
        if fault is not None:
            raise fault


class Attention:
    """A monitor that decides at each step whether to stop and whether to save (collective).

    One sum over the ranks serves both: any rank may have been asked to stop, and rank 0 has the
    clock. At a stop the state is saved, too.

    Parameters
    ----------
    interrupted
        Whether this rank was asked to stop.
    """

    STOP, SAVE = 1, 2

    def __init__(
        self, comm: MPI.Intracomm, interrupted: Callable[[], bool], checkpoint: Checkpoint
    ) -> None:
        self._comm, self._interrupted, self._checkpoint = comm, interrupted, checkpoint

    def __call__(self, event: Step) -> bool:
        """Whether to stop."""
        requests = self.STOP if self._interrupted() else 0
        if self._comm.rank == 0 and self._checkpoint.overdue:
            requests |= self.SAVE
        agreed = self._comm.allreduce(requests, op=MPI.BOR)
        self._checkpoint.due = bool(agreed)
        return bool(agreed & self.STOP)


class Saver:
    """Save the state of an algorithm when that is due, with the work done so far.

    Parameters
    ----------
    checkpoint
        None where nothing is saved.
    before
        Work done before this algorithm.
    """

    def __init__(self, checkpoint: Checkpoint | None, before: Counts | None = None) -> None:
        self._checkpoint, self._before = checkpoint, before or Counts()

    @property
    def due(self) -> bool:
        """Whether a state is wanted at this step; the same on all ranks."""
        return self._checkpoint is not None and self._checkpoint.due

    def __call__(self, state: Restart) -> None:
        """Save a state, if one is wanted (collective)."""
        if self._checkpoint is not None and self._checkpoint.due:
            self._checkpoint.save(replace(state, counts=self._before + state.counts))

    def after(self, counts: Counts) -> "Saver":
        """A saver for an algorithm that begins after more work."""
        return Saver(self._checkpoint, self._before + counts)


def without_outer_iterations(multiplier: Array, touching: Mask, counts: Counts) -> Restart:
    """State of an algorithm without outer iterations.

    Parameters
    ----------
    multiplier : (dual,)
        λ.
    touching : (dual,)
        Active contact rows.
    """
    rows = touching.astype(np.float64)
    return Restart(0, multiplier, rows, 0.0, 0.0, 0.0, -math.inf, (), counts)


def remove_checkpoint(directory: Path) -> None:
    """Remove a checkpoint with its vectors."""
    path = directory / CHECKPOINT
    for file in (path, _part(path), *directory.glob(VECTORS)):
        file.unlink(missing_ok=True)


def _part(path: Path) -> Path:
    """Name of the file of scalars while it is being written."""
    return path.with_name(f".{path.name}.part")


def _next_name(previous: list[Path]) -> str:
    """Name of the next file of vectors: no existing file is written over."""
    numbers = [int(file.stem.split("-")[1]) for file in previous if file.stem[11:].isdigit()]
    return VECTORS.replace("*", str(max(numbers, default=0) + 1))
