"""A load history, solved increment by increment.

With friction each increment is the incremental quasi-static problem: slip w is measured from the
end of the last increment, so the tangential rows require B u - B u_last = 0 where a point sticks,
and where it slides the friction force is at its limit along w. All increments share one model
(`run.increment_models`).

An increment without a certified answer, or from whose end a body leaves, is halved, and its halves
again, up to `HALVINGS` times: so the factor at which a body leaves is known to 1/16 of an
increment. If Total FETI does not certify an increment, multigrid solves it and goes on with the
history. If multigrid does not certify the first half or the smallest part, Total FETI solves that
part and goes on.
"""

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.model.method import LIMITS, is_undecomposed
from contact_app.model.outline import Report
from contact_app.run.coarse_increments import CoarseIncrements
from contact_app.run.fallback import NoWayLeftError
from contact_app.run.increment_models import IncrementModels
from contact_app.run.solve import solve_scene
from contact_app.run.step_equilibrium import LeavesInStepError
from contact_app.run.summary import warned
from contact_app.scene.scene import Scene
from solver.contact.options import SolverOptions
from solver.qp.result import Monitor, Reason
from solver.tfeti.friction_share import NEAR, overcome

HALVINGS = 4
"""Largest number of halvings of an increment without a certified answer."""

log = logging.getLogger("contact_app")


@dataclass(frozen=True)
class Place:
    """A place in a load history."""

    step: int
    """Number of the step, from one."""
    share: Fraction
    """Share of the step, in (0, 1]: its factor."""
    number: int
    """Number of the increment that ends here, from one, over all steps."""
    halved: int = 0
    """Number of halvings of the requested increment for the part of it that ends here."""

    @property
    def time(self) -> float:
        """Time in units of steps: the end of the first step is at 1."""
        return float(self.step - 1 + self.share)


@dataclass(frozen=True, eq=False)
class SolvedIncrement:
    """An increment with its answer."""

    place: Place
    factors: dict[str, float]
    """Factors of named conditions at the end of the increment."""
    solved: SolvedScene
    dissipated: float
    """Work of friction up to the end of the increment, an energy."""


@dataclass(frozen=True)
class Position:
    """Position in a load history."""

    step: int = 1
    share: Fraction = Fraction(0)
    """The step, from one, and its finished share."""
    number: int = 0
    """Number of finished increments."""
    dissipated: float = 0.0
    """Work of friction so far, an energy."""


def solved_increments(
    scene: Scene,
    comm: MPI.Intracomm,
    monitor_of: Callable[[Place], Monitor | None],
    report: Report | None = None,
    models: IncrementModels | None = None,
    begin: Position | None = None,
) -> Iterator[SolvedIncrement]:
    """Solve the steps of a scene one after another; writes nothing (collective).

    If the history ends early, the last increment has no certified answer.

    Parameters
    ----------
    monitor_of
        Returns the monitor of an increment; called before the increment is solved.
    report
        Called with the scene and the outline of the model of its first increment.
    models, begin
        Models and position after increments that were solved before.

    Raises
    ------
    NoEquilibriumError
        Naming the step, and the factor within it at which a body leaves.
    """
    models = models or IncrementModels(scene, comm)
    begin, scene = begin or Position(), models.scene
    number, dissipated, coarse = begin.number, begin.dissipated, CoarseIncrements(models)
    last: SolvedIncrement | None = None
    for step, step_of_scene in enumerate(scene.steps[begin.step - 1 :], start=begin.step):
        over = begin.share if step == begin.step else Fraction(0)
        ahead = _parts(over, step_of_scene.increments)
        while ahead:
            part = ahead.pop()
            halved = _halvings(part, step_of_scene.increments)
            place = Place(step, part[1], number + 1, halved)
            solved = _solved(scene, comm, place, monitor_of, report, models)
            if _asks_for_other_method(solved, halved, models.scene.solver):
                other = models.by_other_method()
                if other is not None:
                    solved = _solved(other, comm, place, monitor_of, report, models)
            if not _is_final(solved) and halved < HALVINGS:
                middle = (part[0] + part[1]) / 2
                ahead += [(middle, part[1]), (part[0], middle)]
                if comm.rank == 0:
                    log.warning(
                        "step %d: the increment to factor %.6g has no %s: halved",
                        step, float(part[1]), _missing_result(solved),
                    )  # fmt: skip
                continue
            if isinstance(solved, NoEquilibriumError):
                raise LeavesInStepError(
                    f"{scene.at(f'steps[{step - 1}]')}: {between_factors(step, *part)}: "
                    + str(solved).removeprefix(f"{scene.source}: "), float(part[1]),
                ) from solved  # fmt: skip
            if isinstance(solved, NoWayLeftError):
                raise solved
            of_answer = solved.model.scene
            following = models.following(scene, of_answer.decomposition, of_answer.solver.method)
            if following is scene or last is None:
                half_way = float((part[0] + part[1]) / 2)
                message = coarse.warning(
                    step, part[1] - part[0] == 1, part[1] == 1,
                    partial(following.loaded_at, step - 1, half_way),
                    (last.solved if last else None, solved), partial(monitor_of, place),
                )  # fmt: skip
                solved = warned(solved, [message]) if message else solved
            else:  # its displacements are in another order than those of increments before
                coarse = CoarseIncrements(models)
            scene = following
            models.add(solved)
            number += 1
            dissipated += float(solved.summary["solution"].get("dissipated_work", 0.0))
            factors = dict(scene.loading_at(step - 1, float(part[1])).factors)
            last = SolvedIncrement(place, factors, _judged_after(last, solved), dissipated)
            yield last
            if not solved.solution.converged:
                return


