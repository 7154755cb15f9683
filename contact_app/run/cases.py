"""Load cases: each from the unloaded state, on one model; a directory of results for each.

The model is built once (`run.case_models`); each case has its own solve, fields and files. Later
cases start from the nearest earlier one.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.machine.environment import environment
from contact_app.machine.exits import Exit
from contact_app.machine.ranks import on_first
from contact_app.model.method import with_chosen_method
from contact_app.model.outline import Report
from contact_app.results.envelope import Envelope
from contact_app.results.history import History
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.results.report import log, print_cases, write_summary
from contact_app.run.attended import Attended, attended
from contact_app.run.case_models import CaseModels
from contact_app.run.files import (
    exit_of,
    log_model_that_fits,
    part_that_is_solved,
    printed,
    without_parts,
    write_run,
)
from contact_app.run.progress import together
from contact_app.run.result_directory import clear
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from solver.contact.checkpoint import EVERY_SECONDS
from solver.qp.result import Monitor


def solved_cases(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor_of: Callable[[str], Monitor | None],
    report: Report | None = None,
) -> Iterator[SolvedScene]:
    """Solve the cases of a scene one after another; writes nothing (collective).

    Parameters
    ----------
    monitor_of
        Returns the monitor of a case, given its name; called before the case is solved.
    report
        Called with the scene and the outline of the model of its first case.
    """
    scene = with_chosen_method(scene)
    models = CaseModels(scene, comm)
    for case in scene.cases:
        solved = solve_scene(
            scene.under(case),
            comm,
            monitor_of(case.name),
            report=report,
            start=models,
            cases=models,
        )
        models.add(solved.model.problem, solved.solution)
        yield solved


class Overview:
    """Collects the summary and the envelope of all cases of a run; collective.

    Attributes
    ----------
    warnings
        Warnings of all certificates, each with its case.
    """

    def __init__(self, scene: Scene, comm: MPI.Intracomm) -> None:
        self._scene, self._comm = scene, comm
        self._cases: dict[str, dict[str, Any]] = {}
        self._first: dict[str, Any] = {}
        self._envelope: Envelope | None = None
        self._timings: dict[str, float] = {}
        self._warnings: dict[str, list[str]] = {}

    def add(self, solved: SolvedScene, summary: dict[str, Any]) -> None:
        """Add a solved case."""
        model, name = solved.model, solved.model.scene.case
        stress = float(solved.cells.von_mises.max(initial=0.0))
        largest = model.comm.allreduce(stress, op=MPI.MAX)
        self._first = self._first or summary
        self._cases[name] = {
            "solution": {**summary["solution"], "max_von_mises": largest},
            "certificate": summary["certificate"],
            "solver": summary["solver"],
            "accuracy": summary["accuracy"],
            "contacts": summary["contacts"],
        }
        for key, seconds in summary["timings"].items():
            self._timings[key] = self._timings.get(key, 0.0) + seconds
        warnings = list(summary["certificate"]["warnings"])
        if self._envelope is None:
            self._envelope = Envelope(model, solved.nodes, solved.cells)
        if not self._envelope.add(len(self._cases), model, solved.nodes, solved.cells):
            warnings.append(
                "the case has cells on other ranks than the first and is not in envelope.xdmf"
            )
        for sentence in warnings:
            self._warnings.setdefault(sentence, []).append(name)

    @property
    def warnings(self) -> list[str]:
        """Warnings: each sentence once, with its cases."""
        messages = []
        for sentence, names in self._warnings.items():
            of = "all cases" if len(names) == len(self._scene.cases) > 1 else ", ".join(names)
            messages.append(f"{of}: {sentence}")
        return without_repetitions(messages, [body.name for body in self._scene.bodies])

    @property
    def summary(self) -> dict[str, Any]:
        """The overview: ``summary.json`` in the directory of the run (collective)."""
        assert self._envelope is not None
        names = list(self._cases)
        return {
            "scene": {"title": self._scene.title, "dimension": self._scene.dimension},
            "mesh": self._first["mesh"],
            "decomposition": self._first["decomposition"],
            "cases": self._cases,
            "envelope": self._envelope.peaks(names),
            "timings": self._timings,
            "environment": environment(self._comm),
        }

    def leave_out(self, names: list[str]) -> None:
        """Record that cases were not solved because the run was interrupted."""
        for name in names:
            self._warnings.setdefault("not solved: the run was interrupted", []).append(name)

    def write(self, directory: Path) -> tuple[dict[str, Any], list[Path]]:
        """Write ``envelope.xdmf`` and the summary.

        Return the summary and the paths (collective).
        """
        assert self._envelope is not None
        files = [*self._envelope.write(directory), directory / "summary.json"]
        summary, comm = self.summary, self._comm
        for warning in self.warnings if comm.rank == 0 else ():
            log.warning("%s", warning)
        on_first(comm, lambda: write_summary(directory / "summary.json", summary))
        summaries = [directory / name / "summary.json" for name in self._cases]
        return summary, [*files, *summaries]


def run_cases(
    scene: Scene,
    directory: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    resume: bool = False,
    every: float = EVERY_SECONDS,
) -> int:
    """Solve all cases, write their directories and the overview; return the exit code (collective).

    If the run is interrupted, the present case ends with its partial results, and no other case
    begins. Parameters are those of `run.run`; the exit code is the worst of the cases.
    """
    if resume:
        raise ConfigurationError(
            f"{scene.at('cases')}: a run of load cases leaves no checkpoint to resume from; start "
            "it anew, or with the remaining cases"
        )
    with attended(directory, comm, False, every) as run:
        scene = part_that_is_solved(scene)
        overview, code = _solve_and_write(scene, directory, comm, run)
        run.progress.stage("writing")
        summary, files = overview.write(directory)
    if comm.rank == 0:
        files = [*files, directory / "run.log"]
        printed(lambda: print_cases(summary, overview.warnings, files), directory)
    return code


def _solve_and_write(
    scene: Scene, directory: Path, comm: MPI.Intracomm, run: Attended
) -> tuple[Overview, int]:
    """Solve the cases and write the files of each; return overview and exit code (collective)."""
    overview, code, progress = Overview(scene, comm), Exit.CERTIFIED, run.progress
    left = [case.name for case in scene.cases]
    with ExitStack() as histories:

        def monitor_of(name: str) -> Monitor:
            histories.close()  # close the file of the case before
            progress.stage(f"case {name}")
            on_first(comm, lambda: clear(directory / name, resume=False))
            path = directory / name / "history.csv" if comm.rank == 0 else None
            return together(progress, histories.enter_context(History(path)), run.attention)

        report = partial(log_model_that_fits, directory=directory)
        for solved in solved_cases(scene, comm, monitor_of, report):
            histories.close()
            left.remove(solved.model.scene.case)
            with without_parts(directory / solved.model.scene.case):
                summary, _ = write_run(solved, None, directory / solved.model.scene.case, progress)
            overview.add(solved, summary)
            code = max(code, exit_of(solved))
            if run.interruption.requested_by_any(comm):
                break
    if left:
        overview.leave_out(left)
        code = max(code, Exit.NOT_CERTIFIED)
    return overview, code
