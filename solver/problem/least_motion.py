"""The least of the rigid motions that contact forces and loads leave undetermined.

Bodies that contact alone holds may have rigid motions V z on which all rows with a force, the
tangential rows of points with a slip limit, and all rows that always hold with equality vanish.
They strain nothing, nothing slips, and the loads do no work on them, so all u - V z that satisfy
the contact conditions have the same energy, stresses and contact forces. A method returns any one
of them. Here the one that moves least is chosen: with u_b and V_b z at the n_b nodes of body b,

    min_z Σ_b |u_b - V_b z|² / n_b    with    B u - c - B V z ≤ max(B u - c, 0)  on contact rows.

Rows that only stop motions which nothing else stops (`RowKind.SUPPORT`) have no force. Their nodes
depend on the decomposition, so that they do not count: such a motion is one of V, and the answer
has none of it in the mean.

This is a strictly convex problem of a few unknowns. With y = Lᵀ z, L Lᵀ the matrix of its quadratic
form, it asks for the point of a polyhedron around the origin that is nearest to a given one.
"""

from dataclasses import replace

import numpy as np

from solver.contact.equilibrium import held_motions
from solver.contact.nearest_point import nearest_point
from solver.contact.row_kinds import RowKind
from solver.contact.solution import Solution
from solver.problem.certify import certify
from solver.problem.decomposed import DecomposedProblem
from solver.problem.free_motions import RESOLVED, FreeMotions
from solver.problem.sizes import rows_on_allowed_motions, rows_that_resist
from solver.vectors import Array, Mask, largest_magnitude

ROUNDED = 1e-9
"""Coefficient of a row along a motion over the largest, below which it is a rounding error; motion
over the displacement in the mean square, below which an answer stays as it is."""

AT_REST = 1e-11
"""Displacement over the motion that is taken away, below which it is a rounding error of this,
1e-12 to 1e-11 by some kernels of the BLAS."""

NO_FORCE = 1e-13
"""Contact force over the largest load of the group of bodies, below which it is a rounding error:
forces of 4e-15 stood on bodies that nothing else pressed."""


def with_least_motion(problem: DecomposedProblem, solution: Solution) -> Solution:
    """A certified answer with the least undetermined motions (collective).

    The answer stays as it is if the certificate of the moved one does not pass.
    """
    free = problem.free_motions
    if free is None or not solution.converged:
        return solution
    moved = _moved(problem, free, solution)
    if moved is None:
        return solution
    placed = with_supports_at(problem, moved)
    # the gap of a method for displacements has the error that its equations had
    unsolved = None if problem.factored else np.zeros(problem.bodies.count)
    certificate, measures = certify(
        placed, solution.multiplier, moved, solution.tolerance, unsolved
    )
    worse = max(certificate.duality_gap, solution.certificate.duality_gap)
    gaps = np.maximum(measures.gaps, solution.measures.gaps)
    certificate = replace(certificate, duality_gap=worse).judged(solution.tolerance)
    if not certificate.passed:
        return solution
    return replace(
        solution,
        displacements=moved,
        certificate=certificate,
        measures=replace(measures, gaps=gaps),
    )


def with_supports_at(problem: DecomposedProblem, displacements: list[Array]) -> DecomposedProblem:
    """The problem whose supports, which have no force, are where displacements are (collective)."""
    supports = problem.kinds == RowKind.SUPPORT
    if not problem.comm.allreduce(int(supports.any())):
        return problem
    moved = problem.jumps(displacements) + problem.c
    loads = replace(problem.load_case, c=np.where(supports, moved, problem.c))
    return replace(problem, load_case=loads)


def _moved(problem: DecomposedProblem, free: FreeMotions, solution: Solution) -> list[Array] | None:
    """The displacements u - V z of least size; None where they are u (collective)."""
    resist = _resisting(problem, solution)
    left = -problem.jumps(solution.displacements)
    earlier = problem.load_case.displacements_before or [
        np.zeros(1) for _ in solution.displacements
    ]
    changes = [u - before for u, before in zip(solution.displacements, earlier, strict=True)]
    motions: list[Array | None] = [None] * problem.bodies.count
    sizes = np.zeros(problem.bodies.count)
    for group in range(problem.bodies.group_count):
        along, images = _undetermined(problem, free, group, resist)
        if not images.shape[1]:
            continue
        gram, right = free.mean_squares(changes, along, group)
        values, vectors = np.linalg.eigh(gram)
        moving = values > RESOLVED * values.max()
        basis = vectors[:, moving] / np.sqrt(values[moving])
        may_close = problem.inequality & ~resist
        closing, distances = -images[may_close] @ basis, np.maximum(left[may_close], 0.0)
        size = nearest_point(problem.comm, basis.T @ right, closing, distances)
        if size is None or np.linalg.norm(size) <= ROUNDED * solution.measures.displacement:
            continue
        for b in np.flatnonzero(problem.bodies.groups == group):
            motions[b], sizes[b] = along[b] @ (basis @ size), np.linalg.norm(size)
    if all(motion is None for motion in motions):
        return None
    moved = [u.copy(order="F") for u in solution.displacements]
    for number, members in enumerate(free.members):
        for member, b in enumerate(members):
            motion, part = motions[b], moved[number][:, member]
            if motion is not None:
                part -= free.field(number, member, motion)
                if np.abs(part).max() <= AT_REST * sizes[b]:
                    part[:] = 0.0
    return moved


def _resisting(problem: DecomposedProblem, solution: Solution) -> Mask:
    """Mask (dual,) of the contact rows with a force, and of tangential rows with a slip limit.

    Collective. Forces that are rounding errors beside the loads of the group count as none.
    """
    bodies, points = problem.bodies, problem.friction
    largest = bodies.by_group(solution.measures.loads)[bodies.groups[bodies.rows[:, 0]]]
    real = np.abs(solution.multiplier) * problem.spread > NO_FORCE * largest
    resist = rows_that_resist(problem, solution.multiplier) & real
    limits = points.slip_limits(np.where(resist, solution.multiplier, 0.0))
    resist[points.rows] |= (limits > 0.0)[points.point]
    return np.asarray(resist)


def _undetermined(
    problem: DecomposedProblem, free: FreeMotions, group: int, resist: Mask
) -> tuple[list[Array], Array]:
    """The motions V of a group, (motions, k) for each body, and B V, (dual, k) (collective).

    Bodies of other groups have k = 0.

    Parameters
    ----------
    resist : (dual,)
        Contact rows with a force, and tangential rows with a slip limit.
    """
    images = rows_on_allowed_motions(problem, free, group)
    images[np.abs(images) <= ROUNDED * largest_magnitude(problem.comm, images)] = 0.0
    motions = np.zeros((0, 0))
    if images.shape[1]:
        holds = ~problem.conditional & (problem.kinds != RowKind.SUPPORT)
        motions = held_motions(problem.comm, images[resist | holds])
    along = [
        some @ motions if of_body == group else some[:, :0]
        for some, of_body in zip(free.loose.allowed, problem.bodies.groups, strict=True)
    ]
    return along, images @ motions
