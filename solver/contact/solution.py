"""An answer, how accurate it is, and what it took."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from solver import Counts, Reason
from solver.contact.certificate import Certificate, Measures


@dataclass(frozen=True)
class Accuracy:
    """Errors in energy norm relative to that of the answer, √a(u,u).

    Of several groups of bodies that do not touch each other those of the worst group. NaN, in
    `summary.json` null, where nothing can be said: what strains there are, are rounding errors.

    Attributes
    ----------
    discretisation
        Estimated error of the mesh.
    algebraic
        Bound on the error of the solver, √(2 gap), and of rounding, as far as `round_off` tells.
    total
        Root of the sum of their squares.
    square
        a(u,u) of the answer.
    round_off
        Estimate of what rounding did to the answer; the part of `algebraic` that is no bound.
    bodies
        The first two of each body that is strained, relative to its own strains.
    """

    discretisation: float
    algebraic: float
    total: float
    square: float
    round_off: float = 0.0
    bodies: tuple[tuple[float, float], ...] = ()

    def as_dict(self) -> dict[str, float | None]:
        """As `summary.json` holds it."""
        names = ("discretisation", "algebraic", "total", "round_off")
        found = {name: getattr(self, name) for name in names}
        return {name: None if math.isnan(value) else value for name, value in found.items()}

    def calibrated(self, share: float) -> Accuracy:
        """The same with that share of the squared estimate."""
        mesh = self.discretisation * math.sqrt(share)
        return replace(self, discretisation=mesh, total=math.hypot(mesh, self.algebraic))

    def resolved(self, share: float) -> Accuracy:
        """The same with that share of the solver's error."""
        algebraic = share * self.algebraic
        return replace(
            self,
            algebraic=algebraic,
            total=math.hypot(self.discretisation, algebraic),
            bodies=tuple((mesh, share * solver) for mesh, solver in self.bodies),
        )

    def excess(self, share: float, tightest: float) -> float:
        """The solver's error over what it may be, in the worst body.

        It may be a share of the error of the mesh, and needs to be no less than `tightest`.
        """
        worst = 0.0
        for mesh, solver in self.bodies:
            limit = max(share * mesh, tightest)
            if solver > 0.0:
                worst = max(worst, solver / limit if limit > 0.0 else math.inf)
        return worst


@dataclass(frozen=True, eq=False)
class Solution:
    """An answer and what it took; local parts.

    Attributes
    ----------
    multiplier : (dual,)
        λ.
    displacements : one (n, members) array a class
        u.
    counts, reason
        Work of the solver and why it ended.
    tolerance
        What the certificate was held against.
    accuracy
        Errors of the mesh and of the solver; None until they are estimated.
    method
        Which algorithm found it; "direct" where there was nothing to iterate.
    warm
        Whether it grew out of the multipliers that were given to begin with.
    """

    multiplier: NDArray[np.float64]
    displacements: list[NDArray[np.float64]]
    certificate: Certificate
    measures: Measures
    counts: Counts
    reason: Reason
    tolerance: float
    accuracy: Accuracy | None = None
    method: str = "direct"
    warm: bool = False

    @property
    def converged(self) -> bool:
        """Whether the certificate passes."""
        return self.certificate.passed
