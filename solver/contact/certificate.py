"""The certificate: how right an answer is, recomputed from the answer.

Nothing here trusts the solver's residuals. From the multiplier λ and the displacements u are
computed anew: jumps and penetration B u - c, the residual of equilibrium K u - f + Bᵀ λ on every
unknown, the sign of the contact forces, complementarity, and the duality gap.

The gap. u minimises L(·, λ) = ½ a(u,u) - l(u) + λᵀ(B u - c), because K u = f - Bᵀ λ; so for any
admissible û (glued, held, not penetrating)

    J(û) - D(λ) = ½ (û - u)ᵀ K (û - u) - λᵀ (B û - c) ≥ 0,

a sum of non-negative terms without cancellation, and the exact solution u* obeys
½ ‖û - u*‖²_K ≤ J(û) - J(u*) ≤ J(û) - D(λ). It bounds the algebraic error; the error of the mesh
is another matter. Any û will do. The nearest one to u is open wherever u is, which costs
λᵀ (c - B u), first order in the error; rows that press are therefore closed in û where that costs
less, second order.

Friction. λ_t is a friction force over its slip limit, s = μ λ_n of the answer or what is given, and
w the slip. `friction_cone` is what |λ_t| exceeds s by. `slip_alignment` is the sum of
|s w - |w| λ_t| over all points, zero where every point either rests or slides along a force at its
limit, or the largest slip of a point that should rest, if that is more. The duality gap is that of
the problem with the limits s, to which û adds s |ŵ| - λ_t · ŵ ≥ 0 at each point.

What the numbers are relative to. Each body is measured by its own sizes: lengths by its largest
displacement without rigid motions that nothing resists (`solver.tfeti.free_motions`), forces by its
load (the largest of the sums of the magnitudes of loads, of reactions and of contact forces), the
gap by its strain energy ½ a(u,u). A weak body beside a strong one, or a stiff one on a soft one, is
so certified for itself (`solver.contact.bodies`). Bodies that can touch form a group; the gap of a
group bounds the error of each of its bodies. The worst body decides.

Rounding. The numbers stand in for the exact u. What rounding u to its last digit makes of its
strains, and the energy norm of the residual of equilibrium (by the diagonal of K, as of an error
without a pattern), are added to the root of the gap: a body that is moved so far that nothing is
left of the digits of its strains does not pass.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver.contact.bodies import Bodies, body_lengths, largest, sizes
from solver.contact.sizes import (
    MeasuredAnswer,
    MeasuredProblem,
    energy_scales,
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
"""Residual of equilibrium that round-off may leave, relative to the load."""

ROUNDED_LIMIT = 1e-6
"""Residual of equilibrium beyond which rounding is no excuse."""


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
        ‖K u - f + Bᵀ λ‖ over the load, in the 2-norm of all unknowns that are solved for.
    duality_gap
        J(û) - D(λ) over the strain energy, with what rounding may add.
    friction_cone
        Largest friction force beyond its limit, over the load.
    slip_alignment
        Slips against their friction forces over load times largest displacement, or the largest
        slip below the limit over the largest displacement.
    frictional
        Whether the scene has friction.
    passed
        Whether all of them are below the tolerance asked for.
    round_off
        What rounding u to its last digit leaves of equilibrium, over the load; the residual may
        come to that (and to no more than 1e-6). A body that is moved far and hardly strained, a
        stiff one on a soft one, cannot do better: its forces are differences of large numbers.
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
        """The same numbers, held against a tolerance."""
        return replace(self, passed=max(self._shares(tolerance)) <= 1.0)

    def required_reduction(self, tolerance: float) -> float:
        """Factor by which the error has to fall; one or less where the certificate passes.

        The gap is of second order in it. What is not a number passes nothing.
        """
        shares = dict(zip(NUMBERS, self._shares(tolerance), strict=True))
        shares["duality_gap"] = float(np.sqrt(shares["duality_gap"]))
        return max(shares.values())

    def deciding(self, tolerance: float) -> int | None:
        """The body that decides whether the certificate passes; None where there is one body."""
        return self.worst[int(np.argmax(self._shares(tolerance)))] if self.worst else None

    def _shares(self, tolerance: float) -> list[float]:
        """Each of `NUMBERS` over what it may be; infinite for what is not a number."""
        limits = dict.fromkeys(NUMBERS, tolerance)
        rounded = min(self.round_off, ROUNDED_LIMIT)
        limits["equilibrium"] = max(tolerance, EQUILIBRIUM_FLOOR, rounded)
        shares = [abs(getattr(self, name)) / limit for name, limit in limits.items()]
        return [share if np.isfinite(share) else np.inf for share in shares]

    def as_dict(self) -> dict[str, Any]:
        """As `summary.json` holds it."""
        found = {**asdict(self), "warnings": list(self.warnings)}
        del found["worst"]
        if not found.pop("frictional"):
            del found["friction_cone"], found["slip_alignment"]
        return found


@dataclass(frozen=True, eq=False)
class Measures:
    """Sizes of an answer, of each body and of the scene.

    Attributes
    ----------
    displacements : (bodies,)
        Largest |u| over all nodes of each body, in units of length; zero for rigid bodies.
    deformations : (bodies,)
        The same without the rigid motions that nothing resists: what lengths are relative to.
    loads : (bodies,)
        Largest of the sums of magnitudes of loads, reactions and contact forces of each body.
    pressed : (bodies,)
        Sum of the contact forces on each body.
    strains : (bodies,)
        a(u, u) of each body, twice its strain energy.
    roundings : (bodies,)
        The same of what rounding and the residual of equilibrium may have done to u.
    gaps : (groups,)
        The duality gap J(û) - D(λ) of each group, in units of energy.
    energy
        ½ a(û,û) - l(û) of the admissible û; its error is second order, at most the duality gap.
    groups : (bodies,)
        The group of each body.
    scales : (bodies,)
        What squared errors in energy norm are relative to in each body; zero where nothing is
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
        """Bound on ‖û - u*‖² of each group, (groups,), with what rounding may add."""
        rounding = np.bincount(self.groups, self.roundings, len(self.gaps))
        return np.asarray((np.sqrt(2.0 * np.maximum(self.gaps, 0.0)) + np.sqrt(rounding)) ** 2)


