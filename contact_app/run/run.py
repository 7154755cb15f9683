"""Run a scene: model, solve, certify, write."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.machine.exits import Exit
from contact_app.results.history import History
from contact_app.results.report import log, print_summary
from contact_app.run.attended import attended
from contact_app.run.files import (
    exit_of,
    log_model,
    log_model_that_fits,
    part_that_is_solved,
    printed,
    write_run,
)
from contact_app.run.progress import together
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import LoadCase, Scene
from solver.contact.checkpoint import EVERY_SECONDS


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
    if resume and scene.accuracy is not None:
        raise ConfigurationError(
            f"{scene.at('accuracy')}: a run to an accuracy leaves no checkpoint to resume from; "
            "start it anew"
        )
    if scene.loadings:
        return _run_of_loadings(scene.cases)(scene, directory, comm, resume, every)
    first = comm.rank == 0
    with (
        attended(directory, comm, resume, every, saves=True) as run,
        History(directory / "history.csv" if first else None, run.checkpoint.exists) as history,
    ):
        progress, checkpoint = run.progress, run.checkpoint
        monitor = together(progress, history, run.attention)
        if resume:
            progress.stage(
                f"going on from {checkpoint.path}"
                if checkpoint.exists
                else f"no checkpoint in {directory}: starting from the beginning"
            )
        scene = part_that_is_solved(scene)
        progress.stage(f"modelling {scene.title or scene.source.name}")
        refined = None
        if scene.accuracy is None:
            report = partial(log_model_that_fits, directory=directory)
            solved = solve_scene(scene, comm, monitor, checkpoint, report)
        else:
            from contact_app.accuracy.refine.refinement import solve_to_accuracy

            solve_level = partial(solve_scene, comm=comm, monitor=monitor, report=log_model)
            stop = partial(run.interruption.requested_by_any, comm)
            refined = solve_to_accuracy(scene, solve_level, progress.stage, stop=stop)
            solved = refined.solved
        stopped = solved.interrupted and refined is None
        # save the state of a long solve before its results are written
        if stopped or comm.bcast(solved.timings.seconds["solve"] > checkpoint.every):
            checkpoint.save_held()
        summary, files = write_run(solved, refined, directory, progress)
        if not stopped:
            checkpoint.remove()
        elif first and checkpoint.path.is_file():
            log.info("--resume goes on from here")
    if first:
        printed(lambda: print_summary(summary, solved.solution.tolerance, files), directory)
    missed = refined is not None and refined.missed
    return Exit.NOT_CERTIFIED if solved.certified and missed else exit_of(solved)


def _run_of_loadings(
    cases: Sequence[LoadCase],
) -> Callable[[Scene, Path, MPI.Intracomm, bool, float], int]:
    """The function that runs load cases; without any, the one that runs a load history."""
    if cases:
        from contact_app.run.cases import run_cases

        return run_cases
    from contact_app.run.steps import run_steps

    return run_steps
