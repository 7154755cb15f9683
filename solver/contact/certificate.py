"""The certificate: bounds on the errors of an answer, recomputed from the answer.

The certificate uses no residual of the solver. It computes anew, from the multiplier λ and the
displacements u: jumps and penetration B u - c, the residual of equilibrium K u - f + Bᵀ λ on every
unknown, the sign of the contact forces, complementarity, and the duality gap.

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
(`solver.tfeti.free_motions`), forces by its load (the largest of the sums of the magnitudes of
loads, of reactions and of contact forces; with heat, and for bodies that carry nearly no load, see
`solver.contact.sizes.force_references`), the gap by its strain energy ½ a(u,u). So a weak body
beside a strong one, or a stiff body on a soft one, is certified by its own sizes
(`solver.contact.bodies`). Bodies that can touch form a group; the gap of a group bounds the error
of each of its bodies. The worst body decides.

Rounding errors. The gap assumes exact arithmetic. So two terms are added to its square root: the
effect on the strains of rounding u to its last digit, and the energy norm of the residual of
equilibrium (by the diagonal of K, for an error without a pattern). A body that moves so far that
its strains have no correct digits does not pass.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver.contact.bodies import Bodies, body_lengths, largest, sizes
from solver.contact.sizes import (
    ROUNDED_LIMIT,
    MeasuredAnswer,
    MeasuredProblem,
    energy_scales,
    force_references,
)

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

STRAINING = 200.0
"""Square of the error by the gap of a group that moves rigidly, over that of its rounding errors.