def _judged_after(last: SolvedIncrement | None, solved: SolvedScene) -> SolvedScene:
    """An answer, without a certificate judged by the friction of the last one (collective)."""
    if solved.solution.converged or last is None:
        return solved
    before = last.solved.model.problem, last.solved.solution
    return replace(solved, holds=1.0) if overcome(*before, NEAR) else solved


def between_factors(step: int, begin: Fraction | float, end: Fraction | float) -> str:
    """Phrase on a part of a step."""
    return f"step {step}, between its factors {float(begin):.6g} and {float(end):.6g}"


Part = tuple[Fraction, Fraction]
"""Begin and end of an increment, as shares of a step."""

Failed = NoWayLeftError | NoEquilibriumError
"""Reasons why an increment has no answer."""


def _parts(over: Fraction, increments: int) -> list[Part]:
    """The increments of a step after a share, in reverse order."""
    ends = [Fraction(k, increments) for k in range(1, increments + 1)]
    ends = [over, *(end for end in ends if end > over)]
    return list(zip(ends[:-1], ends[1:], strict=True))[::-1]


def _halvings(part: Part, increments: int) -> int:
    """Number of halvings of an increment."""
    return max(0, round(math.log2(1 / ((part[1] - part[0]) * increments))))


def _solved(
    scene: Scene,
    comm: MPI.Intracomm,
    place: Place,
    monitor_of: Callable[[Place], Monitor | None],
    report: Report | None,
    models: IncrementModels,
) -> SolvedScene | Failed:
    """The solution of an increment, or the reason for its failure (collective)."""
    loaded = scene.loaded_at(place.step - 1, float(place.share))
    try:
        return solve_scene(
            loaded, comm, monitor_of(place), report=report, start=models, cases=models
        )
    except LeavesInStepError:
        raise
    except (NoEquilibriumError, NoWayLeftError) as error:
        return error


def _missing_result(solved: SolvedScene | Failed) -> str:
    """The result that an increment did not reach, and the work on it, as a phrase."""
    if isinstance(solved, NoEquilibriumError):
        return "equilibrium"
    counts = solved.counts if isinstance(solved, NoWayLeftError) else solved.solution.counts
    return f"certified answer after {counts.hessian:,} Hessian multiplications"


def _asks_for_other_method(
    solved: SolvedScene | Failed, halved: int, solver: SolverOptions
) -> bool:
    """Whether the other method is tried: multigrid at once, Total FETI on halves (collective).

    Multigrid is not, before the increment is halved, if the user limited the iterations.
    """
    if isinstance(solved, NoEquilibriumError) or _is_final(solved):
        return False
    first_or_last = halved in (1, HALVINGS)
    if first_or_last or is_undecomposed(solver):
        return first_or_last
    reason = solved.solution.reason if isinstance(solved, SolvedScene) else None
    limited = solver.max_iterations <= LIMITS.patience_with_friction
    return reason is not Reason.SLIDES and not (limited and reason is Reason.MAX_ITERATIONS)


def _is_final(solved: SolvedScene | Failed) -> bool:
    """Whether smaller increments would not help, or the user stopped the run."""
    if isinstance(solved, Failed):
        return False
    return solved.solution.converged or solved.solution.reason is Reason.STOPPED
