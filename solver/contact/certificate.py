"""The certificate: bounds on the errors of an answer, recomputed from the answer.

The certificate uses no residual of the solver. `solver.problem.certify` computes it anew, from the
multiplier λ and the displacements u: jumps and penetration B u - c, the residual of equilibrium
K u - f + Bᵀ λ on every unknown, the sign of the contact forces, complementarity, and the duality
gap.

The gap. u minimises L(·, λ) = ½ a(u,u) - l(u) + λᵀ(B u - c), because K u = f - Bᵀ λ; so for any
admissible û (glued, held, not penetrating)

    J(û) - D(λ) = ½ (û - u)ᵀ K (û - u) - λᵀ (B û - c) ≥ 0,

a sum of non-negative terms without cancellation, and the exact solution u* obeys
½ ‖û - u*‖²_K ≤ J(û) - J(u*) ≤ J(û) - D(λ). The gap bounds the algebraic error, not the error of the
mesh. Any admissible û gives a bound. The û nearest to u is open wherever u is open; this adds λᵀ (c
- B u), which is of first order in the error. So û closes the rows with contact forces wherever this
adds less, a term of second order.

Friction. Let λ_t be the friction force, s its limit (μ λ_n of the answer, or given) and w the slip.
`friction_cone` is the sum of the excess of |λ_t| over s. `slip_alignment` is the sum of |s w - |w|
λ_t| over all points, or the largest slip of a point whose force is below its limit, whichever is
larger. The sum is zero if every point either rests or slides along a force at its limit. The
duality gap is that of the problem with the limits s' = max(s, |λ_t|), to which û adds s' |ŵ| - λ_t
· ŵ ≥ 0 at each point. `friction_cone` says how far these limits are from s; the gap does not bound
the change of the answer by it.

References of the relative numbers. Each body is measured by its own sizes: lengths by its largest
displacement without rigid motions that nothing resists, or nothing that presses
(`solver.problem.free_motions`), forces by its load (the largest of the sums of the magnitudes of
loads, of reactions and of contact forces; with heat, and for bodies that carry nearly no load, see
`solver.problem.sizes.force_references`), the gap by its strain energy ½ a(u,u). So a weak body
beside a strong one, or a stiff body on a soft one, is certified by its own sizes
(`solver.contact.bodies`). Bodies that can touch form a group; the gap of a group bounds the error
of each of its bodies. The worst body decides.

Rounding errors. The gap assumes exact arithmetic. So two terms are added to its square root: the
effect on the strains of rounding u to its last digit, and the energy norm of the residual of
equilibrium (by the diagonal of K, for an error without a pattern). A body that moves so far that
its strains have no correct digits does not pass.
"""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from solver.vectors import Array, Ints

NUMBERS = (
    "max_penetration",
    "max_gluing_jump",
    "min_multiplier",
    "complementarity",
    "equilibrium",
    "duality_gap",
    "friction_cone",
    "slip_alignment",
)

EQUILIBRIUM_FLOOR = 1e-9
"""Residual of equilibrium, over the load, that rounding errors may always leave."""

ROUNDED_LIMIT = 1e-6
"""Largest residual of equilibrium, over the load, that is attributed to rounding errors."""


