"""MPRGP for the reader of the book: plain NumPy, not optimised for speed.

Minimises f(x) = ½ xᵀAx - bᵀx over l ≤ x ≤ u (Dostál, *Optimal Quadratic Programming Algorithms*,
2009, chapter 5; expansions of Kružík et al. 2020, section 3). With g = Ax - b and the active set of
components at a bound, the gradient splits into

    φ  free gradient     g where no bound is met, 0 elsewhere,
    β  chopped gradient  g where a bound is met and g points back into the box, 0 elsewhere,
    φ̃  reduced gradient  (x - P(x - ᾱ φ)) / ᾱ, a step ᾱ along it stays in the box,

with P the projection onto the box. x is the solution if φ + β = 0. Γ weighs the two against each
other: x is called proportional if ‖β‖² ≤ Γ² φ̃ᵀφ. `solver.qp.mprgp` is the same algorithm for
distributed vectors, with fewer Hessian multiplications. Tests compare the two step by step.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

ACTIVE = 10.0 * np.finfo(np.float64).eps
"""Distance to a bound, over u - l or over |bound| where one is infinite, at which it is met."""


@dataclass(frozen=True)
class Box:
    """l ≤ x ≤ u."""

    l: Vector  # noqa: E741
    u: Vector

    def P(self, x: Vector) -> Vector:
        """The nearest point of the box."""
        return np.minimum(np.maximum(x, self.l), self.u)

    def met(self, x: Vector) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks (n,) of the components at the lower and at the upper bound."""
        width = self.u - self.l
        scale_l, scale_u = (
            np.where(np.isfinite(width), width, np.where(np.isfinite(bound), np.abs(bound), 0.0))
            for bound in (self.l, self.u)
        )
        return x <= self.l + ACTIVE * scale_l, x >= self.u - ACTIVE * scale_u

    def split(self, x: Vector, g: Vector) -> tuple[Vector, Vector]:
        """φ and β."""
        at_l, at_u = self.met(x)
        φ = np.where(at_l | at_u, 0.0, g)
        outward = (at_l & (g > 0.0)) | (at_u & (g < 0.0))
        return φ, np.where(outward, 0.0, g) - φ

    def α_f(self, x: Vector, p: Vector) -> float:
        """The longest feasible step along -p."""
        with np.errstate(divide="ignore", invalid="ignore"):
            to_l = np.where(p > 0.0, (x - self.l) / p, np.inf)
            to_u = np.where(p < 0.0, (x - self.u) / p, np.inf)
        return float(min(to_l.min(initial=np.inf), to_u.min(initial=np.inf)))


def mprgp(
    A: Any, b: Vector, box: Box, x: Vector, norm: float, expansion: str = "projcg",
    α_u: float = 1.9, Γ: float = 1.0, rtol: float = 1e-6,
) -> Iterator[tuple[str, Vector]]:  # fmt: skip
    """The steps of the algorithm: the kind of each and the point it leads to.

    Parameters
    ----------
    norm, α_u
        ‖A‖, and the multiple of a step length that is taken, 0 < α_u ≤ 2.
    expansion
        ``projcg``; or the gradients of direction and length, ``gf`` for φ and ``gr`` for φ̃, and
        how the length is found, as in ``gfgr-opt``: ``optapprox`` or ``opt``; or ``fixed``.
    """
    x, ᾱ = box.P(x), 0.0 if expansion in ("projcg", "gfgf-opt") else α_u / norm  # 0: φ̃ is φ
    g = A @ x - b
    φ, β = box.split(x, g)
    p = φ
    while np.linalg.norm(φ + β) > rtol * np.linalg.norm(b):
        φ̃ = (x - box.P(x - ᾱ * φ)) / ᾱ if ᾱ else φ
        Ap = A @ p
        if β @ β > Γ**2 * (φ̃ @ φ):  # proportioning: release components
            kind, α = "proportioning", min((g @ β) / (β @ (A @ β)), box.α_f(x, β))
            x = box.P(x - α * β)
        elif (α_cg := (g @ p) / (p @ Ap)) <= box.α_f(x, p):  # conjugate gradients on the free ones
            kind, x = "cg", box.P(x - α_cg * p)
        elif expansion == "projcg":  # expansion: components join the active set
            kind, x = "expansion", box.P(x - α_cg * p)
        else:
            kind = "expansion"
            x, ᾱ = expand(A, b, box, box.P(x - box.α_f(x, p) * p), ᾱ, norm, expansion, α_u)
        g = A @ x - b
        φ, β = box.split(x, g)
        p = φ - (φ @ Ap) / (p @ Ap) * p if kind == "cg" else φ
        yield kind, x


def expand(
    A: Any, b: Vector, box: Box, x: Vector, ᾱ: float, norm: float, name: str, α_u: float
) -> tuple[Vector, float]:
    """Projected step along φ or φ̃ from the end x of the half step.

    Return the point and the new ᾱ.
    """
    g = A @ x - b
    φ, _ = box.split(x, g)
    gradients = {"gf": φ, "gr": (x - box.P(x - ᾱ * φ)) / ᾱ if ᾱ else φ}
    along, measure = ("gf", "gf") if name == "fixed" else (name[:2], name[2:4])
    d = gradients[measure]
    if name == "fixed":
        ᾱ = α_u / norm
    elif d.any():
        ᾱ = α_u * (d @ g) / (norm * (d @ d) if name.endswith("optapprox") else d @ (A @ d))
    return box.P(x - ᾱ * gradients[along]), ᾱ
