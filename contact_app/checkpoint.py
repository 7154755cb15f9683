"""What a stopped run leaves to go on from: the state at the end of its last outer iteration.

Two files: the vectors in PETSc's binary format, written by all ranks together and independent of
how many there are, and the scalars in JSON, written last and put in place at once, so that a run
killed while it writes leaves the checkpoint before it whole.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from contact_app.errors import ConfigurationError
from solver import Counts
from solver.smalbe import Restart
from solver.tfeti.constraints import RowKind
from solver.tfeti.dual import DualProblem
from solver.tfeti.matrix import lent

EVERY_SECONDS = 10.0
"""Least time between two checkpoints; outer iterations may be much shorter."""

SAME = 1e-6
"""Relative difference up to which the numbers that describe a problem are those of the same."""


class Checkpoint:
    """Writes, reads and removes the checkpoint of one run; all calls but the first are collective.

    Parameters
    ----------
    directory
        Where ``checkpoint.json`` and its vectors live.
    resume
        Whether a checkpoint found there is gone on from.
    every
        Least seconds between two writes.
    """

    def __init__(
        self, directory: Path, comm: MPI.Intracomm, resume: bool, every: float = EVERY_SECONDS
    ) -> None:
        self.comm, self.every, self.resume = comm, every, resume
        self.path = directory / "checkpoint.json"
        self._written = time.monotonic()
        self._pending: Restart | None = None
        self._problem: DualProblem | None = None

    @property
    def found(self) -> bool:
        """Whether a wanted checkpoint is there, as rank 0 sees it (not collective)."""
        return self.resume and self.path.is_file()

    def load(self, problem: DualProblem) -> Restart | None:
        """The state to go on from; None where there is none or none is wanted.

        Raises
        ------
        ConfigurationError
            The checkpoint belongs to another problem, or cannot be read.
        """
        self._problem = problem
        if not self.comm.bcast(self.found):
            return None
        try:
            saved = json.loads(self.path.read_text(encoding="utf-8"))
            here, there = _description(problem), saved["problem"]
            if set(here) != set(there) or not all(
                math.isclose(here[name], there[name], rel_tol=SAME, abs_tol=1e-300) for name in here
            ):
                raise ConfigurationError(
                    f"{self.path}: the checkpoint is of another problem (its scene, mesh or "
                    "decomposition differ); run without --resume, or into another directory"
                )
            viewer = PETSc.Viewer().createBinary(
                str(self.path.with_name(saved["vectors"])), mode="r", comm=self.comm
            )
            x, multiplier = np.empty(problem.size), np.empty(problem.size)
            for values in (x, multiplier):
                with lent(self.comm, values) as (vector,):
                    vector.load(viewer)
            viewer.destroy()
            state = saved["state"]
            state["lagrangian"] = -math.inf if state["lagrangian"] is None else state["lagrangian"]
            state["counts"] = Counts(**state["counts"])
            return Restart(**{**state, "sizes": tuple(state["sizes"])}, x=x, multiplier=multiplier)
        except (OSError, KeyError, TypeError, ValueError, PETSc.Error) as error:
            raise ConfigurationError(f"{self.path}: no readable checkpoint: {error}") from error

    def __call__(self, state: Restart) -> None:
        """Keep the state; write it when the last one on disk is old enough."""
        self._pending = Restart(
            **{**state.__dict__, "x": state.x.copy(), "multiplier": state.multiplier.copy()}
        )
        if self.comm.bcast(time.monotonic() - self._written >= self.every):
            self.write()

    def write(self) -> None:
        """Write the last state, unless it is on disk already."""
        state, problem = self._pending, self._problem
        if state is None or problem is None:
            return
        vectors = f"checkpoint-{state.outer}.petsc"
        previous = sorted(self.path.parent.glob("checkpoint-*.petsc"))
        viewer = PETSc.Viewer().createBinary(
            str(self.path.with_name(vectors)), mode="w", comm=self.comm
        )
        for values in (state.x, state.multiplier):
            with lent(self.comm, values) as (vector,):
                vector.view(viewer)
        viewer.destroy()
        scalars = {k: v for k, v in state.__dict__.items() if k not in ("x", "multiplier")}
        scalars["counts"] = asdict(state.counts)
        scalars["lagrangian"] = state.lagrangian if math.isfinite(state.lagrangian) else None
        description = _description(problem)
        if self.comm.rank == 0:
            text = {"problem": description, "vectors": vectors, "state": scalars}
            new = self.path.with_suffix(".new")
            new.write_text(json.dumps(text, indent=2) + "\n", encoding="utf-8")
            new.replace(self.path)
            for old in previous:
                if old.name != vectors:
                    old.unlink()
            for info in self.path.parent.glob("checkpoint-*.petsc.info"):
                info.unlink()
        self._pending = None
        self._written = time.monotonic()

    def remove(self) -> None:
        """Nothing is left to go on from."""
        self._pending = None
        if self.comm.rank == 0:
            for file in (self.path, *self.path.parent.glob("checkpoint-*.petsc")):
                file.unlink(missing_ok=True)


def _description(problem: DualProblem) -> dict[str, float]:
    """Numbers that tell one dual problem from another, the same on any number of ranks."""
    squares = problem.comm.allreduce(
        np.array(
            [problem.size, problem.c @ problem.c, problem.d @ problem.d, problem.e @ problem.e]
        )
    )
    kinds = {kind.name.lower(): float(problem.count(kind)) for kind in RowKind}
    return {**kinds, **dict(zip(("rows", "c", "d", "e"), map(float, squares), strict=True))}
