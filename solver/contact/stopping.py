"""Stopping rules: the accuracy at which a solve ends.

A tolerance that is a number is met when every number of the certificate is below it. With
`tolerance: auto` the mesh decides: the solve ends when the error of the solver is a tenth of the
error of the mesh. Both are relative errors in energy norm. The duality gap bounds the first, and
the second is estimated from the stresses of the iterate. This tenth becomes the tolerance of all
other numbers of the certificate. Squares of errors add up: the total is then half a percent above
what the mesh alone would leave.

The estimate is made once jumps and error of an answer are below the loosest tolerance, and again
only where the error of the solver disturbed it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic

from solver.backend import S
from solver.contact.options import SolverOptions
from solver.contact.solution import Accuracy, Solution

Assess = Callable[[Solution], Accuracy]

Gap = Callable[[], float]


@dataclass(frozen=True)
class AutomaticOptions:
    """The tuned numbers of the automatic tolerance."""

    share: float = 0.1
    """Algebraic error over discretisation error where a solve ends."""
    loosest: float = 3e-2
    """Largest tolerance that is chosen."""
    steady: float = 0.15
    """Error of the solver over the error of the mesh, below which the mesh error is not estimated
    anew: the estimate is then right to a few per cent."""


class StoppingRule:
    """Stop at a given tolerance.

    Attributes
    ----------
    tolerance
        Upper limit of the certificate's numbers.
    patience
        Operator applications between a failed certificate and the next one.
    may_end_early
        Whether answers are certified before the active set has settled.
    """

    patience = 0
    may_end_early = False

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance

    def required_reduction(self, worst: float, strained: float, gap: Gap) -> float:
        """Factor by which the error of an answer has to fall before it is certified.

        Parameters
        ----------
        worst
            Largest jump or penetration, over the largest displacement.
        strained
            Twice the strain energy, a(u, u).
        gap
            Function that returns the duality gap without tensile contact forces.
        """
        return worst / self.tolerance

    def required_of_certified(self, solution: Solution) -> float:
        """Factor by which the error of an answer whose certificate failed has to fall."""
        return solution.certificate.required_reduction(self.tolerance)

    def judge(self, solution: Solution) -> Solution:
        """The answer with the verdict of its certificate; may tighten the tolerance."""
        certificate = solution.certificate.judged(self.tolerance)
        return replace(solution, certificate=certificate, tolerance=self.tolerance)


class AutomaticRule(StoppingRule):
    """Stop at a tolerance that follows the discretisation error.

    Parameters
    ----------
    assess
        Estimates the errors of an answer (collective).
    tightest
        Smallest tolerance that is chosen, for a mesh that is (nearly) exact.
    """

    patience = 6
    may_end_early = True

    def __init__(
        self, assess: Assess, tightest: float, options: AutomaticOptions | None = None
    ) -> None:
        self.options = options = options or AutomaticOptions()
        super().__init__(options.loosest)
        self._assess, self._tightest = assess, tightest
        self._chosen = self._limit = options.loosest
        self._assessed: tuple[Accuracy, float] | None = None

    def required_reduction(self, worst: float, strained: float, gap: Gap) -> float:
        """The factor of `StoppingRule`, for the jumps and for the error that the gap bounds."""
        required = worst / self._chosen
        if required <= 1.0 and strained > 0.0:
            error = math.sqrt(2.0 * max(gap(), 0.0) / strained)
            required = max(required, error / self._limit)
        return required

    def required_of_certified(self, solution: Solution) -> float:
        """One: `judge` has already put the new limits into `required_reduction`."""
        return 1.0

    def judge(self, solution: Solution) -> Solution:
        """The answer with its certificate, which fails until the error is small enough.

        The error of the mesh is estimated once a certificate passes at a loose tolerance. The
        limits that follow from it are in force from then on.
        """
        loosely = solution.certificate.judged(self._chosen)
        if not loosely.passed:
            return replace(solution, certificate=loosely, tolerance=self._chosen)
        accuracy, share = self._accuracy(solution), self.options.share
        limit = max(self._tightest, share * accuracy.discretisation)  # the first of them for NaN
        excess = accuracy.excess(share, self._tightest)
        self._chosen, self._limit = min(limit, self.options.loosest), limit
        judged = solution.certificate.judged(self._chosen)
        judged = replace(judged, passed=judged.passed and excess <= 1.0)
        if not judged.passed:  # residuals have to fall by the factor by which the error has to
            self.tolerance = min(self._chosen, self.tolerance / max(excess, 2.0))
        return replace(solution, certificate=judged, tolerance=self._chosen, accuracy=accuracy)

    def _accuracy(self, solution: Solution) -> Accuracy:
        """Errors of an answer.

        The mesh error is reused where the last estimate is accurate enough.
        """
        gap = solution.measures.gap
        if self._assessed is None or self._assessed[0].excess(self.options.steady, 0.0) > 1.0:
            accuracy = self._assess(solution)
        else:
            last, its_gap = self._assessed
            accuracy = last.resolved(math.sqrt(max(gap, 0.0) / its_gap) if its_gap > 0.0 else 0.0)
        self._assessed = accuracy, gap
        return accuracy


class CertificateTest(Generic[S]):
    """The certificate as the test of the states of active sets.

    Parameters
    ----------
    certified
        The answer of a state with its certificate, judged by the rule (collective).
    required
        Factor by which the error of a state has to fall before its answer is certified
        (collective).

    Attributes
    ----------
    answer
        The last certified answer; None where none has been certified.
    """

    def __init__(
        self, rule: StoppingRule, certified: Callable[[S], Solution], required: Callable[[S], float]
    ) -> None:
        self.answer: Solution | None = None
        self.certified = certified
        self._rule, self._required = rule, required
        self._state: S | None = None

    def accept(self, state: S) -> bool:
        """Whether the certificate of a state's answer passes (collective)."""
        self.answer, self._state = self.certified(state), state
        return self.answer.converged

    def required_reduction(self, state: S) -> float:
        """Factor by which the error has to fall; the certificate of this state counts, too."""
        required = self._required(state)
        if state is self._state and self.answer is not None:
            required = max(required, self._rule.required_of_certified(self.answer))
        return required


def stopping_rule(options: SolverOptions, assess: Assess | None) -> StoppingRule:
    """The stopping rule for the tolerance of a scene.

    Raises
    ------
    ValueError
        An automatic tolerance without a function that estimates errors.
    """
    if options.tolerance != "auto":
        return StoppingRule(options.tolerance)
    if assess is None:
        raise ValueError("an automatic tolerance needs an estimate of the error")
    return AutomaticRule(assess, options.tightest)