def certificate_of(
    answer: MeasuredAnswer,
    tolerance: float,
    relaxations: int = 0,
    unsolved: NDArray[np.float64] | None = None,
) -> tuple[Certificate, Measures]:
    """Compute the certificate of an answer (collective).

    Parameters
    ----------
    tolerance
        `solver.tolerance` of the scene.
    relaxations
        Steps that sharpen the gap: û's inside follows its interface, or where there are Schur
        complements does so at once, and the interface moves where nothing holds it.
    unsolved : (bodies,)
        What an iterative solver left of K u = f - Bᵀ λ: the squared error in energy norm of the
        group of each body. The gap takes that equation for granted, so its root is added to the
        root of the gap.
    """
    problem, multiplier, residual = answer.problem, answer.multiplier, answer.residual
    comm, bodies, contact = problem.comm, problem.bodies, problem.inequality
    slack = residual / problem.spread

    deformed = answer.largest_deformations()
    lengths = body_lengths(bodies, deformed, problem.free_lengths)
    state, (rounded, disturbed) = answer.equilibrium(), answer.round_off()
    force = np.where(problem.conditional, multiplier * problem.spread, 0.0)
    forces = answer.forces_on_bodies(force, state.reactions)
    gaps = answer.gaps(relaxations)
    bounds = gaps if unsolved is None else _with_unsolved(bodies, gaps, unsolved)
    work = float(comm.allreduce(multiplier @ residual - _friction_work(answer)))
    idle = comm.allreduce(bodies.sum_rows(np.abs(force * slack), contact))
    roundings = (np.sqrt(disturbed) + np.sqrt(state.disturbances)) ** 2
    measures = Measures(
        displacements=answer.largest_displacements(),
        deformations=deformed,
        loads=forces.max(axis=0),
        pressed=forces[2],
        strains=state.strains,
        roundings=roundings,
        scales=energy_scales(problem, state.strains, roundings, forces, rounded),
        gaps=bounds,
        energy=float(state.energy + work + gaps.sum()),
        groups=bodies.groups,
    )
    # forces on what is merely moved are rounding errors: relative to those that would move it
    moving = rounded / np.finfo(np.float64).eps
    load = sizes(bodies, np.where(measures.scales > 0.0, measures.loads, moving))
    away = np.abs(slack) / bodies.of_rows(lengths)
    pulls = np.where(contact, np.maximum(-force, 0.0), 0.0) / bodies.of_rows(load)
    found = {
        "max_penetration": _worst_rows(problem, np.where(slack > 0.0, away, 0.0), contact),
        "max_gluing_jump": _worst_rows(problem, away, ~problem.conditional),
        "min_multiplier": _worst_rows(problem, pulls, contact),
        "complementarity": idle / (load * lengths),
        "equilibrium": state.imbalance / load,
        "duality_gap": _relative_gaps(problem, measures),
        **friction_numbers(problem, answer.multiplier, residual, load, lengths),
    }
    frictional = problem.friction is not None
    certificate = replace(_certificate(found, rounded / load), frictional=frictional)
    return certificate.judged(tolerance), measures


