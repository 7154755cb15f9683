"""A load history, solved increment by increment.

With friction each increment is the incremental quasi-static problem: slip w is measured from the
end of the last increment, so that the tangential rows ask for B u - B u_last = 0 where a point
sticks, and where it slides the friction force is at its limit along w. Everything else is a load
case of the model that all increments share (`run.increment_models`).

An increment without a certified answer is halved, and its halves again, up to `HALVINGS` times.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.model.method import chosen
from contact_app.model.outline import Tell
from contact_app.run.coarse_increments import CoarseIncrements
from contact_app.run.fallback import NoWayLeftError
from contact_app.run.increment_models import IncrementModels
from contact_app.run.solve import solve_scene
from contact_app.run.step_equilibrium import LeavesInStepError
from contact_app.run.ways import warned
from contact_app.scene.scene import Scene
from solver.qp.result import Monitor, Reason

HALVINGS = 4
"""Times that an increment without a certified answer is halved."""

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
    number, dissipated, coarse = begin.number, begin.dissipated, CoarseIncrements(models)
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
            half_way = Place(step, (part[0] + part[1]) / 2, place.number)
            said = coarse.warning(
                step, part[1] == 1, partial(_loaded, scene, half_way),
                (last.solved if last else None, solved), partial(monitor_of, place),
            )  # fmt: skip
            solved = warned(solved, [said]) if said else solved
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
    loaded = _loaded(scene, place)
    try:
        return solve_scene(loaded, comm, monitor_of(place), tell=tell, start=models, cases=models)
    except LeavesInStepError:
        raise
    except NoEquilibriumError as error:
        raise NoEquilibriumError(f"{loaded.case}: {error}") from error
    except NoWayLeftError as error:
        return error


def _loaded(scene: Scene, place: Place) -> Scene:
    """The scene as it is loaded at a place of its history."""
    return scene.under(scene.loading_at(place.step - 1, float(place.share)))


def _is_final(solved: SolvedScene | NoWayLeftError) -> bool:
    """Whether smaller increments would not help, or the user wants no more."""
    if isinstance(solved, NoWayLeftError):
        return False
    return solved.solution.converged or solved.solution.reason is Reason.STOPPED
