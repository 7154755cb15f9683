"""A solution with its accuracy, its certificate and the work of the solver."""

import math
from dataclasses import dataclass, replace

from solver import Counts, Reason
from solver.contact.certificate import Certificate, Measures
from solver.vectors import Array


@dataclass(frozen=True)
class Accuracy:
    """Errors in energy norm relative to that of the answer, √a(u,u).

    If several groups of bodies do not touch each other, the errors of the worst group. NaN (null in
    `summary.json`) where all strains are rounding errors.
    """

    discretisation: float
    """Estimated error of the mesh."""
    algebraic: float
    """Bound on the error of the solver, √(2 gap), with the estimate `round_off` of rounding
    errors."""
    total: float
    """Root of the sum of their squares."""
    square: float
    """a(u,u) of the answer."""
    round_off: float = 0.0
    """Estimate of the effect of rounding errors: the part of `algebraic` that is not a bound."""
    bodies: tuple[tuple[float, float], ...] = ()
    """`discretisation` and `algebraic` of each strained body, relative to its own strains."""

    def as_dict(self) -> dict[str, float | None]:
        """The record in `summary.json`."""
        names = ("discretisation", "algebraic", "total", "round_off")
        numbers = {name: getattr(self, name) for name in names}
        return {name: None if math.isnan(value) else value for name, value in numbers.items()}

    def calibrated(self, share: float) -> "Accuracy":
        """The accuracy with the squared estimate of the mesh error multiplied by `share`."""
        mesh = self.discretisation * math.sqrt(share)
        return replace(self, discretisation=mesh, total=math.hypot(mesh, self.algebraic))

    def resolved(self, share: float) -> "Accuracy":
        """The accuracy with the solver's error multiplied by `share`."""
        algebraic = share * self.algebraic
        return replace(
            self,
            algebraic=algebraic,
            total=math.hypot(self.discretisation, algebraic),
            bodies=tuple((mesh, share * solver) for mesh, solver in self.bodies),
        )

    def excess(self, share: float, tightest: float) -> float:
        """The solver's error over its admissible value, in the worst body.

        The admissible value is a share of the error of the mesh, and at least `tightest`.
        """
        worst = 0.0
        for mesh, solver in self.bodies:
            limit = max(share * mesh, tightest)
            if solver > 0.0:
                worst = max(worst, solver / limit if limit > 0.0 else math.inf)
        return worst


@dataclass(frozen=True, eq=False)
class Guess:
    """Initial guess of a solve, from answers to nearly equal problems; arrays are local parts."""

    multiplier: Array  # (dual,)
    """λ."""
    displacements: list[Array] | None = None  # one (n, members) array for each class
    """None if they are unknown; methods for multipliers do not need them."""
    jumps: Array | None = None  # (dual,)
    """B u - c near that of the answer, from which points with friction know how far they slide;
    None if unknown."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An answer with the work of the solver; arrays are local parts."""

    multiplier: Array  # (dual,)
    """λ."""
    displacements: list[Array]  # one (n, members) array for each class
    """u of the subdomains."""
    certificate: Certificate
    measures: Measures
    """The certificate, and the sizes relative to which it is computed."""
    counts: Counts
    reason: Reason
    """Work of the solver and why it ended."""
    tolerance: float
    """Tolerance of the certificate."""
    accuracy: Accuracy | None = None
    """Errors of the mesh and of the solver; None until they are estimated."""
    method: str = "direct"
    """The algorithm that found the answer; "direct" where no iteration was needed."""
    warm: bool = False
    """Whether the solve began with given multipliers."""

    @property
    def guess(self) -> Guess:
        """The initial guess for a nearly equal problem."""
        return Guess(self.multiplier, self.displacements)

    @property
    def converged(self) -> bool:
        """Whether the certificate passes."""
        return self.certificate.passed
