"""What a body is made of."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Isotropic linear elasticity: Young's modulus (force per area) and Poisson's ratio.

    Attributes
    ----------
    mean_dilatation
        Whether the change of volume is taken as its mean over each cell (B-bar).
    yield_stress
        Von Mises stress (force per area) above which the answer is warned of, if any.
    """

    young: float
    poisson: float
    mean_dilatation: bool = False
    yield_stress: float | None = None
