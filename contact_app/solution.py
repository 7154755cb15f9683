"""An answer, how accurate it is, and what it took."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contact_app.certificate import Certificate, Measures
from solver import Counts, Reason


@dataclass(frozen=True)
class Accuracy:
    """Errors in energy norm relative to that of the answer, √a(u,u).

    Attributes
    ----------
    discretisation
        Estimated error of the mesh.
    algebraic
        Bound on the error of the solver, √(2 gap).
    total
        Root of the sum of their squares.
    square
        a(u,u) of the answer.
    """

    discretisation: float
    algebraic: float
    total: float
    square: float

    def as_dict(self) -> dict[str, float]:
        """As `summary.json` holds it."""
        return {key: value for key, value in asdict(self).items() if key != "square"}

    def calibrated(self, share: float) -> Accuracy:
        """The same with that share of the squared estimate."""
        mesh = self.discretisation * math.sqrt(share)
        return replace(self, discretisation=mesh, total=math.hypot(mesh, self.algebraic))


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
    warm: bool = False

    @property
    def converged(self) -> bool:
        """Whether the certificate passes."""
        return self.certificate.passed
