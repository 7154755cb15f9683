"""The certificate of multipliers and displacements (`solver.contact.certificate`)."""

from dataclasses import replace

import numpy as np

from solver.contact.bodies import Bodies, body_lengths, largest, reference_sizes
from solver.contact.certificate import NUMBERS, ROUNDED_LIMIT, Certificate, Measures
from solver.problem.decomposed import DecomposedProblem
from solver.problem.duality_gap import group_gaps
from solver.problem.sizes import (
    BodyForces,
    MeasuredAnswer,
    energy_scales,
    force_references,
    summed_forces,
)
from solver.vectors import Array, Mask

STRAINING = 200.0
"""Square of the error by the gap of a group that moves rigidly, over that of its rounding errors.

From there on the group would be strained by contact forces that the answer does not have. Blocks
that came to rest beside a lid had up to 130, by the kernels of the BLAS.
"""


def certify(
    problem: DecomposedProblem,
    multiplier: Array,
    displacements: list[Array],
    tolerance: float,
    unsolved: Array | None = None,
) -> tuple[Certificate, Measures]:
    """Compute the certificate of an answer (collective).

    Parameters
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array per class
        Displacements u.
    tolerance
        `solver.tolerance` of the scene.
    unsolved : (bodies,)
        Squared error in energy norm of the group of each body that an iterative solver left in K u
        = f - Bᵀ λ. The gap assumes this equation, so the root of this number is added to the root
        of the gap.
    """
    answer = MeasuredAnswer(problem, multiplier, displacements)
    residual = answer.residual
    comm, bodies, contact = problem.comm, problem.bodies, problem.inequality
    slack = residual / problem.spread

    deformed = answer.largest_deformations()
    lengths = body_lengths(bodies, deformed, problem.free_lengths)
    state, (rounded, disturbed) = answer.equilibrium(), answer.round_off()
    force = np.where(problem.conditional, multiplier * problem.spread, 0.0)
    loads, held, touching = summed_forces(problem, multiplier, force)
    forces = BodyForces(loads, held + state.reactions, touching, rounded)
    gaps = group_gaps(problem, multiplier, answer.interface)
    bounds = gaps if unsolved is None else _with_unsolved(bodies, gaps, unsolved)
    work = float(comm.allreduce(multiplier @ residual - _friction_work(answer)))
    idle = comm.allreduce(bodies.sum_rows(np.abs(force * slack), contact))
    # what an iterative solver left in K u = f - Bᵀ λ is no rounding error
    residual_rounding = state.disturbances if unsolved is None else disturbed
    pure, every = (
        (np.sqrt(disturbed) + np.sqrt(of_residual)) ** 2
        for of_residual in (residual_rounding, state.disturbances)
    )
    measures = Measures(
        displacements=answer.largest_displacements(),
        deformations=deformed,
        loads=forces.largest,
        pressed=forces.contact,
        strains=state.strains,
        roundings=pure,
        scales=energy_scales(problem, state.strains, pure, forces),
        gaps=bounds,
        energy=float(state.energy + work + gaps.sum()),
        groups=bodies.groups,
    )
    # forces on a body that moves rigidly are rounding errors: relative to forces that would move it
    moving = rounded / np.finfo(np.float64).eps
    references = force_references(problem, forces, tolerance)
    load = reference_sizes(bodies, np.where(measures.scales > 0.0, references, moving))
    distance = np.abs(slack) / bodies.of_rows(lengths)
    pulls = np.where(contact, np.maximum(-force, 0.0), 0.0) / bodies.of_rows(load)
    by_body = {
        "max_penetration": _worst_rows(problem, np.where(slack > 0.0, distance, 0.0), contact),
        "max_gluing_jump": np.maximum(
            _worst_rows(problem, distance, ~problem.conditional), answer.errors_of_held() / lengths
        ),
        "min_multiplier": _worst_rows(problem, pulls, contact),
        "complementarity": idle / reference_sizes(bodies, load * lengths),
        "equilibrium": state.imbalance / load,
        "duality_gap": _relative_gaps(problem, measures, every),
        **friction_numbers(problem, multiplier, residual, load, lengths),
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
    problem: DecomposedProblem, multiplier: Array, residual: Array, load: Array, lengths: Array
) -> dict[str, Array]:
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

    def at_rows(values: Array) -> Array:
        result = np.zeros(len(multiplier))
        result[rows] = values
        return result

    forces, slips = points.forces(multiplier), points.slips(residual)
    size, limit, slip = (points.sizes(forces), points.slip_limits(multiplier), points.sizes(slips))
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
            misalignment / reference_sizes(bodies, load * lengths),
            _worst_rows(problem, moved, here),
        ),
    }


def _with_unsolved(bodies: Bodies, gaps: Array, unsolved: Array) -> Array:
    """½ (√(2 gap) + e)² of each group, e the energy norm of the error of the iterative solver."""
    error = np.sqrt(bodies.by_group(unsolved))
    return np.asarray(0.5 * (np.sqrt(2.0 * np.maximum(gaps, 0.0)) + error) ** 2)


def _certificate(by_body: dict[str, Array], rounded: Array) -> Certificate:
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


def _worst_rows(problem: DecomposedProblem, values: Array, rows: Mask) -> Array:
    """The largest of values (dual,) over some rows of each body, (bodies,) (collective)."""
    local = np.zeros(problem.bodies.count)
    np.maximum.at(local, problem.bodies.rows[rows, 0], values[rows])
    return largest(problem.comm, local)


def _relative_gaps(problem: DecomposedProblem, measures: Measures, disturbed: Array) -> Array:
    """Half the bound on the squared error of each body over its strain energy, (bodies,).

    The error of a body is at most the error of its group plus its own rounding errors. A group that
    moves rigidly has no error, unless the gap is far above rounding errors: then contact forces
    that the answer does not have would strain it.

    Parameters
    ----------
    disturbed : (bodies,)
        `measures.roundings` with the residual of an iterative solver.
    """
    bodies = problem.bodies
    gap = np.sqrt(2.0 * np.maximum(measures.gaps, 0.0))[bodies.groups]
    square = (gap + np.sqrt(disturbed)) ** 2
    rounded = bodies.sum_by_group(measures.roundings)[bodies.groups]
    unmoved = np.where(gap**2 > STRAINING * rounded, 1.0, 0.0)
    return np.divide(square, measures.scales, out=unmoved, where=measures.scales > 0.0)


def friction_residual(
    problem: DecomposedProblem, multiplier: Array, jumps: Array, lengths: Array
) -> float:
    """The larger of the two friction numbers of the certificate, for a state (collective).

    The load of each body is taken without reactions at eliminated unknowns; so the number is not
    too small.

    Parameters
    ----------
    multiplier, jumps : (dual,)
        λ and B u - c.
    lengths : (bodies,)
        References of lengths.
    """
    bodies = problem.bodies
    force = np.where(problem.conditional, multiplier * problem.spread, 0.0)
    forces = summed_forces(problem, multiplier, force)
    load = reference_sizes(bodies, forces.max(axis=0))
    numbers = friction_numbers(problem, multiplier, jumps, load, lengths)
    return float(max(values.max() for values in numbers.values()))
