"""Solution of a scene: model, solver, fallbacks, fields and summary, without files."""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.nodal_stress import nodal_stresses
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.machine.environment import slow_blas_warning
from contact_app.machine.memory import give_back
from contact_app.machine.timings import Timings
from contact_app.model.candidates import Needed
from contact_app.model.method import with_chosen_method
from contact_app.model.model import Model, build_model
from contact_app.model.outline import Report
from contact_app.results.fields import cell_fields, node_fields
from contact_app.results.report import log
from contact_app.run.fallback import FAILURES, NoAnswerError, failure_text
from contact_app.run.model_warnings import model_warnings
from contact_app.run.placing import (
    PLACINGS,
    Relaxation,
    SameRows,
    leaves_where_placed,
    moves_away,
    never_placed,
    placed_anew,
    rotation_warnings,
)
from contact_app.run.progress import Counting, together
from contact_app.run.summary import warned
from contact_app.run.ways import first_certified
from contact_app.scene.scene import Scene
from meshes.arrays import Array
from solver import Counts
from solver.contact.checkpoint import Checkpoint, CheckpointError
from solver.contact.solution import Guess, Solution
from solver.driver import solve
from solver.qp.result import Monitor

EXTENSIONS = 4
"""Largest number of solves with a part of the contact rows; the next one takes all rows."""


CROSSED = 1e-6
"""Admissible penetration of contacts that were left out, over the largest displacement.

The duality gap does not contain it.
"""


class Start(Protocol):
    """Initial guess from the answer to another scene: on another mesh, or under other loads."""

    def on(self, model: Model) -> Guess | None:
        """Initial guess for a model; None if there is no useful one (collective)."""


class Shared(Protocol):
    """Makes models that share all data independent of loads (collective)."""

    @property
    def keeps_subdomains(self) -> bool:
        """Whether a model must have the subdomains of the models before, where slip is known."""

    def model(self, scene: Scene, timings: Timings, needed: Needed, report: Report | None) -> Model:
        """The model of a scene; parameters as in `build_model`."""

    def estimator(self, model: Model) -> ErrorEstimator:
        """The estimator of errors of answers to a model."""


@dataclass(frozen=True, eq=False)
class _Request:
    """The scene to solve, its callbacks, and the work spent on it before."""

    scene: Scene
    comm: MPI.Intracomm
    monitor: Monitor | None
    checkpoint: Checkpoint | None
    report: Report | None
    start: Start | None
    """Initial guess from the answer to another scene."""
    timings: Timings
    counts_before: Counts = field(default_factory=Counts)
    needed: Needed = "distinct"
    """Candidate rows that become contact rows."""
    cases: Shared | None = None
    """Models shared with other load cases or increments."""
    moved: list[Array] | None = None
    """Displacements under other placements, from which undetermined motions are the least: else
    bodies that nothing drives would move with each placement."""

    def model(self) -> Model:
        """The model of the scene (collective)."""
        rest = self.timings, self.needed, self.report
        if self.cases is not None:
            model = self.cases.model(self.scene, *rest)
        else:
            model = build_model(self.scene, self.comm, *rest)
        if self.moved is None:
            return model
        return replace(model, problem=model.problem.with_least_motion_from(self.moved))

    def estimator(self, model: Model) -> ErrorEstimator:
        """The estimator of errors of its answers."""
        return ErrorEstimator(model) if self.cases is None else self.cases.estimator(model)


def solve_scene(
    scene: Scene,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    monitor: Monitor | None = None,
    checkpoint: Checkpoint | None = None,
    report: Report | None = None,
    start: Start | None = None,
    cases: Shared | None = None,
) -> SolvedScene:
    """Solve a scene and summarise the answer; writes no files (collective).

    Parameters
    ----------
    start
        Initial guess from the answer to another scene.
    report
        Called with the scene and the outline of its model (collective).
    cases
        Models shared with other load cases or increments.

    Raises
    ------
    ConfigurationError, NoEquilibriumError
        The scene cannot be modelled, or has no equilibrium.
    """
    if scene.loadings:
        key, loadings = ("cases", "load cases") if scene.cases else ("steps", "load steps")
        raise ConfigurationError(
            f"{scene.at(key)}: {loadings} are solved by `run` and by `contact_app.solve`; give a "
            "scene without them"
        )
    scene = with_chosen_method(scene)
    request = _Request(scene, comm, monitor, checkpoint, report, start, Timings(), cases=cases)
    solved = _at_rest(request)
    if not scene.guaranteed:
        return solved
    from contact_app.accuracy.guarantee.guarantee import guarantee, with_guarantee

    with solved.timings.measure("estimate"):
        bound = guarantee(solved.model, solved.solution)
    if comm.rank == 0:
        log.info("%s", bound)
    summary = {**with_guarantee(solved.summary, bound), "timings": solved.timings.as_dict()}
    return replace(solved, guaranteed=bound, summary=summary)


