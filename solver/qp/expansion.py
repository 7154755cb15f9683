"""Expansions of the active set when the CG step of MPRGP would leave the box (paper, section 3).

An expansion is one small frozen object that moves an iterate to a feasible point with its gradient:

* :class:`ProjectedLineSearch`, the standard expansion and its adaptive lengths: the half step to
  the bound, then a projected step along the free or the reduced free gradient, whose length is
  fixed, ᾱ = α_u/‖A‖; approximately optimal (optapprox), ᾱ = α_u/‖A‖ · dᵀg/dᵀd; or optimal (opt),
  ᾱ = α_u dᵀg/dᵀAd, one more Hessian multiplication. ``gfgr``: along g^f, with the length
  from d = g^r.
* :class:`ProjectedCG`: the full CG step, projected.
* :class:`SafeguardedCG`: the same, with a guaranteed descent. Let x½ be the half step, the last
  feasible point of the CG step. The segment from x½ to the projected CG step is feasible, and all
  its points keep the bound that x½ met. Plain ``projcg`` spends one multiplication on the new
  gradient. Here it is spent on Ad, with d the segment: it gives cost and gradient on the whole
  segment. If the projected CG step raises the cost, the step ends at the minimum on this segment,
  or on that of the standard expansion, d = α g^r, whichever is lower. A multiplication to compare
  the two is spent only where the bounds below do not decide.

Descent. Let δ = f(x) - f(x½) and D = ½ g^rᵀg^f/‖A‖ at x½ (g^r for the length 1/‖A‖): Dostál's
theory guarantees that the standard expansion decreases the cost by δ + D, and the proof of MPRGP's
R-linear convergence asks no more of an expansion than a fixed part of that. The projected CG step
is taken if it decreases the cost by κ(δ + D). Else the cost falls by at least as much as on the
segment of the standard expansion, which is D/1.9 or more below x½: by gᵀd ≥ ‖d‖²/α a minimum inside
the segment is (gᵀd)²/(2 dᵀAd) ≥ gᵀd/(2α‖A‖) below x½, its end is ½ gᵀd below, and g^r for the
length 1.9/‖A‖ is at least g^r for 1/‖A‖ over 1.9. (Where ‖A‖ is not known, the largest ‖Ap‖/‖p‖
seen replaces it: a lower bound, which makes D larger.)

Comparison with the standard expansion. It ends at most m(gᵀd', c) below x½, with d' its segment, c
any lower bound of d'ᵀAd' and m(s, c) the maximum of ts - ½t²c for 0 ≤ t ≤ 1. By Cauchy and Schwarz,
c = (dᵀAd')²/dᵀAd is such a bound, and Ad is known. So a minimum on the segment to the projected CG
step that is m(gᵀd', c) below x½ is at least as low, which takes no multiplication to see.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from solver.qp.iterate import Iterate
from solver.vectors import Vector


class Expansion(Protocol):
    """Strategy for enlarging the active set."""

    @property
    def name(self) -> str:
        """Name of the strategy in the paper's terms."""

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Move to the next feasible point, with its gradient split and p restarted.

        ``it.p`` and ``it.Ap`` are the CG direction and its product, α_cg > α_f the lengths of
        the CG step and of the longest feasible one.
        """

    def prepare(self, it: Iterate) -> None:
        """Set ``it.alpha``, the first step length of the reduced gradient, where it is used."""


class Length(Protocol):
    """Length of a projected step from the gradient d and α_u."""

    def __call__(self, it: Iterate, d: Vector, alpha_u: float) -> float:
        """ᾱ for the gradient d at the half step."""


def fixed(it: Iterate, d: Vector, alpha_u: float) -> float:
    """ᾱ = α_u / ‖A‖."""
    return alpha_u / it.norm


def optapprox(it: Iterate, d: Vector, alpha_u: float) -> float:
    """ᾱ = α_u / ‖A‖ · dᵀg / dᵀd; at least the fixed length, since dᵀd ≤ dᵀg."""
    dg, dd = it.reduction.sums(float(np.dot(d, it.g)), float(np.dot(d, d)))
    return alpha_u / it.norm * dg / dd if dd > 0.0 else it.alpha


def opt(it: Iterate, d: Vector, alpha_u: float) -> float:
    """ᾱ = α_u dᵀg / dᵀAd; one more Hessian multiplication."""
    it.operator.apply(d, it.Ap)
    it.counts.hessian += 1
    dg, dAd = it.reduction.sums(float(np.dot(d, it.g)), float(np.dot(d, it.Ap)))
    return alpha_u * dg / dAd if dAd > 0.0 else it.alpha


@dataclass(frozen=True)
class ProjectedLineSearch:
    """Half step to the bound, then a projected step along g^f or g^r (paper, Algorithm 3)."""

    name: str
    along: str = "gf"
    measure: str = "gf"
    """Gradient of the step's direction, and the one that sets its length."""
    length: Length = fixed
    alpha_u: float = 1.9
    """Between 0 and 2."""

    def prepare(self, it: Iterate) -> None:
        """The first step length is the fixed one, where g^r is used at all."""
        if "gr" in (self.along, self.measure) or self.length is not opt:
            it.alpha = self.alpha_u / it.norm

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Half step, then the projected step."""
        it.advance(alpha_f, snap=True)
        reduced = it.p  # not needed any more: it is restarted below
        if "gr" in (self.along, self.measure):
            it.reduced_gradient(out=reduced)
        gradients = {"gf": it.free, "gr": reduced}
        it.alpha = self.length(it, gradients[self.measure], self.alpha_u)
        it.project_step(it.alpha, gradients[self.along])
        it.evaluate()


@dataclass(frozen=True)
class ProjectedCG:
    """Projection of the full CG step (paper, section 3.2 and Algorithm 5).

    Can raise the cost; see the paper's Figure 1. Needs neither ‖A‖ nor α_u.
    """

    name: str = "projcg"

    def prepare(self, it: Iterate) -> None:
        """Do nothing: this strategy uses no reduced gradient."""

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Full step and projection; to the first bound where the CG step has no end."""
        it.project_step(alpha_cg if math.isfinite(alpha_cg) else alpha_f, it.p)
        it.evaluate()


