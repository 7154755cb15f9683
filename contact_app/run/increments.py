"""A load history, solved increment by increment.

With friction each increment is the incremental quasi-static problem: slip w is measured from the
end of the last increment, so that the tangential rows ask for B u - B u_last = 0 where a point
sticks, and where it slides the friction force is at its limit along w. Everything else is a load
case of the model that all increments share (`run.case_models`). An increment begins with the
combination of earlier multipliers that is nearest to it, else with those of the last one; search
directions of one increment serve all later ones.

An increment without a certified answer is halved, and its halves again, up to `HALVINGS` times.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.machine.timings import Timings
from contact_app.model.candidates import Needed
from contact_app.model.method import chosen
from contact_app.model.model import Model
from contact_app.model.outline import Tell
from contact_app.run.case_models import CaseModels
from contact_app.run.fallback import NoWayLeftError
from contact_app.run.solve import solve_scene
from contact_app.run.step_equilibrium import LeavesInStepError
from contact_app.run.ways import warned
from contact_app.scene.scene import Scene
from solver.qp.result import Monitor, Reason
from solver.tfeti.directions import Directions

HALVINGS = 4
"""Times that an increment without a certified answer is halved."""

TURNED = math.pi / 6.0
"""Angle between the lines along which a node slips in two increments, from which on it counts as
turned: the friction force in between is off by up to half of itself. A slip that is reversed does
not count: the node sticks in between, and the load at which that ends is met exactly."""

MANY = 0.1
"""Share of the sliding nodes that may turn without a warning."""

log = logging.getLogger("contact_app")


@dataclass(frozen=True)
class Place:
    """A place in a load history.

    Attributes
    ----------
    step
        From one.
    share
        Of the step, in (0, 1]: its factor.
    number
        Of the increment that ends here, from one, over all steps.
    """

    step: int
    share: Fraction
    number: int

    @property
    def time(self) -> float:
        """Steps that are over: the end of the first step is at 1."""
        return float(self.step - 1 + self.share)


@dataclass(frozen=True, eq=False)
class SolvedIncrement:
    """An increment with its answer.

    Attributes
    ----------
    factors
        Of named conditions at its end.
    dissipated
        Work that friction has taken up to its end.
    halved
        How often the increment that was asked for was halved until this part of it had an answer.
    """

    place: Place
    factors: dict[str, float]
    solved: SolvedScene
    dissipated: float
    halved: int = 0


Displacements = list[NDArray[np.float64]]
"""One (n, members) array a class."""


class IncrementModels:
    """Makes the models of increments, and remembers the last one; methods are collective."""

    def __init__(self, scene: Scene, comm: MPI.Intracomm) -> None:
        self._models = CaseModels(scene, comm)
        self._rough = scene.has_friction
        self._displacements: Displacements | None = None
        self._directions: Directions | None = None
        self._earlier: Callable[[list[tuple[int, int]]], Displacements] | None = None
        self._multiplier: NDArray[np.float64] | None = None

    @property
    def keeps_subdomains(self) -> bool:
        """Whether slip is measured from an earlier answer."""
        earlier = self._displacements is not None or self._earlier is not None
        return self._rough and earlier

    def go_on(self, read: Callable[[list[tuple[int, int]]], Displacements]) -> None:
        """Go on from displacements of an earlier run.

        Parameters
        ----------
        read
            Gives them, (n, members) of each class, by these shapes (collective).
        """
        self._earlier = read

    def model(self, scene: Scene, timings: Timings, needed: Needed, tell: Tell | None) -> Model:
        """The model of an increment, with slip measured from the last one."""
        model = self._models.model(scene, timings, needed, tell)
        problem = model.problem
        if problem.factored and problem.coarse is not None:
            problem = problem.recycling(self._directions)
            self._directions = problem.known.directions
        if self._earlier is not None:
            self._displacements = self._earlier([(len(f), f.shape[1]) for f in problem.forces])
            self._earlier = None
        if self._rough and self._displacements is not None:
            problem = problem.with_slip_from(self._displacements)
        return replace(model, problem=problem)

    def estimator(self, model: Model) -> ErrorEstimator:
        """What estimates the errors of answers to a model."""
        return self._models.estimator(model)

    def add(self, solved: SolvedScene) -> None:
        """Go on from an answer."""
        self._displacements = solved.solution.displacements
        self._multiplier = solved.solution.multiplier
        self._models.add(solved.model, solved.solution)

    def on(self, model: Model) -> NDArray[np.float64] | None:
        """Multipliers to begin with, (dual,)."""
        near = self._models.on(model)
        if near is not None:
            return near
        same = self._multiplier is not None and len(self._multiplier) == model.problem.size
        return self._multiplier if model.comm.allreduce(int(same), op=MPI.MIN) else None


@dataclass(frozen=True)
class Position:
    """Where a load history has come to.

    Attributes
    ----------
    step, share
        The step, from one, and the share of it that is over.
    number
        Increments that are over.
    dissipated
        Work that friction has taken.
    """

    step: int = 1
    share: Fraction = Fraction(0)
    number: int = 0
    dissipated: float = 0.0


def solved_increments(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor_of: Callable[[Place], Monitor | None],
    tell: Tell | None = None,
    models: IncrementModels | None = None,
    begin: Position | None = None,
) -> Iterator[SolvedIncrement]:
    """Solve the steps of a scene one after another; writes nothing (collective).

    The last one that is given has no certified answer if the history ends early.

    Parameters
    ----------
    monitor_of
        Asked for the monitor of each increment before it is solved.
    tell
        Called with the scene and the outline of the model of its first increment.
    models, begin
        What is known of increments that were solved before, and where these ended.

    Raises
    ------
    NoEquilibriumError
        Naming the step, and the factor within it at which a body leaves.
    """
    begin, scene = begin or Position(), chosen(scene)
    models = models or IncrementModels(scene, comm)
    number, dissipated = begin.number, begin.dissipated
    last: SolvedIncrement | None = None
    for step, given in enumerate(scene.steps[begin.step - 1 :], start=begin.step):
        over = begin.share if step == begin.step else Fraction(0)
        ahead = _parts(over, given.increments)
        while ahead:
            part = ahead.pop()
            place = Place(step, part[1], number + 1)
            solved = _solved(scene, comm, place, monitor_of, tell, models)
            halved = _halvings(part, given.increments)
            if not _is_final(solved) and halved < HALVINGS:
                middle = (part[0] + part[1]) / 2
                ahead += [(middle, part[1]), (part[0], middle)]
                if comm.rank == 0:
                    log.warning(
                        "step %d: the increment to factor %.6g has no certified answer: halved",
                        step, float(part[1]),
                    )  # fmt: skip
                continue
            if isinstance(solved, NoWayLeftError):
                raise solved
            coarse = too_coarse(last.solved, solved) if last else ""
            solved = warned(solved, [coarse]) if coarse else solved
            models.add(solved)
            number += 1
            dissipated += float(solved.summary["solution"].get("dissipated_work", 0.0))
            factors = dict(scene.loading_at(step - 1, float(part[1])).factors)
            last = SolvedIncrement(place, factors, solved, dissipated, halved)
            yield last
            if not solved.solution.converged:
                return


Part = tuple[Fraction, Fraction]
"""From which share of a step to which."""


def _parts(over: Fraction, increments: int) -> list[Part]:
    """The increments of a step from a share on, the last one first."""
    ends = [Fraction(k, increments) for k in range(1, increments + 1)]
    ends = [over, *(end for end in ends if end > over)]
    return list(zip(ends[:-1], ends[1:], strict=True))[::-1]


def _halvings(part: Part, increments: int) -> int:
    """How often an increment was halved."""
    return max(0, round(math.log2(1 / ((part[1] - part[0]) * increments))))


def _solved(
    scene: Scene,
    comm: MPI.Intracomm,
    place: Place,
    monitor_of: Callable[[Place], Monitor | None],
    tell: Tell | None,
    models: IncrementModels,
) -> SolvedScene | NoWayLeftError:
    """The answer to an increment, or why there is none (collective)."""
    loading = scene.loading_at(place.step - 1, float(place.share))
    try:
        return solve_scene(
            scene.under(loading), comm, monitor_of(place), tell=tell, start=models, cases=models
        )
    except LeavesInStepError:
        raise
    except NoEquilibriumError as error:
        raise NoEquilibriumError(f"{loading.name}: {error}") from error
    except NoWayLeftError as error:
        return error


def too_coarse(before: SolvedScene, now: SolvedScene) -> str:
    """A sentence where slips turn so far from one increment to the next that both are too large.

    Collective; empty where they do not, or nothing has friction.
    """
    if not now.model.scene.has_friction or len(before.nodes.slip) != len(now.nodes.slip):
        return ""
    lengths = [np.linalg.norm(solved.nodes.slip, axis=1) for solved in (before, now)]
    still = now.solution.tolerance * now.solution.measures.displacement
    slides = (lengths[0] > still) & (lengths[1] > still)
    along = np.einsum("ni,ni->n", before.nodes.slip, now.nodes.slip)
    turned = slides & (np.abs(along) < math.cos(TURNED) * lengths[0] * lengths[1])
    of_slides, of_turned = now.model.comm.allreduce(np.array([slides.sum(), turned.sum()]))
    if of_turned <= MANY * of_slides:
        return ""
    return (
        f"the slip of {of_turned:,} of {of_slides:,} sliding nodes turns aside by more than "
        f"{math.degrees(TURNED):.0f}° from one increment to the next, and an increment knows its "
        "slip as a whole alone: give the step more increments"
    )


def _is_final(solved: SolvedScene | NoWayLeftError) -> bool:
    """Whether smaller increments would not help, or the user wants no more."""
    if isinstance(solved, NoWayLeftError):
        return False
    return solved.solution.converged or solved.solution.reason is Reason.STOPPED
