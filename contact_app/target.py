"""When a solve has gone far enough.

A tolerance that is a number is met when every number of the certificate is below it. With
`tolerance: auto` the mesh decides: the solve ends when its error is a tenth of the mesh's, both in
energy norm and relative, the one bounded by the duality gap and the other estimated from the
stresses of the iterate itself. That tenth is the tolerance chosen, which the certificate's other
numbers meet as well. Squares of errors add up: the total is then half a percent above what the
mesh alone would leave.

The estimate costs a fraction of a solve's outer iteration or two. It is made once penetration and
jumps are below the loosest tolerance; an iterate's algebraic error, a tenth of it at the end,
hardly disturbs it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from contact_app.scene import SolverOptions
from contact_app.solution import Accuracy, Solution

SHARE = 0.1
"""Algebraic error over discretisation error where an automatic solve ends."""

LOOSEST = 3e-2
"""Largest tolerance that is chosen."""

NEARLY = 1.2
"""Gap over that which a tenth of the mesh's last known error allows, above which no new estimate
of that error is made."""

GAIN = 4.0
"""What the next set of touching rows takes off the error at best."""

Assess = Callable[[Solution], Accuracy]


class Target:
    """A tolerance that is given.

    Attributes
    ----------
    tolerance
        What the certificate's numbers have to meet.
    patience
        Products that may pass between a certificate that failed and the next.
    relaxations
        Steps that sharpen the duality gap of certificates.
    eager
        Whether answers are tried before it is settled what touches.
    """

    patience = 0
    relaxations = 0
    eager = False

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance

    def worth_trying(self, worst: float) -> bool:
        """Whether an answer with that largest jump has a chance before contact is settled."""
        return self.eager and worst <= self.tolerance

    def try_early(self, solution: Solution) -> Solution:
        """As `judge`, without consequence where it fails."""
        return self.judge(solution)

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate; may tighten the tolerance."""
        certificate = solution.certificate.judged(self.tolerance)
        return replace(solution, certificate=certificate, tolerance=self.tolerance)


class AutomaticTarget(Target):
    """A tolerance that follows the discretisation error.

    Parameters
    ----------
    assess
        Estimates the errors of an answer (collective).
    tightest
        Smallest tolerance that is chosen: where the mesh is exact, or nearly so.
    """

    patience = 6
    relaxations = 3
    eager = True

    def __init__(self, assess: Assess, tightest: float) -> None:
        super().__init__(LOOSEST)
        self._assess, self._tightest = assess, tightest
        self._enough: tuple[float, float] | None = None
        self._left_out = 0

    def worth_trying(self, worst: float) -> bool:
        """Whether an answer has a chance; after one that failed badly some are passed over."""
        chosen = self._enough[0] if self._enough else LOOSEST
        if worst > chosen or self._left_out:
            self._left_out = max(self._left_out - 1, 0)
            return False
        return True

    def try_early(self, solution: Solution) -> Solution:
        """As `judge`, without consequence where it fails but a wait."""
        tolerance, enough = self.tolerance, self._enough
        judged = self.judge(solution)
        if not judged.converged:
            self.tolerance = tolerance
            known = self._enough or enough
            allowed = known[1] if known else LOOSEST**2 * abs(solution.measures.energy)
            excess = math.sqrt(max(solution.measures.gap / (allowed or 1.0), 1.0))
            self._left_out = int(math.log(excess) / math.log(GAIN))
        return judged

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate, which fails until enough is enough.

        The error of the mesh is estimated where a first certificate passes loosely, and again
        where the gap that it then asked for is met.
        """
        gap = solution.measures.gap
        if self._enough is None:
            loosely = super().judge(solution)
            if not loosely.converged:
                return loosely
        else:
            chosen, enough = self._enough
            loosely = replace(
                solution, certificate=solution.certificate.judged(chosen), tolerance=chosen
            )
            if not loosely.converged:
                return loosely
            if gap > NEARLY * enough:
                self._tighten(math.sqrt(gap / enough))
                return replace(loosely, certificate=replace(loosely.certificate, passed=False))
        accuracy = self._assess(solution)
        limit = max(SHARE * accuracy.discretisation, self._tightest)
        chosen = min(limit, LOOSEST)
        judged = solution.certificate.judged(chosen)
        if accuracy.algebraic > limit:
            judged = replace(judged, passed=False)
            self._enough = chosen, gap * (limit / accuracy.algebraic) ** 2
        if not judged.passed:
            self._tighten(accuracy.algebraic / limit)
            self.tolerance = min(chosen, self.tolerance)
        return replace(solution, certificate=judged, tolerance=chosen, accuracy=accuracy)

    def _tighten(self, excess: float) -> None:
        """Ask for residuals that are smaller by as much as the error has to fall."""
        self.tolerance /= max(excess, 2.0)


def aim(options: SolverOptions, assess: Assess | None) -> Target:
    """The target that a scene's tolerance means.

    Raises
    ------
    ValueError
        An automatic tolerance without anything to assess an answer with.
    """
    if options.tolerance != "auto":
        return Target(options.tolerance)
    if assess is None:
        raise ValueError("an automatic tolerance needs an estimate of the error")
    return AutomaticTarget(assess, options.tightest)
