"""How MPRGP enlarges the active set when the CG step would leave the box (paper, section 3).

An expansion is one small frozen object that moves an iterate to a feasible point with its gradient:

* :class:`ProjectedLineSearch`, the standard expansion and its adaptive lengths: the half step to
  the bound, then a projected step along the free or the reduced free gradient, whose length is
  fixed, ᾱ = α_u/‖A‖; approximately optimal (optapprox), ᾱ = α_u/‖A‖ · dᵀg/dᵀd; or optimal (opt),
  ᾱ = α_u dᵀg/dᵀAd, with one more product. ``gfgr``: along g^f, with the length from d = g^r.
* :class:`ProjectedCG`: the full CG step, projected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from solver.iterate import Iterate


class Expansion(Protocol):
    """Strategy for enlarging the active set."""

    @property
    def name(self) -> str:
        """Its name in the paper's terms."""

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Move to the next feasible point, with its gradient split and p restarted.

        ``it.p`` and ``it.Ap`` are the CG direction and its product, α_cg > α_f the lengths of
        the CG step and of the longest feasible one.
        """

    def prepare(self, it: Iterate) -> None:
        """Set ``it.alpha``, the first step length of the reduced gradient, where it is used."""


class Length(Protocol):
    """Length of a projected step from the gradient d and α_u."""

    def __call__(self, it: Iterate, d: np.ndarray, alpha_u: float) -> float: ...


def fixed(it: Iterate, d: np.ndarray, alpha_u: float) -> float:
    """ᾱ = α_u / ‖A‖."""
    return alpha_u / it.norm


def optapprox(it: Iterate, d: np.ndarray, alpha_u: float) -> float:
    """ᾱ = α_u / ‖A‖ · dᵀg / dᵀd; at least the fixed length, since dᵀd ≤ dᵀg."""
    dg, dd = it.reduction.sums(float(np.dot(d, it.g)), float(np.dot(d, d)))
    return alpha_u / it.norm * dg / dd if dd > 0.0 else it.alpha


def opt(it: Iterate, d: np.ndarray, alpha_u: float) -> float:
    """ᾱ = α_u dᵀg / dᵀAd; one more product with the Hessian."""
    it.operator.apply(d, it.Ap)
    it.counts.hessian += 1
    dg, dAd = it.reduction.sums(float(np.dot(d, it.g)), float(np.dot(d, it.Ap)))
    return alpha_u * dg / dAd if dAd > 0.0 else it.alpha


@dataclass(frozen=True)
class ProjectedLineSearch:
    """Half step to the bound, then a projected step along g^f or g^r (paper, Algorithm 3).

    Attributes
    ----------
    along, measure : "gf" or "gr"
        Gradient of the step's direction, and the one that sets its length.
    length : Length
    alpha_u : float
        Between 0 and 2.
    """

    name: str
    along: str = "gf"
    measure: str = "gf"
    length: Length = fixed
    alpha_u: float = 1.9

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
        """Nothing: no reduced gradient."""

    def expand(self, it: Iterate, alpha_cg: float, alpha_f: float) -> None:
        """Full step and projection; to the first bound where the CG step has no end."""
        it.project_step(alpha_cg if math.isfinite(alpha_cg) else alpha_f, it.p)
        it.evaluate()


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


def _line_search(name: str, along: str, measure: str, length: Length):  # type: ignore[no-untyped-def]
    return lambda alpha_u: ProjectedLineSearch(name, along, measure, length, alpha_u)


_REGISTRY = {
    "fixed": _line_search("fixed", "gf", "gf", fixed),
    **{
        f"{d}{m}-{kind}": _line_search(f"{d}{m}-{kind}", d, m, length)
        for kind, length in LENGTHS.items()
        for d, m in (("gr", "gr"), ("gf", "gr"), ("gf", "gf"))
    },
    "projcg": lambda alpha_u: ProjectedCG(),
}
