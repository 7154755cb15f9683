"""The checkpoint of a load history, from which ``--resume`` goes on.

It is written after each increment. One file has the displacements at the end of the increment, from
which slip is measured and with which the next increment begins. ``checkpoint.json`` has the
position in the history and the records of all increments. It is written last and renamed into
place, so that a run killed while it writes leaves the previous checkpoint intact. A resumed scene
must have the same bodies, conditions and contacts, and the same finished or begun steps up to the
number of increments; later steps may change.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.machine.atomic_file import atomic
from contact_app.machine.ranks import on_first
from contact_app.model.normal_forces import NormalForces, Stored
from contact_app.results.report import log, plain
from contact_app.run.increments import Position
from contact_app.run.step_records import Record
from contact_app.scene.scene import Decomposition
from meshes.arrays import Array
from solver.contact.checkpoint import CHECKPOINT, remove_checkpoint
from solver.contact.options import Method
from solver.contact.vector_file import read_vectors, write_vectors

Displacements = list[Array]


@dataclass(frozen=True, eq=False)
class Reached:
    """State of an earlier run."""

    position: Position
    records: list[Record]
    last: Record
    """The summary of the last increment."""
    vectors: Path
    """File of the displacements."""
    subdomains: None | int | list[int]
    method: Method
    """Decomposition and method of the model that the displacements belong to."""
    pressed: Stored
    """Normal forces."""

    @property
    def decomposition(self) -> Decomposition:
        """The decomposition of that state."""
        several = self.subdomains
        return Decomposition(tuple(several) if isinstance(several, list) else several)

    def displacements(self, shapes: list[tuple[int, int]], comm: MPI.Intracomm) -> Displacements:
        """The displacements of that state, (n, members) for each class (collective).

        Raises
        ------
        ConfigurationError
            The displacements belong to another mesh, or cannot be read.
        """
        sizes = [n * members for n, members in shapes]
        try:
            (flat,) = read_vectors(self.vectors, comm, sum(sizes), 1)
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"{self.vectors}: no readable checkpoint: {error}; run without --resume"
            ) from error
        ends = np.cumsum(sizes)[:-1]
        parts = np.split(flat, ends)
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


class StepCheckpoint:
    """Writes, reads and removes the checkpoint of a load history; methods are collective."""

    def __init__(
        self, directory: Path, digest_of: Callable[[int], str], comm: MPI.Intracomm
    ) -> None:
        """`digest_of` is `Scene.digest`."""
        self._path, self._digest_of, self._comm = directory / CHECKPOINT, digest_of, comm

    def read(self) -> Reached | None:
        """The state of an earlier run in the directory; None if there is none.

        Raises
        ------
        ConfigurationError
            The checkpoint belongs to another scene or number of ranks, or cannot be read.
        """
        return on_first(self._comm, self._read)

    def _read(self) -> Reached | None:
        """The stored position; None without a file. Refuses files of other scenes or ranks."""
        if not self._path.is_file():
            return None
        try:
            saved = json.loads(self._path.read_text(encoding="utf-8"))
            position = saved["position"]
            at = Position(
                position["step"], Fraction(position["share"]), position["number"],
                position["dissipated"],
            )  # fmt: skip
            if saved["ranks"] != self._comm.size:
                raise ConfigurationError(
                    f"{self._path}: the checkpoint was written on {saved['ranks']} ranks, and on "
                    f"{self._comm.size} its displacements have another order; resume on as many "
                    "ranks, or run without --resume"
                )
            if saved["scene"] != self._digest_of(at.step):
                raise ConfigurationError(
                    f"{self._path}: the checkpoint is of another scene (bodies, conditions, "
                    "contacts, or the steps up to there differ); run without --resume, or into "
                    "another directory"
                )
            vectors = self._path.with_name(saved["vectors"])
            model = saved["subdomains"], saved["method"], saved["pressed"]
            return Reached(at, saved["records"], saved["last"], vectors, *model)
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(
                f"{self._path}: no readable checkpoint: {error}; run without --resume"
            ) from error

    def write(self, at: Position, records: list[Record], last: Record, solved: SolvedScene) -> None:
        """Write the checkpoint; a failure to write is logged and does not end the run.

        Parameters
        ----------
        solved
            The last increment.
        """
        model, solution = solved.model, solved.solution
        vectors = self._path.with_name(f"checkpoint-{at.number}.vectors")
        flat = np.concatenate([np.zeros(0), *(u.ravel() for u in solution.displacements)])
        saved = {
            "position": {**vars(at), "share": str(at.share)},
            "ranks": self._comm.size,
            "scene": self._digest_of(at.step),
            "vectors": vectors.name,
            "subdomains": model.scene.decomposition.subdomains,
            "method": model.scene.solver.method,
            "pressed": NormalForces.of(model.problem, solution).stored(self._comm),
            "last": last,
            "records": records,
        }

        def scalars() -> None:
            with atomic(self._path) as part:
                part.write_text(json.dumps(plain(saved)) + "\n", encoding="utf-8")
            for old in self._path.parent.glob("checkpoint-*.vectors"):
                if old != vectors:
                    old.unlink()

        try:
            write_vectors(vectors, self._comm, [flat])
            on_first(self._comm, scalars)
        except OSError as error:
            if self._comm.rank == 0:
                log.warning("no checkpoint could be written: %s", error)

    def remove(self) -> None:
        """Remove the checkpoint: the history has ended."""
        if self._comm.rank == 0:
            remove_checkpoint(self._path.parent)
