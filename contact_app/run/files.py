"""Log of the model of a run, and the files of its answer."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.caches import usable_caches
from contact_app.machine.disk import refuse_without_room
from contact_app.machine.exits import Exit, print_message
from contact_app.machine.ranks import on_first
from contact_app.model.outline import Outline
from contact_app.results.output import write_fields
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.results.report import log, write_summary
from contact_app.results.result_size import file_names, result_bytes, wanted_fields
from contact_app.run.model_report import modelled_lines
from contact_app.run.progress import Progress
from contact_app.run.result_directory import remove_parts
from contact_app.scene.scene import Scene
from solver.qp.result import Reason

if TYPE_CHECKING:
    from contact_app.accuracy.refine.levels import Refined


def log_caches() -> None:
    """Log unusable directories for compiled forms, and their replacements."""
    for sentence in usable_caches():
        log.info("%s", sentence)


def part_that_is_solved(scene: Scene) -> Scene:
    """The half, quarter or eighth of a symmetric scene, with `symmetry: allow`; else the scene."""
    if not scene.symmetry:
        return scene
    from contact_app.model.symmetry import halved

    halving = halved(scene)
    for note in halving.notes:
        log.info("%s", note)
    return halving.scene


def exit_of(solved: SolvedScene) -> Exit:
    """The exit code of an answer: without a certificate, whether friction holds (collective)."""
    if solved.certified:
        return Exit.CERTIFIED
    limited = solved.solution.reason in (Reason.STOPPED, Reason.MAX_ITERATIONS)
    return Exit.NOT_CERTIFIED if limited or not solved.overcome else Exit.NO_EQUILIBRIUM


def write_run(
    solved: SolvedScene, refined: "Refined | None", directory: Path, progress: Progress
) -> tuple[dict[str, Any], list[Path]]:
    """Write the files of a run; return the summary and the paths (collective).

    The summary is written last: if it exists, all other files do. An error of the disk is raised on
    all ranks.
    """
    comm = solved.model.comm
    bodies = [body.name for body in solved.model.scene.bodies]
    for note in without_repetitions(solved.model.notes, bodies):
        log.info("%s", note)
    files = [directory / name for name in ("summary.json", "history.csv", "run.log")]
    if file_names(solved.model.scene.output):
        progress.stage("writing")
        with solved.timings.measure("output"):
            files = [*write_fields(solved.model, solved.fields, directory), *files]
    summary = {**solved.summary, "timings": solved.timings.as_dict()}
    if refined is not None:
        from contact_app.accuracy.refine.levels import with_levels

        summary = with_levels(summary, refined)
    if comm.rank == 0:
        for warning in summary["certificate"]["warnings"]:
            log.warning("%s", warning)
    on_first(comm, lambda: write_summary(directory / "summary.json", summary))
    return summary, files


def log_model_that_fits(scene: Scene, outline: Outline, directory: Path) -> None:
    """Run `log_model`, and refuse a result that will not fit on the disk (collective)."""
    log_model(scene, outline)
    names = file_names(scene.output)
    if names:
        images = 2 ** len(scene.mirrors)
        sizes = images * outline.partition.nodes, images * outline.partition.cells
        count = len(scene.cases) or sum(step.increments for step in scene.steps) or 1
        fields = wanted_fields(scene.output, scene.has_friction)
        alone = len(scene.touching) if len(scene.touching) > 1 else 0
        each = result_bytes(scene.bodies, fields, alone, *sizes)
        needed = count * sum(size for key, size in each.items() if getattr(scene.output, key))
        on_first(
            outline.partition.comm,
            lambda: refuse_without_room(directory, names[0].replace("xdmf", "h5"), needed),
        )


def refuse_without_bound(scene: Scene, outline: Outline) -> None:
    """Refuse a scene that cannot have the guaranteed bound that it requests (collective)."""
    if scene.guaranteed:
        from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed

        refuse_unguaranteed(scene, outline.partition)


def log_model(scene: Scene, outline: Outline) -> None:
    """Log the model and what it leaves out, with the lines of `check` (collective)."""
    refuse_without_bound(scene, outline)
    for line in modelled_lines(scene, outline):
        if line and outline.partition.comm.rank == 0:
            log.info("%s", line)


def printed(show: Callable[[], None], directory: Path) -> None:
    """Print a table of results; an error of the terminal does not end the run."""
    try:
        show()
    except OSError as error:
        print_message(f"the summary could not be printed ({error.strerror}); {directory} has it")


@contextmanager
def without_parts(directory: Path) -> Iterator[None]:
    """Context manager that removes incomplete files if an exception ends the run on some rank."""
    try:
        yield
    except BaseException:
        remove_parts(directory)
        raise
