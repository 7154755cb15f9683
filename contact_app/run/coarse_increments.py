"""Test whether the increments of a load history are too coarse for its answer.

An increment knows the slips at its beginning and end, not the path between. The answer depends on
the path where

* slips turn aside from one increment to the next, or
* points with Coulomb friction close or open within the increment: a point that closes and sticks is
  held where it was at the start of the increment, not where it touched. The last increment of a
  step is tested: if a step begins without contact, points close in its first increments, however
  small these are, and little of their error remains at the end.

Neither determines the size of the error: if every point closes, it is anything from zero to 40 % of
the slip limits (`python -m tests.stability.increments`). So in either case the increment is solved
once more in two halves, and a warning follows if this changes the answer. It costs about as much as
the increment itself, and is done once per step.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

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
"""Tolerance of the halves: it only has to show changes of a hundredth."""

LEAST, TIMES = 60, 1.5
"""Iterations that the halves may take.

The larger of this number and this factor times those of the increment.
"""

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

    @property
    def matters(self) -> bool:
        """Whether the change causes a warning."""
        return self.forces > FORCES or self.displacements > MOVED


class CoarseIncrements:
    """Finds increments that are too coarse, at most one per step; methods are collective.

    Parameters
    ----------
    models
        Models of the increments; the last added one is the increment before.
    """

    def __init__(self, models: IncrementModels) -> None:
        self._models = models
        self._checked: set[int] = set()

    def warning(
        self,
        step: int,
        at_end: bool,
        middle: Callable[[], Scene],
        solved: tuple[SolvedScene | None, SolvedScene],
        monitor: Callable[[], Monitor | None],
    ) -> str:
        """A warning if the last increment is too coarse; otherwise empty.

        Parameters
        ----------
        step, at_end
            Step of the increment, and whether it is the last increment of the step.
        middle
            Returns the scene with the loads half-way through the increment.
        solved
            The increment before, if there is one, and the last one.
        monitor
            Returns the monitor of the halves.
        """
        before, now = solved
        done = step in self._checked or not now.solution.converged
        if done or not now.model.scene.has_friction:
            return ""
        closing = _closing(self._models, now) if at_end else ""
        suspicions = [s for s in (_turning(before, now), closing) if s]
        if not suspicions:
            return ""
        self._checked.add(step)
        reasons = "; ".join(suspicions)
        text = f"the friction forces may depend on the size of this increment ({reasons})"
        change = halved(self._models, middle(), now, monitor())
        if change is None:
            return (
                f"{text}. The test with two half increments did not finish within its limit of "
                "iterations: solve the step with more increments and compare"
            )
        if not change.matters:
            return ""
        return (
            f"halving this increment changes friction forces by {percent(change.forces)} of "
            f"their limits and displacements by {percent(change.displacements)} of the "
            f"largest ({reasons}): give the step more increments"
        )


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
    options = replace(model_now.scene.solver, tolerance=max(TOLERANCE, now.solution.tolerance))
    limited = together(monitor, _Patience(max(LEAST, int(TIMES * now.solution.counts.hessian))))
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
    found = _change(now, second.multiplier, second.displacements)
    if comm.rank == 0:
        log.info(
            "%s in halves, %d Hessian multiplications: friction forces change by %.2g %% of their "
            "limits, displacements by %.2g %% of the largest",
            now.model.scene.case, first.counts.hessian + second.counts.hessian,
            100 * found.forces, 100 * found.displacements,
        )  # fmt: skip
    return found


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
    own = np.array(
        [
            max((float(np.abs(a - b).max(initial=0.0)) for a, b in pairs), default=0.0),
            max((float(np.abs(b).max(initial=0.0)) for _, b in pairs), default=0.0),
        ]
    )
    change, largest = np.max(comm.allgather(own), axis=0)
    return Change(
        float(moved / limits) if limits > 0.0 else 0.0,
        float(change / largest) if largest > 0.0 else 0.0,
    )
