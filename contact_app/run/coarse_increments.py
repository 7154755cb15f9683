"""Test whether the increments of a load history are too coarse for its answer.

An increment knows the slips at its beginning and end, not the path between. The answer depends on
the path where

* slips turn aside from one increment to the next, or
* points with Coulomb friction close or open within the increment: a point that closes and sticks is
  held where it was at the start of the increment, not where it touched.

Neither determines the size of the error: if every point closes, it is anything from zero to 40 % of
the slip limits (`python -m tests.stability.increments`). So in either case the answer is compared
with one in other increments:

* A step of one increment is solved once more in two halves, which costs about as much as itself.
* A step of several increments is solved beside its increments in half as many, each twice as long,
  from the first of them on in which either is seen. A coarse increment begins with the multipliers
  of the answer. Since the error is of first order in the size of increments, halving them changes
  the end of the step by about half as much as doubling them did.

A warning follows if halving changes, or would change, the answer.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.timings import Timings
from contact_app.results.friction import closing_points
from contact_app.results.percent import percent
from contact_app.run.increment_models import IncrementModels
from contact_app.run.progress import together
from contact_app.scene.scene import Scene
from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.driver import solve
from solver.qp.result import Monitor, Step

TURNED = math.pi / 6.0
"""Angle between the lines along which a node slips in two increments, from which on it counts as
turned: the friction force in between is off by up to half of itself. A slip that is reversed does
not count: the node sticks in between, and the load at which that ends is met exactly."""

MANY = 0.1
"""Share of the sliding nodes that may turn unchecked."""

CLOSING = 0.2
"""Share of the points that may close or open unchecked. Of 54 random scenes loaded in one increment
and in twelve, friction forces differ by more than 5 % of their limits in 16 of 28 with more, and in
2 of 26 with fewer, both with given limits. Halving finds 15 of these 18."""

FORCES, MOVED = 0.05, 0.01
"""Smallest changes by halving that cause a warning.

Of friction forces over their limits, and of displacements over the largest.
"""

TOLERANCE = 1e-3
"""Tolerance of the other increments: it only has to show changes of a hundredth."""

LEAST, TIMES = 60, 1.5
"""Iterations that both halves, or one increment of twice the length, may take.

