"""Run a scene: model, solve, certify, write."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed
from contact_app.accuracy.guarantee.guarantee import guarantee, with_guarantee
from contact_app.accuracy.refine.refinement import Refined, solve_to_accuracy, with_levels
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError, CouldNotRunError
from contact_app.machine.caches import usable_caches
from contact_app.machine.disk import refuse_without_room
from contact_app.machine.environment import environment, slow_blas_warning
from contact_app.machine.exits import Exit, add_remedy
from contact_app.machine.exits import tell as say
from contact_app.machine.timings import Timings
from contact_app.model.candidates import Needed, more_needed
from contact_app.model.model import Model, build_model
from contact_app.model.outline import Outline, Tell
from contact_app.model.symmetry import halved
from contact_app.results.contacts import contact_records
from contact_app.results.fields import cell_fields, node_fields
from contact_app.results.history import History
from contact_app.results.mirror import whole_summary
from contact_app.results.output import write_xdmf
from contact_app.results.report import log, print_summary, run_log, write_summary
from contact_app.results.result_size import result_bytes
from contact_app.run.check import modelled_lines
from contact_app.run.communication import Communication, on_first
from contact_app.run.fallback import (
    FAILURES,
    NoAnswerError,
    cause,
    failure_text,
    fewest_subdomains,
    is_final,
    solve_directly,
)
from contact_app.run.model_warnings import model_warnings
from contact_app.run.progress import Interruption, Progress, together
from contact_app.run.repeated_sentences import said_once
from contact_app.run.result_directory import clear, remove_parts
from contact_app.scene.scene import Scene
from solver import Counts
from solver.contact.checkpoint import EVERY_SECONDS, Attention, Checkpoint, CheckpointError
from solver.contact.driver import reason_text, solve
from solver.contact.solution import Solution
from solver.qp.result import Monitor, Reason
from solver.tfeti.constraints.rows import RowKind

EXTENSIONS = 4
"""Solves with some of the contact rows before all are taken."""

CROSSED = 1e-6
"""Largest penetration of contacts that were left out, over the largest displacement: the duality
gap does not know of it."""


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
        if scene.symmetry:
            halving = halved(scene)
            scene = halving.scene
            for note in halving.notes:
                log.info("%s", note)
        progress.stage(f"modelling {scene.title or scene.source.name}")
        refined = None
        if scene.accuracy is None:
            tell = partial(_log_model_that_fits, directory=directory)
            solved = solve_scene(scene, comm, monitor, checkpoint, tell)
        else:
            refined = solve_to_accuracy(
                scene,
                partial(solve_scene, comm=comm, monitor=monitor, tell=_log_model),
                progress.stage,
            )
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
        try:
            print_summary(summary, solved.solution.tolerance, files)
        except OSError as error:
            say(f"the summary could not be printed ({error.strerror}); {files[0].parent} has it")
    reached = refined is None or not refined.missed
    reached &= solved.guaranteed is None or not solved.guaranteed.missing
    return Exit.CERTIFIED if solved.solution.converged and reached else Exit.NOT_CERTIFIED


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


def solve_scene(
    scene: Scene,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    monitor: Monitor | None = None,
    checkpoint: Checkpoint | None = None,
    tell: Tell | None = None,
    start: LastLevel | None = None,
) -> SolvedScene:
    """Solve a scene and summarise it; writes nothing.

    Parameters
    ----------
    start
        The answer on another mesh to begin with.
    tell
        Called with the scene and the outline of its model (collective).

    Raises
    ------
    ConfigurationError, NoEquilibriumError
        The scene cannot be modelled, or has no equilibrium.
    """
    solved = _certified_if_possible(scene, comm, monitor, checkpoint, tell, start)
    if not scene.guaranteed:
        return solved
    with solved.timings.measure("estimate"):
        found = guarantee(solved.model, solved.solution)
    if comm.rank == 0:
        log.info("%s", found)
    summary = {**with_guarantee(solved.summary, found), "timings": solved.timings.as_dict()}
    return replace(solved, guaranteed=found, summary=summary)


def _certified_if_possible(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    tell: Tell | None,
    start: LastLevel | None,
) -> SolvedScene:
    """Solve a scene, anew in the fewest subdomains where the first way ends uncertified.

    Raises
    ------
    CouldNotRunError
        No way left an answer.
    """
    timings, first, count, spent = Timings(), None, None, Counts()
    try:
        first = _solved(scene, comm, monitor, checkpoint, tell, start, timings)
        if is_final(first.model, first.solution, scene.solver.max_iterations):
            return first
        count, spent = first.model.partition.count, first.solution.counts
        why = reason_text(first.solution)
    except NoAnswerError as error:
        count, why = error.subdomains, str(error)
    fewer = fewest_subdomains(scene, count, comm)
    if fewer is None:
        if first is None:
            raise _no_answer(scene, why)
        return first
    subdomains = "in its subdomains" if count is None else f"in {count} subdomains"
    text = (
        f"{subdomains} the answer could not be certified ({why}){cause(scene)}: solved in "
        f"{fewer.decomposition.subdomains} instead"
    )
    if comm.rank == 0:
        log.info("%s", text)
    del first  # its factors make room for the next
    try:
        again = _solved(fewer, comm, monitor, None, tell, start, timings, spent)
    except NoAnswerError as error:
        raise _no_answer(scene, str(error)) from None
    return _warned(again, text)


def _no_answer(scene: Scene, why: str) -> CouldNotRunError:
    return CouldNotRunError(
        f"{scene.source}: the solver found no answer: {why} Try other cells (less slender ones, of "
        "degree 2) or a looser solver.tolerance, and report the scene"
    )


def _warned(solved: SolvedScene, text: str) -> SolvedScene:
    """The same with one more warning."""
    certificate = solved.solution.certificate
    certificate = replace(certificate, warnings=(*certificate.warnings, text))
    solved = replace(solved, solution=replace(solved.solution, certificate=certificate))
    return replace(solved, summary=summary_of(solved))


def _solved(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    tell: Tell | None,
    start: LastLevel | None,
    timings: Timings | None = None,
    spent: Counts | None = None,
) -> SolvedScene:
    """Solve a scene, again where the answer crosses contacts that were left out (collective).

    Parameters
    ----------
    timings, spent
        Time and work so far.
    """
    comm.barrier()  # processes begin at different times: nobody's seconds are the wait for others
    timings, spent = timings or Timings(), spent or Counts()
    needed: Needed = "estimated"
    for _ in range(EXTENSIONS):
        solved = _solve_once(scene, comm, monitor, checkpoint, needed, timings, spent, tell, start)
        model, solution, slack = solved.model, solved.solution, solved.nodes.slack
        sizes = _lengths_of_contacts(solved)[model.left_out.sources]
        crossed = slack < -min(solution.tolerance, CROSSED) * sizes
        deepest = comm.allreduce(float(-slack[crossed].min(initial=0.0)), op=MPI.MAX)
        if not solution.converged or deepest == 0.0:
            return solved
        spent, needed = solution.counts, model.needed.copy()
        needed[~needed] = more_needed(model.left_out, model.reach, slack, sizes)
        log.info(
            "the displacements cross contacts that were left out, by %.3g: solving again with %d "
            "more contact rows",
            deepest,
            comm.allreduce(int(needed.sum() - model.needed.sum())),
        )
        checkpoint = None  # it stays that of the first solve, which a resumed run begins with, too
    return _solve_once(scene, comm, monitor, checkpoint, "all", timings, spent, tell, start)


def _lengths_of_contacts(solved: SolvedScene) -> NDArray[np.float64]:
    """Largest displacement of the bodies of each contact, (contacts,)."""
    moved, bodies = solved.solution.measures.displacements, solved.model.scene.touching
    return np.array([max(moved[item.body], moved[getattr(item, "other", item.body)])
                     for item in bodies])  # fmt: skip


def _solve_once(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    needed: Needed,
    timings: Timings,
    spent: Counts,
    tell: Tell | None,
    start: LastLevel | None,
) -> SolvedScene:
    """Solve with the contact rows that are needed, after work that was spent (collective)."""
    for whose in (PETSc.COMM_SELF, comm):  # what earlier solves left to Python's collector
        PETSc.garbage_cleanup(whose)
    try:
        model = build_model(scene, comm, timings, needed, tell)
    except FAILURES as error:
        raise NoAnswerError(failure_text(error)) from error
    communication = Communication(comm)
    estimator = ErrorEstimator(model)
    with timings.measure("solve"):
        solution, failed = _solution_of(model, estimator, monitor, checkpoint, start)
    said = communication.per_multiplication(solution.counts)
    with timings.measure("estimate"):
        accuracy = solution.accuracy or estimator.accuracy(solution)
        solution = replace(solution, accuracy=accuracy, counts=spent + solution.counts)
    with timings.measure("output"):
        nodes = node_fields(model, solution)
        cells = cell_fields(model, solution)
        warnings = model_warnings(model, solution, nodes, cells)
        if failed:
            warnings.append(failed)
        slow = slow_blas_warning()
        if slow:
            warnings.append(slow)
        solution = replace(
            solution, certificate=replace(solution.certificate, warnings=tuple(warnings))
        )
    solved = SolvedScene(model, solution, nodes, cells, accuracy, timings, said)
    return replace(solved, summary=summary_of(solved))


def _solution_of(
    model: Model,
    estimator: ErrorEstimator,
    monitor: Monitor | None,
    checkpoint: Checkpoint | None,
    start: LastLevel | None,
) -> tuple[Solution, str]:
    """The answer of the dual methods, or, where these fail in the fewest subdomains, of Newton's.

    Returns
    -------
    The answer, and a sentence on what failed before.

    Raises
    ------
    NoAnswerError
        The solver failed, and this was the last way or there are fewer subdomains to try.
    """
    scene, options, solution = model.scene, model.scene.solver, None
    begin = start.on(model) if start is not None else None
    try:
        solution = solve(model.problem, options, monitor, checkpoint, estimator.accuracy, begin)
        if is_final(model, solution, options.max_iterations):
            return solution, ""
        why = reason_text(solution)
    except CheckpointError as error:
        raise ConfigurationError(str(error)) from error
    except FAILURES as error:
        why = failure_text(error)
    if model.partition.count <= max(len(scene.bodies), model.comm.size):
        direct = solve_directly(model, solution, monitor)
        if direct is not None and (solution is None or direct.converged):
            return direct, (
                f"the dual problem could not be solved to a certificate ({why}){cause(scene)}: "
                "solved for the displacements by Newton's method instead, which takes longer"
            )
    if solution is None:
        raise NoAnswerError(why, model.partition.count)
    return solution, ""


@dataclass(frozen=True)
class Totals:
    """What `summary.json` says of the fields of an answer, over all ranks.

    Attributes
    ----------
    max_displacement, mean_displacement
        Of |u| over the nodes of the undecomposed mesh.
    contact_force : (3,)
        Resultant of the obstacles on the bodies.
    max_contact_pressure
    """

    max_displacement: float
    mean_displacement: float
    contact_force: tuple[float, ...]
    max_contact_pressure: float


def summary_of(solved: SolvedScene) -> dict[str, Any]:
    """`summary.json` of a solved scene (collective)."""
    comm, nodes, partition = solved.model.comm, solved.nodes, solved.model.partition
    magnitude = np.linalg.norm(nodes.displacement, axis=1)
    totals = Totals(
        comm.allreduce(float(magnitude.max(initial=0.0)), op=MPI.MAX),
        comm.allreduce(float(magnitude.sum())) / partition.nodes,
        tuple(float(f) for f in comm.allreduce(nodes.contact_force)),
        comm.allreduce(float(nodes.contact_pressure.max(initial=0.0)), op=MPI.MAX),
    )
    summary = summarise(solved.model, solved.solution, totals, solved.timings)
    pairs, forces = solved.model.scene.pairs, comm.allreduce(nodes.pair_forces)
    summary["solution"]["pair_forces"] = {
        pair.source: [float(f) for f in force] for pair, force in zip(pairs, forces, strict=True)
    }
    summary["contacts"] = contact_records(solved.model, nodes)
    summary["accuracy"] = solved.accuracy.as_dict()
    if solved.communication is not None:
        summary["solver"]["communication_per_multiplication"] = solved.communication
    if solved.model.scene.mirrors:
        return whole_summary(summary, solved.model, nodes)
    return summary


def summarise(model: Model, solution: Solution, totals: Totals, timings: Timings) -> dict[str, Any]:
    """`summary.json`, but for what only fields at all nodes and cells can tell (collective)."""
    problem, scene, comm = model.problem, model.scene, model.comm
    multiplier = solution.multiplier[problem.inequality]
    classes = comm.allreduce(len(problem.classes))
    counts, certificate = solution.counts, solution.certificate.as_dict()
    decides = solution.certificate.deciding(solution.tolerance)
    if decides is not None:
        certificate["decided_by"] = scene.bodies[decides].name
    return {
        "scene": {"title": scene.title, "dimension": scene.dimension},
        "mesh": {
            "cells": model.partition.cells,
            "nodes": model.partition.nodes,
            "dofs": model.dofs,
        },
        "decomposition": {
            "subdomains": model.partition.count,
            "congruence_classes": classes,
            "dual": comm.allreduce(problem.size),
            "gluing": problem.count(RowKind.GLUING),
            "dirichlet": problem.count(RowKind.DIRICHLET) + problem.count(RowKind.SUPPORT),
            "contact": problem.count(RowKind.CONTACT),
        },
        "solver": {
            "method": solution.method,
            "converged": solution.converged,
            "tolerance": solution.tolerance,
            "reason": reason_text(solution),
            "outer_iterations": counts.outer,
            "hessian_multiplications": counts.hessian,
            "cg_steps": counts.cg,
            "expansion_steps": counts.expansion,
            "proportioning_steps": counts.proportioning,
            "norm_estimation_multiplications": counts.norm_estimation,
        },
        "solution": {
            "energy": solution.measures.energy,
            "max_displacement": totals.max_displacement,
            "mean_displacement": totals.mean_displacement,
            "active_contacts": comm.allreduce(int((multiplier > 0.0).sum())),
            "contact_force": list(totals.contact_force),
            "max_contact_pressure": totals.max_contact_pressure,
        },
        "certificate": certificate,
        "timings": timings.as_dict(),
        "environment": environment(comm),
    }
