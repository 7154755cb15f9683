"""The paper's own problem: 300³ hexahedra, 81,812,703 unknowns, in 10×10×10 subdomains.

It is solved twice and certified both times: with the paper's rule (projcg, SMALBE-M with ρ = 1.1‖F‖
and M = 100‖F‖ divided by 10) and with this solver's own rule. All subdomains share one stiffness
matrix, whose reflections split the inverse on the interface into eight small blocks. No mesh of the
whole cube is built. An interrupted run continues from its
last outer iteration.
"""

from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.machine.environment import environment
from contact_app.machine.timings import Timings
from contact_app.model.model import Model, build_model
from contact_app.results.history import History
from contact_app.results.report import write_summary
from contact_app.results.summary import summary_of_solution
from contact_app.run.progress import Interruption, Progress, together
from contact_app.scene.scene import Scene
from contact_app.studies.cube import RTOL, equality
from solver import MPRGP, SMALBE, BoxQP, Reason
from solver.contact.checkpoint import Attention, Checkpoint, Saver
from solver.contact.solution import Solution
from solver.driver import solve
from solver.qp.operators import estimate_norm
from solver.qp.outer_state import Hooks
from solver.qp.result import Monitor
from solver.tfeti.methods.answers import certified_answer
from solver.tfeti.methods.by_smalbe import METHOD

PAPER_CELLS = 300
"""Hexahedra along each edge of the paper's cube."""


class Settings(StrEnum):
    """The rules of a run: of this solver or of the paper."""

    paper = "paper"
    default = "ours"


def paper_run(
    output: Path, scene: Scene, settings: tuple[Settings, ...], comm: MPI.Intracomm = MPI.COMM_WORLD
) -> Iterator[str]:
    """Solve the scene with each rule and write a directory for each.

    If a directory holds a checkpoint of the same problem, the run continues from it.

    Yields
    ------
    str
        A sentence for each run and each written file; on rank 0.
    """
    timings = Timings()
    with Progress(comm.rank == 0) as progress:
        progress.stage(f"modelling {scene.title}")
        model = build_model(scene, comm, timings)
        before = timings.as_dict()["total"]
    for setting in settings:
        directory = output / setting.value
        summary = _run(model, setting, directory, timings.branched(before))
        solver, clock = summary["solver"], summary["timings"]
        if comm.rank == 0:
            yield (
                f"{setting.value}: {solver['hessian_multiplications']} Hessian multiplications in "
                f"{solver['outer_iterations']} outer iterations, {clock['total']:.0f} s, "
                f"{summary['environment']['peak_rss_gb']:.1f} GB; certificate "
                f"{'passed' if summary['certificate']['passed'] else 'not passed'}: "
                f"{solver['reason']}"
            )
            yield f"wrote {directory}"


def _run(model: Model, setting: Settings, directory: Path, timings: Timings) -> dict[str, Any]:
    comm, first = model.comm, model.comm.rank == 0
    if first:
        directory.mkdir(parents=True, exist_ok=True)
    comm.barrier()
    checkpoint = Checkpoint(directory, comm, resume=True)
    with (
        Progress(first) as progress,
        History(directory / "history.csv" if first else None, checkpoint.exists) as history,
        Interruption() as interruption,
    ):
        attention = Attention(comm, lambda: interruption.requested, checkpoint)
        monitor = together(progress, history, attention)
        progress.stage(f"solving, {setting.value}")
        with timings.measure("solve"):
            if setting is Settings.default:
                solution = solve(model.problem, model.scene.solver, monitor, checkpoint)
            else:
                solution = _by_the_paper(model, monitor, checkpoint)
        if solution.reason is Reason.STOPPED:
            checkpoint.save_held()
        else:
            checkpoint.remove()
    summary = {
        **summary_of_solution(model, solution),
        "timings": timings.as_dict(),
        "environment": environment(comm),
    }
    summary["scene"]["title"] = f"{model.scene.title}: {setting.value}"
    if first:
        write_summary(directory / "summary.json", summary)
    return summary


def _by_the_paper(model: Model, monitor: Monitor, checkpoint: Checkpoint) -> Solution:
    """SMALBE-M under the paper's rule to the paper's tolerance; no preconditioner."""
    problem = model.problem
    norm, multiplications = estimate_norm(problem.projected)
    solver = SMALBE.paper(MPRGP("projcg", rtol=RTOL, norm=norm))
    constraint = equality(model)
    saver = Saver(checkpoint)
    result = solver.begin(
        BoxQP(problem.projected, problem.rhs, lower=problem.lower),
        constraint,
        restart=checkpoint.load(problem.size, problem.description),
        hooks=Hooks(monitor, saver, lambda: saver.due),
    ).run()
    result.counts.norm_estimation += multiplications
    force = np.empty(problem.size)
    constraint.apply_transpose(result.multiplier, force)
    answer = certified_answer(problem, result.x, force, model.scene.solver.least_tolerance)
    return replace(answer, counts=result.counts, reason=result.reason, method=METHOD)
