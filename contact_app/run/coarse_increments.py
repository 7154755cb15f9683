"""Test whether the increments of a load history are too coarse for its answer.

An increment knows the slips at its beginning and end, not the path between. Slips that turn aside,
and points that close or open, are signs that the answer depends on it
(`contact_app.run.path_dependence`).

Neither determines the size of the error: if every point closes, it is anything from zero to 40 % of
the slip limits (`python -m tests.stability.increments`). So in either case the answer is compared
with one in other increments:

* A step of one increment is solved once more in two halves, which costs about as much as itself.
* A step of several increments is solved a second time in half as many, each twice as long, from the
  first increment on that shows either sign. A coarse increment begins with the multipliers of the
  answer. Since the error is of first order in the size of increments, halving them changes the end
  of the step by about half as much as doubling them did.

A warning follows if halving changes, or would change, the answer.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.increment_models import IncrementModels
from contact_app.run.other_increments import Change, change_to, halved, in_twice_the_length
from contact_app.run.path_dependence import closing, turning
from contact_app.scene.rigid import RigidBodies
from contact_app.scene.scene import Scene
from meshes.arrays import Array
from solver.qp.result import Monitor

UNFINISHED = (
    "the friction forces may depend on the size of {of} ({reasons}). The test with {other} "
    "did not finish within its limit of iterations: solve the step with more increments and compare"
)

log = logging.getLogger("contact_app")


@dataclass
class _Coarser:
    """The part of a step that is also solved in increments of twice the length."""

    step: int = 0
    number: int = 0
    """Number of its increments so far."""
    last: RigidBodies | None = None
    displacements: list[Array] | None = None
    """Rigid bodies and displacements at the begin of the present increment of twice the length; the
    bodies are None before the first load."""
    differs: bool = False
    """Whether these displacements are not those of the answer."""
    reasons: list[str] = field(default_factory=list)
    """Phrases on increments in which the answer depends on the path."""
    failed: bool = False
    """Whether an increment of twice the length has no answer."""
    multiplications: int = 0
    """Hessian multiplications of the increments of twice the length."""


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
        reasons = [s for s in (turning(before, now), closing(self._models, now)) if s]
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
        before = coarser.last, coarser.displacements
        in_pairs = in_twice_the_length(models, before, now, monitor())
        if in_pairs is None:
            coarser.failed = True
            return UNFINISHED.format(
                of="the increments", other="half as many", reasons=coarser.reasons[0]
            )
        coarser.displacements, coarser.differs = in_pairs.displacements, True
        coarser.multiplications += in_pairs.counts.hessian
        if not at_end:
            return ""
        of_pairs = in_pairs.multiplier, in_pairs.displacements
        change = change_to(now.model.problem, now.solution, *of_pairs)
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