From there on the group would be strained by contact forces that the answer does not have. Blocks
that came to rest beside a lid had up to 130, by the kernels of the BLAS.
"""


@dataclass(frozen=True)
class Certificate:
    """Numbers of `summary.json`'s certificate, all relative.

    Attributes
    ----------
    max_penetration, max_gluing_jump
        Over the largest displacement; the jump covers gluing, held and tied rows.
    min_multiplier
        Most negative contact force over the load; zero or positive when no force is tensile.
    complementarity
        Σ λ_i |gap_i| over load times largest displacement.
    equilibrium
        ‖K u - f + Bᵀ λ‖ over the load, in the 2-norm over all unknowns that are solved for.
    duality_gap
        J(û) - D(λ) over the strain energy, with the terms of rounding errors.
    friction_cone
        Excess of friction forces over their limits, summed over all points, over the load.
    slip_alignment
        The larger of two numbers: the misalignment of slips and friction forces, over load times
        largest displacement; and the largest slip of a point below its limit, over the largest
        displacement.
    frictional
        Whether the scene has friction.
    passed
        Whether all numbers are below the tolerance.
    round_off
        Residual of equilibrium after rounding u to its last digit, over the load. The residual may
        be as large as this, but not above 1e-6. A stiff body on a soft one moves far with small
        strains and cannot reach less: its forces are differences of large numbers.
    worst
        The body whose number is reported, one for each of `NUMBERS`; empty where there is one body.
    """

    max_penetration: float
    max_gluing_jump: float
    min_multiplier: float
    complementarity: float
    equilibrium: float
    duality_gap: float
    passed: bool
    round_off: float = 0.0
    friction_cone: float = 0.0
    slip_alignment: float = 0.0
    frictional: bool = False
    warnings: tuple[str, ...] = field(default=())
    worst: tuple[int, ...] = field(default=())

    def judged(self, tolerance: float) -> Certificate:
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
    """Sizes of an answer, of each body and of the scene.

    Attributes
    ----------
    displacements : (bodies,)
        Largest |u| over all nodes of each body, in units of length; zero for rigid bodies.
    deformations : (bodies,)
        Largest |u| without the rigid motions that no row with a force resists: the reference of
        lengths.
    loads : (bodies,)
        Largest of the sums of magnitudes of loads, reactions and contact forces of each body.
    pressed : (bodies,)
        Sum of the contact forces on each body.
    strains : (bodies,)
        a(u, u) of each body, twice its strain energy.
    roundings : (bodies,)
        a(δu, δu) of the change δu that rounding errors and the residual of equilibrium may have
        made to u.
    gaps : (groups,)
        The duality gap J(û) - D(λ) of each group, in units of energy.
    energy
        ½ a(û,û) - l(û) of the admissible û. Without friction its error is of second order, at most
        the duality gap. With friction only J(û), the sum of it and Σ s |ŵ|, is stationary: the
        error of the energy is of first order, like the root of the gap.
    groups : (bodies,)
        The group of each body.
    scales : (bodies,)
        Reference of squared errors in energy norm in each body; zero where the body is not
        strained.
    """

    displacements: NDArray[np.float64]
    deformations: NDArray[np.float64]
    loads: NDArray[np.float64]
    pressed: NDArray[np.float64]
    strains: NDArray[np.float64]
    roundings: NDArray[np.float64]
    gaps: NDArray[np.float64]
    energy: float
    groups: NDArray[np.int64]
    scales: NDArray[np.float64]

    @property
    def displacement(self) -> float:
        """Largest |u| over all nodes, in units of length."""
        return float(self.displacements.max())

    @property
    def gap(self) -> float:
        """The duality gap of the scene, in units of energy."""
        return float(self.gaps.sum())

    def error_squares(self) -> NDArray[np.float64]:
        """Bound on ‖û - u*‖² of each group, (groups,), with the terms of rounding errors."""
        rounding = np.bincount(self.groups, self.roundings, len(self.gaps))
        return np.asarray((np.sqrt(2.0 * np.maximum(self.gaps, 0.0)) + np.sqrt(rounding)) ** 2)


def certificate_of(
    answer: MeasuredAnswer, tolerance: float, unsolved: NDArray[np.float64] | None = None
) -> tuple[Certificate, Measures]:
    """Compute the certificate of an answer (collective).

    Parameters
    ----------
    tolerance
        `solver.tolerance` of the scene.
    unsolved : (bodies,)
        Squared error in energy norm of the group of each body that an iterative solver left in K u
        = f - Bᵀ λ. The gap assumes this equation, so the root of this number is added to the root
        of the gap.
    """
    problem, multiplier, residual = answer.problem, answer.multiplier, answer.residual
    comm, bodies, contact = problem.comm, problem.bodies, problem.inequality
    slack = residual / problem.spread

    deformed = answer.largest_deformations()
    lengths = body_lengths(bodies, deformed, problem.free_lengths)
    state, (rounded, disturbed) = answer.equilibrium(), answer.round_off()
    force = np.where(problem.conditional, multiplier * problem.spread, 0.0)
    forces = answer.forces_on_bodies(force, state.reactions, rounded)
    gaps = answer.gaps()
    bounds = gaps if unsolved is None else _with_unsolved(bodies, gaps, unsolved)
    work = float(comm.allreduce(multiplier @ residual - _friction_work(answer)))
    idle = comm.allreduce(bodies.sum_rows(np.abs(force * slack), contact))
    roundings = (np.sqrt(disturbed) + np.sqrt(state.disturbances)) ** 2
    measures = Measures(
        displacements=answer.largest_displacements(),
        deformations=deformed,
        loads=forces.largest,
        pressed=forces.contact,
        strains=state.strains,
        roundings=roundings,
        scales=energy_scales(problem, state.strains, roundings, forces),
        gaps=bounds,
        energy=float(state.energy + work + gaps.sum()),
        groups=bodies.groups,
    )
    # forces on a body that moves rigidly are rounding errors: relative to forces that would move it
    moving = rounded / np.finfo(np.float64).eps
    references = force_references(problem, forces, tolerance)
    load = sizes(bodies, np.where(measures.scales > 0.0, references, moving))
    distance = np.abs(slack) / bodies.of_rows(lengths)
    pulls = np.where(contact, np.maximum(-force, 0.0), 0.0) / bodies.of_rows(load)
    by_body = {
        "max_penetration": _worst_rows(problem, np.where(slack > 0.0, distance, 0.0), contact),
        "max_gluing_jump": _worst_rows(problem, distance, ~problem.conditional),
        "min_multiplier": _worst_rows(problem, pulls, contact),
        "complementarity": idle / sizes(bodies, load * lengths),
        "equilibrium": state.imbalance / load,
        "duality_gap": _relative_gaps(problem, measures),
        **friction_numbers(problem, answer.multiplier, residual, load, lengths),
    }
    certificate = _certificate(by_body, rounded / load)
    certificate = replace(certificate, frictional=problem.friction.acts)
    return certificate.judged(tolerance), measures


def _friction_work(answer: MeasuredAnswer) -> float:
    """Σ s |w| over this rank's points: a part of J(û), but not of the energy of the bodies."""
    points = answer.problem.friction
    slips = points.sizes(points.slips(answer.residual))
    return float(points.slip_limits(answer.multiplier) @ slips)