@dataclass(frozen=True)
class SafeguardedCG:
    """Projection of the CG step, shortened or replaced where the cost would rise."""

    name: str = "projcg-safe"
    kappa: float = 1e-3
    """κ, the required part of the standard expansion's guaranteed decrease."""
    standard: float = 1.9
    """Length of the standard expansion's segment in units of 1/‖A‖."""

    def prepare(self, it: Iterate) -> None:
        """Do nothing: ‖A‖ is estimated during the solve."""

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Half step, then a step that lowers the cost."""
        if it.largest == 0.0:  # no curvature known yet: go to the bound
            it.advance(alpha_f, restart=True, snap=True)
            return
        if math.isinf(alpha_cg):
            alpha_cg = alpha_f + 10.0 / it.largest
        half = alpha_f * (it.slope - 0.5 * alpha_f * it.curvature)  # δ
        slope, product = it.half_step_and_aim(alpha_f, alpha_cg)
        if product == 0.0:  # no free component is left that could move
            it.restart()
            return
        guaranteed = 0.5 * product / it.largest  # D
        enough = self.kappa * (half + guaranteed) - half
        too_flat = slope < enough  # the cost is convex: no point of the segment falls enough
        if too_flat:
            it.aim_reduced(self.standard / it.largest_known)
            enough = self.kappa * guaranteed
        length, _ = it.probe()
        if it.slope - 0.5 * it.curvature >= enough:
            length = 1.0
        elif not too_flat:
            length = self._lowest(it)
        it.advance(min(max(length, 0.0), 1.0), restart=True, snap=True)

    def _lowest(self, it: Iterate) -> float:
        """Aim at the lower of two minima: on the segment p, or on that of the standard expansion.

        Returns the length at which the minimum lies.
        """
        length, lower = minimum(it.slope, it.curvature)
        curvature = it.curvature
        slope, mixed = it.aim_reduced_beside(self.standard / it.largest_known)
        bound = mixed**2 / curvature if curvature > 0.0 else 0.0
        if lower < minimum(slope, bound)[1]:
            it.probe()
            standard, lowest = minimum(it.slope, it.curvature)
            if lowest > lower:
                return standard
        it.take_back()
        return length


def minimum(slope: float, curvature: float) -> tuple[float, float]:
    """Maximiser and maximum of t slope - ½ t² curvature for 0 ≤ t ≤ 1.

    >>> minimum(1.0, 2.0)
    (0.5, 0.25)
    """
    length = 0.0 if slope <= 0.0 else 1.0 if slope >= curvature else slope / curvature
    return length, length * (slope - 0.5 * length * curvature)


LENGTHS: dict[str, Length] = {"optapprox": optapprox, "opt": opt}


def expansion_names() -> tuple[str, ...]:
    """All names that :func:`expansion_by_name` knows."""
    return tuple(_REGISTRY)


def expansion_by_name(name: str, alpha_u: float = 1.9) -> Expansion:
    """The expansion of that name.

    >>> expansion_by_name("gfgr-opt").measure
    'gr'
    """
    if name not in _REGISTRY:
        raise ValueError(f"unknown expansion {name!r}; there are {', '.join(_REGISTRY)}")
    if not 0.0 < alpha_u <= 2.0:
        raise ValueError(f"alpha_u is {alpha_u}; steps descend for 0 < alpha_u <= 2")
    return _REGISTRY[name](alpha_u)


def _line_search(
    name: str, along: str, measure: str, length: Length
) -> Callable[[float], Expansion]:
    return lambda alpha_u: ProjectedLineSearch(name, along, measure, length, alpha_u)


_REGISTRY: dict[str, Callable[[float], Expansion]] = {
    "fixed": _line_search("fixed", "gf", "gf", fixed),
    **{
        f"{d}{m}-{kind}": _line_search(f"{d}{m}-{kind}", d, m, length)
        for kind, length in LENGTHS.items()
        for d, m in (("gr", "gr"), ("gf", "gr"), ("gf", "gf"))
    },
    "projcg": lambda alpha_u: ProjectedCG(),
    "projcg-safe": lambda alpha_u: SafeguardedCG(),
}
