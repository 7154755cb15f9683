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

from collections.abc import Callable
from dataclasses import replace

from contact_app.scene import SolverOptions
from contact_app.solution import Accuracy, Solution

SHARE = 0.1
"""Algebraic error over discretisation error where an automatic solve ends."""

LOOSEST = 3e-2
"""Largest tolerance that is chosen."""

Assess = Callable[[Solution], Accuracy]


class Target:
    """A tolerance that is given.

    Attributes
    ----------
    tolerance
        What the certificate's numbers have to meet.
    patience
        Outer iterations that may pass between a certificate that failed and the next.
    """

    patience = 0

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance

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

    patience = 3

    def __init__(self, assess: Assess, tightest: float) -> None:
        super().__init__(LOOSEST)
        self._assess, self._tightest = assess, tightest

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate, which fails until enough is enough."""
        loosely = super().judge(solution)
        if not loosely.converged:
            return loosely
        accuracy = self._assess(solution)
        limit = max(SHARE * accuracy.discretisation, self._tightest)
        chosen = min(limit, LOOSEST)
        judged = solution.certificate.judged(chosen)
        if accuracy.algebraic > limit:
            judged = replace(judged, passed=False)
        if not judged.passed:
            excess = max(accuracy.algebraic / limit, 2.0)
            self.tolerance = min(chosen, self.tolerance / excess)
        return replace(solution, certificate=judged, tolerance=chosen, accuracy=accuracy)


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