@dataclass(frozen=True)
class Certificate:
    """Numbers of `summary.json`'s certificate, all relative."""

    max_penetration: float
    max_gluing_jump: float
    """Over the largest displacement; the jump covers gluing, held and tied rows."""
    min_multiplier: float
    """Most negative contact force over the load; zero or positive when no force is tensile."""
    complementarity: float
    """Σ λ_i |gap_i| over load times largest displacement."""
    equilibrium: float
    """‖K u - f + Bᵀ λ‖ over the load, in the 2-norm over all unknowns that are solved for."""
    duality_gap: float
    """J(û) - D(λ) over the strain energy, with the terms of rounding errors."""
    passed: bool
    """Whether all numbers are below the tolerance."""
    round_off: float = 0.0
    """Residual of equilibrium after rounding u to its last digit, over the load. The residual may
    be as large as this, but not above 1e-6. A stiff body on a soft one moves far with small strains
    and cannot reach less: its forces are differences of large numbers."""
    friction_cone: float = 0.0
    """Excess of friction forces over their limits, summed over all points, over the load."""
    slip_alignment: float = 0.0
    """The larger of two numbers: the misalignment of slips and friction forces, over load times
    largest displacement; and the largest slip of a point below its limit, over the largest
    displacement."""
    frictional: bool = False
    """Whether the scene has friction."""
    warnings: tuple[str, ...] = field(default=())
    worst: tuple[int, ...] = field(default=())
    """The body whose number is reported, one for each of `NUMBERS`; empty where there is one
    body."""

    def judged(self, tolerance: float) -> "Certificate":
        """The same numbers, compared with a tolerance."""
        return replace(self, passed=max(self._shares(tolerance)) <= 1.0)

    def required_reduction(self, tolerance: float) -> float:
        """Factor by which the error has to fall; one or less where the certificate passes.

        The gap is of second order in the error. A NaN does not pass.
        """
        shares = dict(zip(NUMBERS, self._shares(tolerance), strict=True))
        shares["duality_gap"] = float(np.sqrt(shares["duality_gap"]))
        return max(shares.values())

    def deciding(self, tolerance: float) -> int | None:
        """The body with the worst number; None where there is one body."""
        return self.worst[int(np.argmax(self._shares(tolerance)))] if self.worst else None

    def _shares(self, tolerance: float) -> list[float]:
        """Each of `NUMBERS` over its limit; infinite for a NaN."""
        limits = dict.fromkeys(NUMBERS, tolerance)
        rounded = min(self.round_off, ROUNDED_LIMIT)
        limits["equilibrium"] = max(tolerance, EQUILIBRIUM_FLOOR, rounded)
        shares = [abs(getattr(self, name)) / limit for name, limit in limits.items()]
        return [share if np.isfinite(share) else np.inf for share in shares]

    def as_dict(self) -> dict[str, Any]:
        """The record in `summary.json`."""
        record = {**asdict(self), "warnings": list(self.warnings)}
        del record["worst"]
        if not record.pop("frictional"):
            del record["friction_cone"], record["slip_alignment"]
        return record


@dataclass(frozen=True, eq=False)
class Measures:
    """Sizes of an answer, of each body and of the scene."""

    displacements: Array  # (bodies,)
    """Largest |u| over all nodes of each body, in units of length; zero for rigid bodies."""
    deformations: Array  # (bodies,)
    """Largest |u| without the rigid motions that no row with a force resists: the reference of
    lengths."""
    loads: Array  # (bodies,)
    """Largest of the sums of magnitudes of loads, reactions and contact forces of each body."""
    pressed: Array  # (bodies,)
    """Sum of the contact forces on each body."""
    strains: Array  # (bodies,)
    """a(u, u) of each body, twice its strain energy."""
    roundings: Array  # (bodies,)
    """a(δu, δu) of the change δu that rounding errors may have made to u, among them the residual
    of equilibrium but for that of an iterative solver, which is in `gaps`."""
    gaps: Array  # (groups,)
    """The duality gap J(û) - D(λ) of each group, in units of energy."""
    energy: float
    """½ a(û,û) - l(û) of the admissible û. Without friction its error is of second order, at most
    the duality gap. With friction only J(û), the sum of it and Σ s |ŵ|, is stationary: the error of
    the energy is of first order, like the root of the gap."""
    groups: Ints  # (bodies,)
    """The group of each body."""
    scales: Array  # (bodies,)
    """Reference of squared errors in energy norm in each body; zero where the body is not
    strained."""

    @property
    def displacement(self) -> float:
        """Largest |u| over all nodes, in units of length."""
        return float(self.displacements.max())

    @property
    def gap(self) -> float:
        """The duality gap of the scene, in units of energy."""
        return float(self.gaps.sum())

    def error_squares(self) -> Array:
        """Bound on ‖û - u*‖² of each group, (groups,), with the terms of rounding errors."""
        rounding = np.bincount(self.groups, self.roundings, len(self.gaps))
        return np.asarray((np.sqrt(2.0 * np.maximum(self.gaps, 0.0)) + np.sqrt(rounding)) ** 2)
