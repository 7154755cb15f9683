"""When a solve has gone far enough.

A tolerance that is a number is met when every number of the certificate is below it. With
`tolerance: auto` the mesh decides: the solve ends when its error is a tenth of the mesh's, both in
energy norm and relative, the one bounded by the duality gap and the other estimated from the
stresses of the iterate itself. That tenth is the tolerance chosen, which the certificate's other
numbers meet as well. Squares of errors add up: the total is then half a percent above what the
mesh alone would leave.

The estimate is made once jumps and error of an answer are below the loosest tolerance, and again
only where the error of the solver disturbed it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from solver.contact.options import SolverOptions
from solver.contact.solution import Accuracy, Solution

SHARE = 0.1
"""Algebraic error over discretisation error where an automatic solve ends."""

LOOSEST = 3e-2
"""Largest tolerance that is chosen."""

NEARLY = 1.2
"""Gap over that which a tenth of the mesh's last known error allows, above which no new estimate
of that error is made."""

GAIN = 8.0
"""Factor by which the error falls at most from one answer to the next: where the error is
larger than allowed by n such factors, the next n answers are passed over."""

SHARPENS = 20.0
"""Factor by which a sharper duality gap is smaller at most."""

AGAIN = 0.7
"""Factor on the error asked of the next answer of an active set after one that failed."""

STEADY = 0.15
"""Algebraic error over that of the mesh below which the latter's estimate is not made again: it is
right to a few per cent then, although jumps between subdomains disturb it more than the error."""

Assess = Callable[[Solution], Accuracy]

Gap = Callable[[bool], float]


class StoppingRule:
    """Stops at a tolerance that is given.

    Attributes
    ----------
    tolerance
        What the certificate's numbers have to meet.
    patience
        Operator applications that may pass between a certificate that failed and the next.
    relaxations
        Steps that sharpen the duality gap of certificates.
    may_end_early
        Whether answers are tried before the active set is settled.
    """

    patience = 0
    relaxations = 0
    may_end_early = False

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance

    def required_reduction(self, worst: float, strained: float, gap: Gap) -> float:
        """Factor by which the error of an answer has to fall before it is worth a certificate.

        Parameters
        ----------
        worst
            Largest jump or penetration, over the largest displacement.
        strained
            Twice the energy of its strains.
        gap
            Tells the duality gap without contact forces that pull; sharper, for a price, if asked.
        """
        return worst / self.tolerance

    def required_of_certified(self, solution: Solution) -> float:
        """The same of an answer whose certificate failed, as far as that tells."""
        return solution.certificate.required_reduction(self.tolerance)

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate; may tighten the tolerance."""
        certificate = solution.certificate.judged(self.tolerance)
        return replace(solution, certificate=certificate, tolerance=self.tolerance)


class AutomaticRule(StoppingRule):
    """Stops at a tolerance that follows the discretisation error.

    Parameters
    ----------
    assess
        Estimates the errors of an answer (collective).
    tightest
        Smallest tolerance that is chosen: where the mesh is exact, or nearly so.
    """

    patience = 6
    relaxations = 3
    may_end_early = True

    def __init__(self, assess: Assess, tightest: float) -> None:
        super().__init__(LOOSEST)
        self._assess, self._tightest = assess, tightest
        self._enough: tuple[float, float] | None = None
        self._chosen = self._limit = LOOSEST
        self._demand = self._lack = 1.0
        self._wait = 0
        self._assessed: tuple[Accuracy, float] | None = None

    def required_reduction(self, worst: float, strained: float, gap: Gap) -> float:
        """As of a tolerance that is given: of jumps, and of the error that the gap bounds."""
        lack = worst / self._chosen
        if self._wait:
            self._wait -= 1
            self._lack = max(self._lack / GAIN, lack)
            return self._lack
        if lack <= 1.0 and strained > 0.0:
            for sharp in (False, True):
                error = math.sqrt(2.0 * max(gap(sharp), 0.0) / strained)
                if not 1.0 < error / (self._limit * self._demand) <= SHARPENS:
                    break
            lack = max(lack, error / self._limit)
        self._lack = lack / self._demand
        self._wait = int(math.log(max(self._lack, 1.0)) / math.log(GAIN))
        return self._lack

    def required_of_certified(self, solution: Solution) -> float:
        """Nothing that `required_reduction` does not know: `judge` has set the limits of both."""
        return 1.0

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate, which fails until enough is enough.

        The error of the mesh is estimated where a first certificate passes loosely, and again
        where the gap that it then asked for is met.
        """
        limit = self._limit
        judged = self._judge(solution)
        known = limit == self._limit  # what was asked for is what the mesh asks for
        self._demand = AGAIN * self._demand if known and not judged.converged else 1.0
        return judged

    def _judge(self, solution: Solution) -> Solution:
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
        accuracy = self._accuracy(solution)
        limit = max(self._tightest, SHARE * accuracy.discretisation)  # the first of them for NaN
        excess = accuracy.excess(SHARE, self._tightest)
        chosen = min(limit, LOOSEST)
        self._chosen, self._limit = chosen, limit
        judged = solution.certificate.judged(chosen)
        if excess > 1.0:
            judged = replace(judged, passed=False)
            self._enough = chosen, gap / excess**2
        if not judged.passed:
            self._tighten(excess)
            self.tolerance = min(chosen, self.tolerance)
        return replace(solution, certificate=judged, tolerance=chosen, accuracy=accuracy)

    def _accuracy(self, solution: Solution) -> Accuracy:
        """Errors of an answer; that of the mesh as it was where the last answer told it well."""
        gap = solution.measures.gap
        if self._assessed is None or self._assessed[0].excess(STEADY, 0.0) > 1.0:
            accuracy = self._assess(solution)
        else:
            last, its_gap = self._assessed
            accuracy = last.resolved(math.sqrt(max(gap, 0.0) / its_gap) if its_gap > 0.0 else 0.0)
        self._assessed = accuracy, gap
        return accuracy

    def _tighten(self, excess: float) -> None:
        """Ask for residuals that are smaller by as much as the error has to fall."""
        self.tolerance /= max(excess, 2.0)


def stopping_rule(options: SolverOptions, assess: Assess | None) -> StoppingRule:
    """The rule that a scene's tolerance means.

    Raises
    ------
    ValueError
        An automatic tolerance without anything to assess an answer with.
    """
    if options.tolerance != "auto":
        return StoppingRule(options.tolerance)
    if assess is None:
        raise ValueError("an automatic tolerance needs an estimate of the error")
    return AutomaticRule(assess, options.tightest)