def _friction_work(answer: MeasuredAnswer) -> float:
    """Σ s |w| of this rank: a part of J(û), but not of the energy of the bodies."""
    points = answer.problem.friction
    if points is None:
        return 0.0
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
        What forces and lengths are relative to.
    """
    points, bodies = problem.friction, problem.bodies
    if points is None:
        return {name: np.zeros(bodies.count) for name in ("friction_cone", "slip_alignment")}
    rows = points.rows[points.first]
    here = np.zeros(len(multiplier), bool)
    here[rows] = True

    def at_rows(values: NDArray[np.float64]) -> NDArray[np.float64]:
        result = np.zeros(len(multiplier))
        result[rows] = values
        return result

    forces, slips = points.forces(multiplier), points.slips(residual)
    size, limit, slip = points.sizes(forces), points.slip_limits(multiplier), points.sizes(slips)
    beyond = at_rows(np.maximum(size - limit, 0.0)) / bodies.of_rows(load)
    askew = points.sizes(limit[points.point] * slips - slip[points.point] * forces)
    rests = ~points.sliding(multiplier)[rows]
    moved = at_rows(np.where(rests, slip, 0.0)) / bodies.of_rows(lengths)
    astray = problem.comm.allreduce(bodies.sum_rows(at_rows(askew), here)) / (load * lengths)
    return {
        "friction_cone": _worst_rows(problem, beyond, here),
        "slip_alignment": np.maximum(astray, _worst_rows(problem, moved, here)),
    }


def _with_unsolved(
    bodies: Bodies, gaps: NDArray[np.float64], unsolved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """½ (√(2 gap) + e)² of each group, e the energy norm of what was not solved."""
    error = np.sqrt(bodies.by_group(unsolved))
    return np.asarray(0.5 * (np.sqrt(2.0 * np.maximum(gaps, 0.0)) + error) ** 2)


def _certificate(
    found: dict[str, NDArray[np.float64]], rounded: NDArray[np.float64]
) -> Certificate:
    """The worst body's numbers, from those of all bodies; none of it judged yet.

    Bodies whose residual of equilibrium exceeds their rounding errors count as worse than others.
    """
    blame = dict(found)
    excess = found["equilibrium"] > np.minimum(rounded, ROUNDED_LIMIT)
    if excess.any():
        blame["equilibrium"] = np.where(excess, found["equilibrium"], 0.0)
    worst = {name: int(np.argmax(values)) for name, values in blame.items()}
    numbers = {name: float(values[worst[name]]) for name, values in found.items()}
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

    The error of a body is at most that of its group, and what rounding makes of its own digits.
    """
    gap = np.sqrt(2.0 * np.maximum(measures.gaps, 0.0))[problem.bodies.groups]
    square = (gap + np.sqrt(measures.roundings)) ** 2
    strained = measures.scales > 0.0
    return np.divide(square, measures.scales, out=np.zeros(len(square)), where=strained)
