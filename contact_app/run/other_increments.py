"""The answer of a load increment in increments of another length, and how much it differs."""

import logging
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.timings import Timings
from contact_app.results.percent import percent
from contact_app.run.increment_models import IncrementModels
from contact_app.run.progress import together
from contact_app.scene.rigid import RigidBodies
from contact_app.scene.scene import Scene
from meshes.arrays import Array
from solver.contact.options import SolverOptions
from solver.contact.solution import Guess, Solution
from solver.driver import solve
from solver.qp.result import Monitor, Step
from solver.tfeti.dual import DualProblem

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

log = logging.getLogger("contact_app")


@dataclass(frozen=True)
class Change:
    """The change by halving an increment."""

    forces: float
    """Sum of the changes of friction forces over that of their limits."""
    displacements: float
    """Largest change of a component over the largest."""

    def __str__(self) -> str:
        return (
            f"friction forces by {percent(self.forces)} of their limits and displacements by "
            f"{percent(self.displacements)} of the largest"
        )

    @property
    def matters(self) -> bool:
        """Whether the change causes a warning."""
        return self.forces > FORCES or self.displacements > MOVED


def in_twice_the_length(
    models: IncrementModels,
    before: tuple[RigidBodies | None, list[Array] | None],
    now: SolvedScene,
    monitor: Monitor | None,
) -> Solution | None:
    """The answer of one increment in place of the last two; None if it is unknown (collective).

    Parameters
    ----------
    before
        Rigid bodies and displacements at the begin of the two; None before the first load.
    now
        The last of them.
    """
    rigid, begin = before
    if begin is None:
        begin = [np.zeros_like(u) for u in now.solution.displacements]
    problem = _problem_from(models, rigid, begin, now)
    if problem is None:
        return None
    options = loosely(now.model.scene.solver, now.solution, monitor)
    answer = solve(problem, *options, start=_guess(problem, now.solution))
    return answer if answer.converged else None


def halved(
    models: IncrementModels, middle: Scene, now: SolvedScene, monitor: Monitor | None
) -> Change | None:
    """The change by solving an increment in two halves; None if it is unknown (collective).

    Parameters
    ----------
    middle
        The scene with the loads half-way through the increment.
    """
    model_now, comm = now.model, now.model.comm
    halfway = replace(
        middle, solver=model_now.scene.solver, decomposition=model_now.scene.decomposition
    )
    rigid = bool(middle.rigid.bodies)  # each of their placements has a model of its own
    model = models.model(halfway, Timings(), "all" if rigid else model_now.needed, None)
    same = rigid or model.problem.B is model_now.problem.B
    if not comm.allreduce(int(same), op=MPI.MIN):
        return None
    options, limited = loosely(model_now.scene.solver, now.solution, monitor)
    first = solve(model.problem, options, limited, start=models.on(model))
    if not first.converged:
        return None
    problem = _problem_from(models, middle.rigid, first.displacements, now)
    if problem is None:
        return None
    second = solve(problem, options, limited, start=_guess(problem, now.solution))
    if not second.converged:
        return None
    change = change_to(model_now.problem, now.solution, second.multiplier, second.displacements)
    if comm.rank == 0:
        log.info(
            "%s in halves, %d Hessian multiplications: changes %s",
            now.model.scene.case, first.counts.hessian + second.counts.hessian, change,
        )  # fmt: skip
    return change


def _problem_from(
    models: IncrementModels, rigid: RigidBodies | None, begin: list[Array], now: SolvedScene
) -> DualProblem | None:
    """The problem of an increment that begins elsewhere; None if its rows differ (collective).

    Parameters
    ----------
    rigid, begin
        Rigid bodies, None before the first load, and displacements at its begin.
    now
        The increment.
    """
    model = now.model
    if model.scene.rigid.bodies:
        after = models.after(rigid, begin)
        problem = after.model(model.scene, Timings(), model.needed, None).problem
    else:
        problem = model.problem.with_slip_from(begin)
    same = model.comm.allreduce(int(problem.size == model.problem.size), op=MPI.MIN)
    return problem if same else None


def _guess(problem: DualProblem, near: Solution) -> Guess:
    """A near answer as initial guess, with its slips from the begin of an increment."""
    jumps = problem.jumps(near.displacements)
    return replace(near.guess, jumps=jumps)


def loosely(
    options: SolverOptions, solution: Solution, monitor: Monitor | None
) -> tuple[SolverOptions, Monitor | None]:
    """Options with the tolerance of the test, and a monitor with its limit of iterations."""
    iterations = max(LEAST, int(TIMES * solution.counts.hessian))
    tolerance = max(TOLERANCE, solution.tolerance)
    return replace(options, tolerance=tolerance), together(monitor, _Patience(iterations))


class _Patience:
    """A monitor that stops solves after a total number of iterations."""

    def __init__(self, iterations: int) -> None:
        self._left = iterations

    def __call__(self, step: Step) -> bool:
        self._left -= 1
        return self._left < 0


def change_to(
    problem: DualProblem, solution: Solution, multiplier: Array, displacements: list[Array]
) -> Change:
    """Difference between two answers with the same rows (collective).

    Slip limits below the tolerance times the loads are those of contacts that have opened, and
    displacements below the tolerance times those at the begin are those of unloaded bodies.
    """
    comm, points = problem.comm, problem.friction
    least = solution.tolerance * float(solution.measures.loads.sum())
    forces = points.forces(multiplier) - points.forces(solution.multiplier)
    sums = points.sizes(forces).sum(), points.slip_limits(solution.multiplier).sum()
    moved, limits = comm.allreduce(np.array(sums))
    pairs = list(zip(displacements, solution.displacements, strict=True))
    slipped = np.array(
        [
            max((float(np.abs(a - b).max(initial=0.0)) for a, b in pairs), default=0.0),
            max((float(np.abs(b).max(initial=0.0)) for _, b in pairs), default=0.0),
        ]
    )
    change, largest = np.max(comm.allgather(slipped), axis=0)
    still = solution.tolerance * float(problem.resting_lengths.max())
    return Change(
        float(moved / limits) if limits > least else 0.0,
        float(change / largest) if largest > still else 0.0,
    )