The larger of this number and this factor times those of the increment.
"""

UNFINISHED = (
    "the friction forces may depend on the size of {of} ({reasons}). The test with {other} "
    "did not finish within its limit of iterations: solve the step with more increments and compare"
)

log = logging.getLogger("contact_app")


@dataclass(frozen=True)
class Change:
    """The change by halving an increment.

    Attributes
    ----------
    forces
        Sum of the changes of friction forces over that of their limits.
    displacements
        Largest change of a component over the largest.
    """

    forces: float
    displacements: float

    def __str__(self) -> str:
        return (
            f"friction forces by {percent(self.forces)} of their limits and displacements by "
            f"{percent(self.displacements)} of the largest"
        )

    @property
    def matters(self) -> bool:
        """Whether the change causes a warning."""
        return self.forces > FORCES or self.displacements > MOVED


@dataclass
class _Coarser:
    """The part of a step that is also solved in increments of twice the length.

    Attributes
    ----------
    step
        Number of the step.
    number
        Number of its increments so far.
    last, displacements
        Scene and displacements at the begin of the present increment of twice the length; the scene
        is None before the first load.
    differs
        Whether these displacements are not those of the answer.
    reasons
        Phrases on increments in which the answer depends on the path.
    failed
        Whether an increment of twice the length has no answer.
    multiplications
        Hessian multiplications of the increments of twice the length.
    """

    step: int = 0
    number: int = 0
    last: Scene | None = None
    displacements: list[NDArray[np.float64]] | None = None
    differs: bool = False
    reasons: list[str] = field(default_factory=list)
    failed: bool = False
    multiplications: int = 0


class CoarseIncrements:
    """Finds steps whose increments are too coarse; methods are collective.

    Parameters
    ----------
    models
        Models of the increments; the last added one is the increment before.
    """

    def __init__(self, models: IncrementModels) -> None:
        self._models = models
        self._coarser = _Coarser()

    def warning(
        self,
        step: int,
        is_single: bool,
        at_end: bool,
        middle: Callable[[], Scene],
        solved: tuple[SolvedScene | None, SolvedScene],
        monitor: Callable[[], Monitor | None],
    ) -> str:
        """A warning at the end of a step with too coarse increments; otherwise empty.

        Parameters
        ----------
        step, is_single, at_end
            Step of the last increment, whether it is the whole step, and whether it ends the step.
        middle
            Returns the scene with the loads half-way through the increment.
        solved
            The increment before, if there is one, and the last one.
        monitor
            Returns the monitor of the other increments.
        """
        before, now = solved
        if not now.solution.converged or not now.model.scene.has_friction:
            return ""
        reasons = [s for s in (_turning(before, now), _closing(self._models, now)) if s]
        if not is_single:
            return self._along_step(step, at_end, reasons, now, monitor)
        if not reasons:
            return ""
        why = "; ".join(reasons)
        change = halved(self._models, middle(), now, monitor())
        if change is None:
            return UNFINISHED.format(of="this increment", other="two half increments", reasons=why)
        if not change.matters:
            return ""
        return f"halving this increment changes {change} ({why}): give the step more increments"

    def _along_step(
        self,
        step: int,
        at_end: bool,
        reasons: list[str],
        now: SolvedScene,
        monitor: Callable[[], Monitor | None],
    ) -> str:
        """A warning at the end of a step of several increments; empty before its end."""
        coarser, models = self._coarser, self._models
        if coarser.step != step:
            coarser = self._coarser = _Coarser(step)
        if coarser.number % 2 == 0:
            coarser.last = models.last
            if not coarser.differs:
                coarser.displacements = models.displacements
        coarser.number += 1
        coarser.reasons += reasons
        if coarser.failed or not coarser.reasons or not (at_end or coarser.number % 2 == 0):
            return ""
        in_pairs = self._in_twice_the_length(now, monitor())
        if in_pairs is None:
            coarser.failed = True
            return UNFINISHED.format(
                of="the increments", other="half as many", reasons=coarser.reasons[0]
            )
        coarser.displacements, coarser.differs = in_pairs.displacements, True
        coarser.multiplications += in_pairs.counts.hessian
        if not at_end:
            return ""
        change = _change(now, in_pairs.multiplier, in_pairs.displacements)
        if now.model.comm.rank == 0:
            log.info(
                "step %d in half as many increments, %d Hessian multiplications: changes %s",
                step, coarser.multiplications, change,
            )  # fmt: skip
        change = Change(change.forces / 2.0, change.displacements / 2.0)
        if not change.matters:
            return ""
        return (
            f"by estimate, halving the increments of this step changes {change}, half as much as "
            f"doubling them does ({coarser.reasons[0]}): give the step more increments"
        )

    def _in_twice_the_length(self, now: SolvedScene, monitor: Monitor | None) -> Solution | None:
        """The answer of one increment in place of the last two; None if it is unknown."""
        coarser, model, comm = self._coarser, now.model, now.model.comm
        begin = coarser.displacements
        if begin is None:
            begin = [np.zeros_like(u) for u in now.solution.displacements]
        if model.scene.rigid_bodies:
            moved = self._models.after(coarser.last, begin)
            problem = moved.model(model.scene, Timings(), model.needed, None).problem
        else:
            problem = model.problem.with_slip_from(begin)
        if not comm.allreduce(int(problem.size == model.problem.size), op=MPI.MIN):
            return None
        answer = solve(problem, *_loosely(now, monitor), start=now.solution.multiplier)
        return answer if answer.converged else None


def _turning(before: SolvedScene | None, now: SolvedScene) -> str:
    """Phrase with the number of slips that change direction between increments; empty if few do."""
    if before is None or len(before.nodes.slip) != len(now.nodes.slip):
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
        f"at {of_turned:,} of {of_slides:,} sliding nodes the direction of slip turns by more than "
        f"{math.degrees(TURNED):.0f}°"
    )


def _closing(models: IncrementModels, now: SolvedScene) -> str:
    """Phrase with the number of points with Coulomb friction that close or open.

    Empty if few do.
    """
    changed, touching = closing_points(
        now.model.problem, now.solution, models.displacements, models.approach(now.model)
    )
    if changed <= CLOSING * touching:
        return ""
    return f"{changed:,} of {touching:,} contact points with friction close or open in it"


def halved(
    models: IncrementModels, middle: Scene, now: SolvedScene, monitor: Monitor | None
) -> Change | None:
    """Solve an increment in two halves and return the change; None if it is unknown.

    Parameters
    ----------
    middle
        The scene with the loads half-way through the increment.
    """
    model_now, comm = now.model, now.model.comm
    halfway = replace(
        middle, solver=model_now.scene.solver, decomposition=model_now.scene.decomposition
    )
    rigid = bool(middle.rigid_bodies)  # each of their placements has a model of its own
    model = models.model(halfway, Timings(), "all" if rigid else model_now.needed, None)
    same = rigid or model.problem.B is model_now.problem.B
    if not comm.allreduce(int(same), op=MPI.MIN):
        return None
    options, limited = _loosely(now, monitor)
    first = solve(model.problem, options, limited, start=models.on(model))
    if not first.converged:
        return None
    if rigid:
        moved = models.after(halfway, first.displacements)
        problem = moved.model(model_now.scene, Timings(), model_now.needed, None).problem
    else:
        problem = model_now.problem.with_slip_from(first.displacements)
    if not comm.allreduce(int(problem.size == model_now.problem.size), op=MPI.MIN):
        return None
    second = solve(problem, options, limited, start=now.solution.multiplier)
    if not second.converged:
        return None
    change = _change(now, second.multiplier, second.displacements)
    if comm.rank == 0:
        log.info(
            "%s in halves, %d Hessian multiplications: changes %s",
            now.model.scene.case, first.counts.hessian + second.counts.hessian, change,
        )  # fmt: skip
    return change


def _loosely(now: SolvedScene, monitor: Monitor | None) -> tuple[SolverOptions, Monitor | None]:
    """Options with the tolerance of the test, and a monitor with its limit of iterations."""
    options = replace(now.model.scene.solver, tolerance=max(TOLERANCE, now.solution.tolerance))
    iterations = max(LEAST, int(TIMES * now.solution.counts.hessian))
    return options, together(monitor, _Patience(iterations))


class _Patience:
    """A monitor that stops solves after a total number of iterations."""

    def __init__(self, iterations: int) -> None:
        self._left = iterations

    def __call__(self, step: Step) -> bool:
        self._left -= 1
        return self._left < 0


def _change(
    now: SolvedScene, multiplier: NDArray[np.float64], displacements: list[NDArray[np.float64]]
) -> Change:
    """Difference between two answers with the same rows."""
    comm, points, solution = now.model.comm, now.model.problem.friction, now.solution
    sums = np.zeros(2)
    if points is not None:
        forces = points.forces(multiplier) - points.forces(solution.multiplier)
        sums[:] = points.sizes(forces).sum(), points.slip_limits(solution.multiplier).sum()
    moved, limits = comm.allreduce(sums)
    pairs = list(zip(displacements, solution.displacements, strict=True))
    slipped = np.array(
        [
            max((float(np.abs(a - b).max(initial=0.0)) for a, b in pairs), default=0.0),
            max((float(np.abs(b).max(initial=0.0)) for _, b in pairs), default=0.0),
        ]
    )
    change, largest = np.max(comm.allgather(slipped), axis=0)
    return Change(
        float(moved / limits) if limits > 0.0 else 0.0,
        float(change / largest) if largest > 0.0 else 0.0,
    )
