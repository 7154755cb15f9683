"""Run a scene: model, solve, certify, write."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from contact_app.errors import ConfigurationError, CouldNotRunError
from contact_app.machine.exits import Exit, add_remedy, print_message
from contact_app.results.history import History
from contact_app.results.report import log, print_summary, run_log
from contact_app.run.communication import on_first
from contact_app.run.files import (
    log_caches,
    log_model,
    log_model_that_fits,
    part_that_is_solved,
    without_parts,
    write_run,
)
from contact_app.run.progress import Interruption, Progress, together
from contact_app.run.result_directory import clear
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from solver.contact.checkpoint import EVERY_SECONDS, Attention, Checkpoint
from solver.qp.result import Reason

if TYPE_CHECKING:
    from contact_app.accuracy.refine.levels import Refined
    from contact_app.accuracy.refine.refinement import Solve


def run(
    scene: Scene,
    directory: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    resume: bool = False,
    every: float = EVERY_SECONDS,
) -> int:
    """Solve a scene, show progress, write its files; return the exit code (collective).

    The results of an earlier run in the directory are removed first. After an interruption (Ctrl-C
    or SIGTERM) the solve stops at its next step with a checkpoint, and its last iterate is
    recovered, measured by a certificate and written.

    Parameters
    ----------
    resume
        Whether to go on from the checkpoint of an earlier run in the directory, if there is one.
    every
        Seconds of solving between two checkpoints.
    """
    if scene.loadings:
        return _run_of_loadings(scene)(scene, directory, comm, resume, every)
    first = comm.rank == 0
    if resume and scene.accuracy is not None:
        raise ConfigurationError(
            f"{scene.at('accuracy')}: a run to an accuracy leaves no checkpoint to resume from; "
            "start it anew"
        )
    on_first(comm, lambda: clear(directory, resume))
    checkpoint = Checkpoint(directory, comm, resume, every)
    with (
        without_parts(directory),
        run_log(directory / "run.log", first),
        Progress(first) as progress,
        History(directory / "history.csv" if first else None, checkpoint.found) as history,
        Interruption() as interruption,
    ):
        log_caches()
        attention = Attention(comm, lambda: interruption.requested, checkpoint)
        monitor = together(progress, history, attention)
        if resume:
            progress.stage(
                f"going on from {checkpoint.path}"
                if checkpoint.found
                else f"no checkpoint in {directory}: starting from the beginning"
            )
        scene = part_that_is_solved(scene)
        progress.stage(f"modelling {scene.title or scene.source.name}")
        refined = None
        if scene.accuracy is None:
            report = partial(log_model_that_fits, directory=directory)
            solved = solve_scene(scene, comm, monitor, checkpoint, report)
        else:
            solve_level = partial(solve_scene, comm=comm, monitor=monitor, report=log_model)
            refined = _to_accuracy(
                scene, solve_level, progress, lambda: interruption.requested_by_any(comm)
            )
            solved = refined.solved
        solution = solved.solution
        stopped = solution.reason is Reason.STOPPED and not solution.converged and refined is None
        # save the state of a long solve before its results are written
        if stopped or comm.bcast(solved.timings.seconds["solve"] > checkpoint.every):
            checkpoint.save_held()
        try:
            summary, files = write_run(solved, refined, directory, progress)
        except (OSError, CouldNotRunError) as error:
            if checkpoint.path.is_file():
                add_remedy(error, "--resume goes on from the checkpoint of this run")
            raise
        if not stopped:
            checkpoint.remove()
        elif first and checkpoint.path.is_file():
            log.info("--resume goes on from here")
    if first:
        _print(summary, solution.tolerance, files)
    reached = refined is None or not refined.missed
    reached &= solved.guaranteed is None or not solved.guaranteed.missing
    return Exit.CERTIFIED if solved.solution.converged and reached else Exit.NOT_CERTIFIED


def _to_accuracy(
    scene: Scene, solve_level: Solve, progress: Progress, stop: Callable[[], bool]
) -> Refined:
    """The answer on meshes refined to the requested accuracy (collective)."""
    from contact_app.accuracy.refine.refinement import solve_to_accuracy

    return solve_to_accuracy(scene, solve_level, progress.stage, stop=stop)


def _run_of_loadings(scene: Scene) -> Callable[[Scene, Path, MPI.Intracomm, bool, float], int]:
    """The function that runs load cases, or a load history."""
    if scene.cases:
        from contact_app.run.cases import run_cases

        return run_cases
    from contact_app.run.steps import run_steps

    return run_steps


def _print(summary: dict[str, Any], tolerance: float, files: list[Path]) -> None:
    """Print the summary; an error of the terminal does not end the run."""
    try:
        print_summary(summary, tolerance, files)
    except OSError as error:
        print_message(
            f"the summary could not be printed ({error.strerror}); {files[0].parent} has it"
        )