def _at_rest(request: _Request) -> SolvedScene:
    """Solve a scene repeatedly until the placements of its rigid bodies agree with the answer."""
    relaxation = Relaxation()
    for count in range(PLACINGS):
        try:
            solved = _certified(request)
        except NoEquilibriumError as error:
            raise (leaves_where_placed(error) if count else error) from None
        places = placed_anew(solved)
        if places is None:
            return solved
        if request.comm.rank == 0:
            log.info("rigid bodies have moved: solving again with new placements")
        places = relaxation.towards(solved.model.scene.rigid.placements, places)
        if relaxation.moves_on:
            raise moves_away(solved, count + 1)
        request = replace(
            request, scene=request.scene.placed(places), start=SameRows(solved.solution),
            checkpoint=None, counts_before=solved.solution.counts, report=None,
            moved=solved.solution.displacements,
        )  # fmt: skip
    return never_placed(solved)


def _certified(request: _Request) -> SolvedScene:
    """Solve a scene by the first method that ends with a certificate (collective)."""

    def solve_one_way(scene: Scene, counts_before: Counts, first: bool) -> SolvedScene:
        checkpoint = request.checkpoint if first else None
        return _solved(
            replace(request, scene=scene, checkpoint=checkpoint, counts_before=counts_before)
        )

    keeps = request.cases is not None and request.cases.keeps_subdomains
    return first_certified(request.scene, request.comm, solve_one_way, request.counts_before, keeps)


def _solved(request: _Request) -> SolvedScene:
    """Solve a scene, and again if the answer penetrates omitted contacts (collective)."""
    comm = request.comm
    comm.barrier()  # processes begin at different times: waiting must not count as time of a stage
    for _ in range(EXTENSIONS):
        solved = _solve_once(request)
        model, solution, slack = solved.model, solved.solution, solved.nodes.slack
        sizes = _lengths_of_contacts(solved)[model.left_out.sources]
        crossed = slack < -min(solution.tolerance, CROSSED) * sizes
        deepest = comm.allreduce(float(-slack[crossed].min(initial=0.0)), op=MPI.MAX)
        if not solution.converged or deepest == 0.0:
            return solved
        needed = model.needed.copy()
        needed[~needed] = slack < 0.0
        log.info(
            "the displacements penetrate contacts that were left out, by %.3g: solving again with "
            "%d more contact rows",
            deepest,
            comm.allreduce(int(needed.sum() - model.needed.sum())),
        )
        # the checkpoint remains that of the first solve, with which a resumed run begins
        request = replace(request, checkpoint=None, counts_before=solution.counts, needed=needed)
    return _solve_once(replace(request, needed="all"))


def _lengths_of_contacts(solved: SolvedScene) -> Array:
    """Largest displacement of the bodies of each contact, (contacts,)."""
    moved, bodies = solved.solution.measures.deformations, solved.model.scene.touching
    return np.array([max(moved[item.body], moved[getattr(item, "other", item.body)])
                     for item in bodies])  # fmt: skip


def _solve_once(request: _Request) -> SolvedScene:
    """Solve with the needed contact rows, after some work spent before (collective)."""
    comm, timings = request.comm, request.timings
    for whose in (PETSc.COMM_SELF, comm):  # free the memory of earlier solves
        PETSc.garbage_cleanup(whose)
    try:
        model = request.model()
    except FAILURES as error:
        raise NoAnswerError(failure_text(error)) from error
    estimator = request.estimator(model)
    with timings.measure("solve"):
        solution = _solution_of(model, estimator, request)
    give_back()  # return freed memory to the system, so that the estimate of free memory sees it
    with timings.measure("estimate"):
        accuracy = solution.accuracy or estimator.accuracy(solution)
        solution = replace(
            solution, accuracy=accuracy, counts=request.counts_before + solution.counts
        )
    with timings.measure("output"):
        nodes, cells = node_fields(model, solution), cell_fields(model, solution)
        output = model.scene.output
        nodal = nodal_stresses(model, solution, estimator) if output.xdmf or output.vtu else {}
        solved = SolvedScene(model, solution, nodes, cells, accuracy, timings, nodal)
        warnings = model_warnings(solved)
        rigid = model.scene.rigid
        warnings += rotation_warnings(rigid.placements, rigid.bodies, solved.placements)
        warnings += filter(None, [slow_blas_warning()])
    return warned(solved, warnings)


def _solution_of(model: Model, estimator: ErrorEstimator, request: _Request) -> Solution:
    """The answer of the scene's method.

    Raises
    ------
    NoAnswerError
        The solver failed.
    """
    begin = request.start.on(model) if request.start is not None else None
    counting = Counting()
    monitor = together(request.monitor, counting)
    rest = monitor, request.checkpoint, estimator.accuracy, begin
    try:
        return solve(model.problem, model.scene.solver, *rest)
    except CheckpointError as error:
        raise ConfigurationError(str(error)) from error
    except FAILURES as error:
        raise NoAnswerError(failure_text(error), model.partition.count, counting.counts) from error
