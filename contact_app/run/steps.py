"""Run a load history: solve its increments, and write the files of each as soon as it is solved."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from contact_app.machine.exits import Exit, print_message
from contact_app.machine.ranks import on_first
from contact_app.model.normal_forces import NormalForces
from contact_app.results.history import History
from contact_app.results.output import write_fields
from contact_app.results.report import log, print_steps, write_summary
from contact_app.results.result_size import file_names
from contact_app.results.series import Series
from contact_app.run.attended import Attended, attended
from contact_app.run.files import (
    exit_of,
    log_model,
    log_model_that_fits,
    part_that_is_solved,
    printed,
)
from contact_app.run.increment_models import IncrementModels
from contact_app.run.increments import (
    Place,
    Position,
    SolvedIncrement,
    between_factors,
    solved_increments,
)
from contact_app.run.progress import together
from contact_app.run.refined_steps import RefinedHistory, history_to_accuracy
from contact_app.run.step_checkpoint import StepCheckpoint
from contact_app.run.step_records import Record, record_of, summary_of_steps, write_table
from contact_app.scene.scene import Scene
from solver.contact.checkpoint import EVERY_SECONDS
from solver.qp.result import Monitor


def run_steps(
    scene: Scene,
    directory: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    resume: bool = False,
    every: float = EVERY_SECONDS,
) -> int:
    """Solve all steps, write the files of each increment; return the exit code (collective).

    After an interruption the present increment is dropped, and ``--resume`` goes on from the last
    finished one. Parameters are those of `run.run`.
    """
    first = comm.rank == 0
    with attended(directory, comm, resume, every) as run:
        scene = part_that_is_solved(scene)
        files = _Files(scene, directory, comm, resume)
        if resume and not files.is_resumed:
            run.progress.stage(f"no checkpoint in {directory}: starting from the beginning")
        with History(
            directory / "history.csv" if first else None, files.is_resumed, increments=True
        ) as history:
            solve = _solve_and_write if scene.accuracy is None else _refine_and_write
            code = solve(files, run, history)
    summary = files.summary
    if first and summary is not None:
        paths = [*files.paths, directory / "run.log"]
        printed(lambda: print_steps(summary, paths), directory)
    if first and files.end:
        print_message(files.end)
    return code


class _Files:
    """The files of a load history; methods are collective.

    Attributes
    ----------
    is_resumed
        Whether the run goes on from an earlier one.
    summary
        Content of ``summary.json``; None before the first increment is solved.
    paths
        Of all files but the log.
    end
        Message on the place at which a history ends early; empty if it does not.
    """

    def __init__(self, scene: Scene, directory: Path, comm: MPI.Intracomm, resume: bool) -> None:
        self.scene, self.directory, self.comm = scene, directory, comm
        self._checkpoint = StepCheckpoint(directory, scene.digest, comm)
        self.reached = self._checkpoint.read() if resume else None
        self.is_resumed = self.reached is not None
        self.records: list[Record] = []
        self.summary: dict[str, Any] | None = None
        self.series, self.paths, self.end = Series(), list[Path](), ""
        if self.reached is not None:
            self.records = self.reached.records
            self.summary = summary_of_steps(self.reached.last, self.records)
            self.series = Series.resumed(directory, [record["time"] for record in self.records])

    @property
    def position(self) -> Position:
        """Position at which the history begins."""
        return self.reached.position if self.reached is not None else Position()

    def add(self, increment: SolvedIncrement) -> None:
        """Write an increment, and the state from which the next one begins."""
        solved = increment.solved
        last = {**solved.summary, "steps": None}
        self.write(increment)
        self.summary = summary_of_steps(last, self.records)
        on_first(self.comm, self._write_texts)
        if solved.solution.converged:
            place = increment.place
            at = Position(place.step, place.share, place.number, increment.dissipated)
            self._checkpoint.write(at, self.records, last, solved)

    def add_all(self, history: RefinedHistory) -> None:
        """Write the increments on the last mesh of a run to an accuracy."""
        for increment in history.increments:
            self.write(increment)
        self.records, self.summary = history.records, history.summary
        on_first(self.comm, self._write_texts)

    def write(self, increment: SolvedIncrement) -> None:
        """Write the fields of an increment, and add its record."""
        solved, directory = increment.solved, self.directory
        self.series.begin(increment.place.time)
        paths: list[Path] = []
        if file_names(solved.model.scene.output):
            with solved.timings.measure("output"):
                paths = write_fields(solved.model, solved.fields, directory, self.series)
        self.records.append(record_of(increment))
        names = ("summary.json", "increments.csv", "history.csv")
        self.paths = [*paths, *(directory / name for name in names)]

    def finish(self) -> None:
        """Remove the checkpoint: the history has reached its end."""
        self._checkpoint.remove()

    def _write_texts(self) -> None:
        assert self.summary is not None
        write_table(self.directory / "increments.csv", self.records)
        write_summary(self.directory / "summary.json", self.summary)


def _monitors(files: _Files, run: Attended, history: History) -> Callable[[Place], Monitor]:
    """The function that returns the monitor of an increment, and shows its place."""
    progress, steps = run.progress, files.scene.steps
    count = sum(step.increments for step in steps)
    monitor = together(progress, history, run.attention)

    def monitor_of(place: Place) -> Monitor:
        halved = ", halved" * (place.halved > 0)
        progress.stage(
            f"step {place.step} of {len(steps)}, factor {float(place.share):.6g}{halved} "
            f"(increment {place.number} of {max(count, place.number)})"
        )
        history.increment = place.number
        return monitor

    return monitor_of


def _refine_and_write(files: _Files, run: Attended, history: History) -> int:
    """Solve the history to an accuracy, then write it; return the exit code (collective)."""
    comm = files.comm
    stop = partial(run.interruption.requested_by_any, comm)
    rest = _monitors(files, run, history), log_model, run.progress.stage, stop
    refined = history_to_accuracy(files.scene, comm, *rest)
    run.progress.stage("writing")
    files.add_all(refined)
    if comm.rank == 0:
        for warning in refined.summary["certificate"]["warnings"]:
            log.warning("%s", warning)
    return Exit.CERTIFIED if refined.certified else Exit.NOT_CERTIFIED


def _solve_and_write(files: _Files, run: Attended, history: History) -> int:
    """Solve the increments and write each; return the exit code (collective)."""
    scene, comm, progress = files.scene, files.comm, run.progress
    monitor_of = _monitors(files, run, history)
    models = IncrementModels(scene, comm)
    if files.reached is not None:
        progress.stage(
            f"going on after step {files.position.step}, factor {float(files.position.share):.6g}"
        )
        reached = files.reached
        scene = models.following(scene, reached.decomposition, reached.method)
        loaded = scene.loaded_at(files.position.step - 1, float(files.position.share))
        pressed = NormalForces.read(reached.pressed, comm.rank)
        models.go_on(loaded.rigid, lambda shapes: reached.displacements(shapes, comm), pressed)
    report = partial(log_model_that_fits, directory=files.directory)
    over, code, failed = files.position, Exit.CERTIFIED, ""
    for increment in solved_increments(scene, comm, monitor_of, report, models, over):
        solved = increment.solved
        if solved.interrupted and files.records:
            break
        files.add(increment)
        if comm.rank == 0:
            log.info("%s", _sentence(files.records[-1]))
        if not solved.solution.converged:
            failed = _failure(increment, over)
            code = exit_of(solved)
            break
        code = max(code, exit_of(solved))
        over = replace(over, step=increment.place.step, share=increment.place.share)
        if run.interruption.requested_by_any(comm):  # a solve of one step ends before it is asked
            break
    if over.step == len(scene.steps) and over.share == 1:
        files.finish()
        return code
    files.end = f"{failed}{_end(over)}"
    if comm.rank == 0:
        log.warning("%s", files.end)
    return max(code, Exit.NOT_CERTIFIED)


def _failure(increment: SolvedIncrement, over: Position) -> str:
    """Message why the history ends at an increment; empty if the user stopped it."""
    if increment.solved.interrupted:
        return ""
    place = increment.place
    if exit_of(increment.solved) is Exit.NO_EQUILIBRIUM:
        begin = over.share if over.step == place.step else 0.0
        overcome = "; ".join(increment.solved.overcome)
        return f"{between_factors(place.step, begin, place.share)}: {overcome}; "
    return (
        f"step {place.step}: the increment to factor {float(place.share):.6g} has no certified "
        f"answer, though it was halved {place.halved} times; "
    )


def _end(over: Position) -> str:
    """Message on the place at which an unfinished history ends."""
    if over.step == 1 and over.share == 0:
        return "the history ends in its first increment: there is no checkpoint to resume from"
    return (
        f"the history ends after step {over.step}, factor {float(over.share):.6g}; --resume goes "
        "on from there"
    )


def _sentence(record: Record) -> str:
    """An increment in a line of the log."""
    return (
        f"step {record['step']}, factor {record['factor']:.6g}: "
        f"{record['solver']['hessian_multiplications']} Hessian multiplications, largest "
        f"displacement {record['solution']['max_displacement']:.6g}, "
        f"{'certified' if record['certificate']['passed'] else 'not certified'}"
    )
