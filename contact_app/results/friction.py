"""Friction of an answer: its work, its fields at nodes, and the points that close.

The slip limit of a point changes from s' = μ λ_n' + s₀ at the begin of an increment to
s = μ λ_n + s₀ at its end, and friction dissipates

    Σ ½ (s' + s)/s λ_t · w

over all points. If all forces grow from zero in proportion, with one answer for all loads or in
increments, and if slip limits are given, this is exact; otherwise the error is of second order in
the size of increments. λ_t · w, with the forces at the end, would be twice the work of Coulomb
friction under a load that is applied at once.
"""

from collections.abc import Iterable

import numpy as np

from contact_app.model.geometry import Geometry
from contact_app.model.normal_forces import NormalForces
from contact_app.model.rigid import RigidUnknowns, slips_of_held
from contact_app.scene.rigid import RigidBodies
from meshes.arrays import Array, Ints
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem


def of_most_pressed(
    contacts: Iterable[tuple[Ints, Array, Array, Array, Ints]], count: int, d: int
) -> tuple[Array, Array, Ints]:
    """Friction traction and slip, (count, d), and status, (count,), of nodes.

    Where contacts meet, a node has the values of the contact with the largest pressure.

    Parameters
    ----------
    contacts
        Nodes (n,) of each contact, with pressure (n,), traction and slip (n, 3) and status (n,).
    """
    traction, slip = np.zeros((2, count, d))
    status, pressed = np.zeros(count, np.int64), np.full(count, -1.0)
    for at, pressure, own_traction, own_slip, own_status in contacts:
        most = pressure > pressed[at]
        some = at[most]
        pressed[some], status[some] = pressure[most], own_status[most]
        traction[some], slip[some] = own_traction[most, :d], own_slip[most, :d]
    return traction, slip, status


def friction_potential(problem: DualProblem, solution: Solution) -> float:
    """Σ λ_t · w with the friction forces of an answer (collective)."""
    return float(problem.comm.allreduce(float(_works(problem, solution).sum())))


def dissipated_work(
    problem: DualProblem, solution: Solution, before: NormalForces | None = None
) -> float:
    """The work dissipated by friction in an increment (collective).

    Parameters
    ----------
    before
        Normal forces at its begin; None without loads.
    """
    points = problem.friction
    limits = points.slip_limits(solution.multiplier)
    begun = points.limits
    if before is not None:
        row = (np.cumsum(problem.inequality) - 1)[points.normals[points.first]]
        begun = begun + points.coefficients * before.at(problem.contact)[row]
    mean = np.divide(0.5 * (begun + limits), limits, out=np.zeros(len(limits)), where=limits > 0.0)
    return float(problem.comm.allreduce(float(mean @ _works(problem, solution))))


def _works(problem: DualProblem, solution: Solution) -> Array:
    """λ_t · w of each point, (points,)."""
    points = problem.friction
    residual = problem.jumps(solution.displacements)
    return points.dots(points.forces(solution.multiplier), points.slips(residual))


def moved_by_held(
    geometry: Geometry, problem: DualProblem, before: RigidBodies | None, slips: bool = False
) -> Array:
    """Sum (dual,) with which penetrations, or slips, are those before held rigid bodies moved.

    Zero for other rows.

    Parameters
    ----------
    before
        The rigid bodies as they were loaded before; None without load.
    """
    added, chosen, rows = np.zeros(problem.size), problem.inequality, problem.contact
    if slips:
        chosen, rows = problem.tangential, problem.shared.friction.rows
    if geometry.rigid.bodies:
        of_rows = slips_of_held(rows, RigidUnknowns.of(geometry), geometry.contacts, before)
        added[chosen] = of_rows * problem.spread[chosen]
    return added


def closing_points(
    problem: DualProblem,
    solution: Solution,
    start: list[Array] | None,
    approach: Array | float = 0.0,
) -> tuple[int, int]:
    """Number of points with Coulomb friction that close or open before an answer (collective).

    Parameters
    ----------
    start : one (n, members) array per class
        Displacements that slip is measured from; None for those of the unloaded bodies.
    approach : (dual,)
        Added to the penetrations of the start, where rigid bodies have moved since.

    Returns
    -------
    Numbers of points that close or open, and of points in contact at the start or at the end.
    """
    points = problem.friction
    if start is None and solution.measures.displacement == 0.0:
        return 0, 0
    begun = start or [np.zeros_like(u) for u in solution.displacements]
    begun_at = problem.jumps(begun) + approach
    was_open = (
        -points.normal_residuals(begun_at) > solution.tolerance * solution.measures.displacement
    )
    closed, rough = points.pressing(solution.multiplier) > 0.0, points.coefficients > 0.0
    counts = (rough & (was_open == closed)).sum(), (rough & (closed | ~was_open)).sum()
    changed, touching = problem.comm.allreduce(np.array(counts))
    return int(changed), int(touching)