def friction_numbers(
    problem: MeasuredProblem,
    multiplier: NDArray[np.float64],
    residual: NDArray[np.float64],
    load: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    """The numbers of friction of each body, (bodies,) (collective).

    Parameters
    ----------
    multiplier, residual : (dual,)
        λ and B u - c.
    load, lengths : (bodies,)
        References of forces and of lengths.
    """
    points, bodies = problem.friction, problem.bodies
    rows = points.rows[points.first]
    here = np.zeros(len(multiplier), bool)
    here[rows] = True

    def at_rows(values: NDArray[np.float64]) -> NDArray[np.float64]:
        result = np.zeros(len(multiplier))
        result[rows] = values
        return result

    forces, slips = points.forces(multiplier), points.slips(residual)
    size, limit, slip = points.sizes(forces), points.slip_limits(multiplier), points.sizes(slips)
    excess = at_rows(np.maximum(size - limit, 0.0))
    misaligned = points.sizes(limit[points.point] * slips - slip[points.point] * forces)
    rests = ~points.sliding(multiplier)[rows]
    moved = at_rows(np.where(rests, slip, 0.0)) / bodies.of_rows(lengths)
    beyond, misalignment = problem.comm.allreduce(
        np.array([bodies.sum_rows(values, here) for values in (excess, at_rows(misaligned))])
    )
    return {
        "friction_cone": beyond / load,
        "slip_alignment": np.maximum(
            misalignment / sizes(bodies, load * lengths), _worst_rows(problem, moved, here)
        ),
    }


def _with_unsolved(
    bodies: Bodies, gaps: NDArray[np.float64], unsolved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """½ (√(2 gap) + e)² of each group, e the energy norm of the error of the iterative solver."""
    error = np.sqrt(bodies.by_group(unsolved))
    return np.asarray(0.5 * (np.sqrt(2.0 * np.maximum(gaps, 0.0)) + error) ** 2)


def _certificate(
    by_body: dict[str, NDArray[np.float64]], rounded: NDArray[np.float64]
) -> Certificate:
    """The numbers of the worst body, not yet compared with a tolerance.

    A body whose residual of equilibrium exceeds its rounding errors counts as worse than other
    bodies.
    """
    ranked = dict(by_body)
    excess = by_body["equilibrium"] > np.minimum(rounded, ROUNDED_LIMIT)
    if excess.any():
        ranked["equilibrium"] = np.where(excess, by_body["equilibrium"], 0.0)
    worst = {name: int(np.argmax(values)) for name, values in ranked.items()}
    numbers = {name: float(values[worst[name]]) for name, values in by_body.items()}
    several = len(rounded) > 1
    return Certificate(
        max_penetration=numbers["max_penetration"],
        max_gluing_jump=numbers["max_gluing_jump"],
        min_multiplier=0.0 - numbers["min_multiplier"],
        complementarity=numbers["complementarity"],
        equilibrium=numbers["equilibrium"],
        duality_gap=numbers["duality_gap"],
        friction_cone=numbers["friction_cone"],
        slip_alignment=numbers["slip_alignment"],
        passed=False,
        round_off=float(rounded[worst["equilibrium"]]),
        worst=tuple(worst[name] for name in NUMBERS) if several else (),
    )


def _worst_rows(
    problem: MeasuredProblem, values: NDArray[np.float64], rows: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The largest of values (dual,) over some rows of each body, (bodies,) (collective)."""
    local = np.zeros(problem.bodies.count)
    np.maximum.at(local, problem.bodies.rows[rows, 0], values[rows])
    return largest(problem.comm, local)


def _relative_gaps(problem: MeasuredProblem, measures: Measures) -> NDArray[np.float64]:
    """Half the bound on the squared error of each body over its strain energy, (bodies,).

    The error of a body is at most the error of its group plus its own rounding errors. A group that
    moves rigidly has no error, unless the gap is far above rounding errors: then contact forces
    that the answer does not have would strain it.
    """
    bodies = problem.bodies
    gap = np.sqrt(2.0 * np.maximum(measures.gaps, 0.0))[bodies.groups]
    square = (gap + np.sqrt(measures.roundings)) ** 2
    rounded = bodies.sum_by_group(measures.roundings)[bodies.groups]
    unmoved = np.where(gap**2 > STRAINING * rounded, 1.0, 0.0)
    return np.divide(square, measures.scales, out=unmoved, where=measures.scales > 0.0)
