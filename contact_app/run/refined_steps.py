"""A load history on meshes refined to an accuracy: the whole history is solved on each mesh.

Slip is known at the nodes of one mesh only, so that no increment can go on from one of another
mesh. The error of the last increment decides (`accuracy.refine.refinement`); a warning counts
earlier increments whose estimate exceeds the target.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

from mpi4py import MPI

from contact_app.accuracy.refine.levels import Refined, with_levels
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.outline import Report
from contact_app.results.percent import percent
from contact_app.run.increments import Place, SolvedIncrement, solved_increments
from contact_app.run.step_records import Record, record_of, summary_of_steps
from contact_app.scene.scene import Scene
from solver.qp.result import Monitor


@dataclass(frozen=True, eq=False)
class SolvedHistory(SolvedScene):
    """The answer to the last increment, with all increments and a summary of all."""

    increments: tuple[SolvedIncrement, ...] = ()

    def without_factors(self) -> "SolvedHistory":
        """The answers without the factors of their models, which output does not need."""
        bare = [replace(each, solved=each.solved.without_factors()) for each in self.increments]
        return replace(self, model=bare[-1].solved.model, increments=tuple(bare))


@dataclass(frozen=True, eq=False)
class RefinedHistory:
    """The increments on the last mesh, their records, and the summary with all levels."""

    increments: tuple[SolvedIncrement, ...]
    records: list[Record]
    summary: dict[str, Any]
    certified: bool


def history_to_accuracy(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor_of: Callable[[Place], Monitor | None],
    report: Report | None = None,
    progress: Callable[[str], None] = lambda text: None,
    stop: Callable[[], bool] | None = None,
) -> RefinedHistory:
    """Refine the meshes of a history until the error of its last increment is small (collective).

    Parameters are those of `increments.solved_increments` and `refinement.solve_to_accuracy`.
    """
    solve = partial(_solved, comm=comm, monitor_of=monitor_of, report=report)
    refined = solve_to_accuracy(scene, solve, progress, stop=stop)
    history = refined.solved
    assert isinstance(history, SolvedHistory)
    summary = _summary(refined)
    done = all(each.solved.certified for each in history.increments) and not refined.missed
    return RefinedHistory(history.increments, summary["steps"], summary, done)


def _solved(
    scene: Scene,
    *,
    start: LastLevel | None,
    comm: MPI.Intracomm,
    monitor_of: Callable[[Place], Monitor | None],
    report: Report | None,
) -> SolvedHistory:
    """The history on one mesh; it begins anew (collective)."""
    increments, records = [], []
    for increment in solved_increments(scene, comm, monitor_of, report):
        increments.append(increment)
        records.append(record_of(increment))  # now, since the clock of its timings goes on
    last = increments[-1].solved
    summary = summary_of_steps(last.summary, records)
    rest = {each.name: getattr(last, each.name) for each in fields(SolvedScene)}
    return SolvedHistory(**{**rest, "summary": summary}, increments=tuple(increments))


def _summary(refined: Refined) -> dict[str, Any]:
    """``summary.json``: the history with the levels, and a warning of less accurate increments."""
    summary = with_levels(refined.solved.summary, refined)
    records, target = summary["steps"], summary["accuracy"]["target"]
    records[-1]["accuracy"] = {**records[-1]["accuracy"], **refined.solved.accuracy.as_dict()}
    errors = {each["increment"]: each["accuracy"]["total"] for each in records[:-1]}
    above = {number: error for number, error in errors.items() if (error or 0.0) > target}
    if not above:
        return summary
    worst = max(above, key=above.__getitem__)
    text = (
        f"the accuracy {target:g} is that of the last increment: {len(above)} of the others have a "
        f"larger estimated error, up to {percent(above[worst])} in increment {worst}"
    )
    certificate = summary["certificate"]
    warnings = [*certificate["warnings"], text]
    return {**summary, "certificate": {**certificate, "warnings": warnings}}
