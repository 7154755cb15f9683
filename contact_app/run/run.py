"""Run a scene: model, solve, certify, write."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed
from contact_app.accuracy.refine.refinement import Refined, solve_to_accuracy, with_levels
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError, CouldNotRunError
from contact_app.machine.caches import usable_caches
from contact_app.machine.disk import refuse_without_room
from contact_app.machine.exits import Exit, add_remedy
from contact_app.machine.exits import tell as say
from contact_app.model.outline import Outline
from contact_app.model.symmetry import halved
from contact_app.results.history import History
from contact_app.results.output import write_xdmf
from contact_app.results.report import log, print_summary, run_log, write_summary
from contact_app.results.result_size import result_bytes
from contact_app.run.check import modelled_lines
from contact_app.run.communication import on_first
from contact_app.run.progress import Interruption, Progress, together
from contact_app.run.repeated_sentences import said_once
from contact_app.run.result_directory import clear, remove_parts
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from solver.contact.checkpoint import EVERY_SECONDS, Attention, Checkpoint
from solver.qp.result import Reason


def run(
    scene: Scene,
    directory: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    resume: bool = False,
    every: float = EVERY_SECONDS,
) -> int:
    """Solve a scene, show progress, write everything to a directory; the exit code (collective).

    The results of an earlier run in the directory are removed first. Interrupted (Ctrl-C or
    SIGTERM) the solve stops at its next step with a checkpoint, and what it has reached is
    recovered, certified and written.

    Parameters
    ----------
    resume
        Go on from the checkpoint an earlier run left in the directory, if there is one.
    every
        Seconds of solving between two checkpoints.
    """
    first = comm.rank == 0
    if resume and scene.accuracy is not None:
        raise ConfigurationError(
            f"{scene.at('accuracy')}: a run to an accuracy leaves no checkpoint to resume from; "
            "start it anew"
        )
    on_first(comm, lambda: clear(directory, resume))
    checkpoint = Checkpoint(directory, comm, resume, every)
    with (
        _without_parts(directory),
        run_log(directory / "run.log", first),
        Progress(first) as progress,
        History(directory / "history.csv" if first else None, checkpoint.found) as history,
        Interruption() as interruption,
    ):
        for sentence in usable_caches():
            log.info("%s", sentence)
        attention = Attention(comm, lambda: interruption.asked, checkpoint)
        monitor = together(progress, history, attention)
        if resume:
            progress.stage(
                f"going on from {checkpoint.path}"
                if checkpoint.found
                else f"no checkpoint in {directory}: starting from the beginning"
            )
        scene = _part_that_is_solved(scene)
        progress.stage(f"modelling {scene.title or scene.source.name}")
        refined = None
        if scene.accuracy is None:
            tell = partial(_log_model_that_fits, directory=directory)
            solved = solve_scene(scene, comm, monitor, checkpoint, tell)
        else:
            once = partial(solve_scene, comm=comm, monitor=monitor, tell=_log_model)
            refined = solve_to_accuracy(scene, once, progress.stage)
            solved = refined.solved
        solution = solved.solution
        stopped = solution.reason is Reason.STOPPED and not solution.converged and refined is None
        # a long solve is safe before its results meet the disk
        if stopped or comm.bcast(solved.timings.seconds["solve"] > checkpoint.every):
            checkpoint.save_held()
        try:
            summary, files = _write(solved, refined, directory, progress)
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


def _print(summary: dict[str, Any], tolerance: float, files: list[Path]) -> None:
    """Print the summary; a terminal that is gone does not end the run."""
    try:
        print_summary(summary, tolerance, files)
    except OSError as error:
        say(f"the summary could not be printed ({error.strerror}); {files[0].parent} has it")


def _part_that_is_solved(scene: Scene) -> Scene:
    """The half, quarter or eighth of a scene that mirrors, if that is asked for; else all of it."""
    if not scene.symmetry:
        return scene
    halving = halved(scene)
    for note in halving.notes:
        log.info("%s", note)
    return halving.scene


def _write(
    solved: SolvedScene, refined: Refined | None, directory: Path, progress: Progress
) -> tuple[dict[str, Any], list[Path]]:
    """Write the files of a run; the summary, and the files (collective).

    The summary is written last: where it is, everything is. An error of the disk is raised on all
    ranks.
    """
    comm = solved.model.comm
    bodies = [body.name for body in solved.model.scene.bodies]
    for note in said_once(solved.model.notes, bodies):
        log.info("%s", note)
    files = [directory / name for name in ("summary.json", "history.csv", "run.log")]
    if solved.model.scene.output.xdmf:
        progress.stage("writing")
        with solved.timings.measure("output"):
            write_xdmf(solved.model, solved.nodes, solved.cells, directory / "solution.xdmf")
        files.insert(0, directory / "solution.xdmf")
    summary = {**solved.summary, "timings": solved.timings.as_dict()}
    if refined is not None:
        summary = with_levels(summary, refined)
    if comm.rank == 0:
        for warning in summary["certificate"]["warnings"]:
            log.warning("%s", warning)
    on_first(comm, lambda: write_summary(directory / "summary.json", summary))
    return summary, files


@contextmanager
def _without_parts(directory: Path) -> Iterator[None]:
    """Leave no file that is not whole, whichever rank an exception ends the run on."""
    try:
        yield
    except BaseException:
        remove_parts(directory)
        raise


def _log_model_that_fits(scene: Scene, known: Outline, directory: Path) -> None:
    """As `_log_model`; refuse a result that will not fit on the disk (collective)."""
    _log_model(scene, known)
    if scene.output.xdmf:
        images = 2 ** len(scene.mirrors)
        sizes = images * known.partition.nodes, images * known.partition.cells
        needed = result_bytes(scene, *sizes)
        on_first(
            known.partition.comm,
            lambda: refuse_without_room(directory, "solution.h5", needed),
        )


def _log_model(scene: Scene, known: Outline) -> None:
    """What is modelled and what is left out, as `check` says and refuses it (collective)."""
    refuse_unguaranteed(scene, known.partition)
    for line in modelled_lines(scene, known):
        if line and known.partition.comm.rank == 0:
            log.info("%s", line)
