"""The share of the loads that friction holds at the contact forces of an answer.

The test of equilibrium before a solve asks whether any contact forces with their friction balance
the loads. Opposite contacts, as in a closed socket, then balance each other at any size, and their
friction holds any moment. Elastic bodies without an overlap before the load do not press like that.
With the normal forces of an answer as given, the slip limits are μ λ_n, and the bodies are in
equilibrium up to a share of the loads (`solver.contact.equilibrium.carried_share`).
"""

from dataclasses import dataclass

import numpy as np

from solver.contact.equilibrium import FrictionCones, balance, carried_share, slide
from solver.contact.solution import Solution
from solver.problem.decomposed import DecomposedProblem
from solver.problem.free_motions import FreeMotions
from solver.problem.sizes import rows_on_allowed_motions
from solver.vectors import Array, Ints

HOLDS = 0.995
"""Share of the loads below which friction is said not to hold them. Contact forces without a
certificate are not accurate, but a history comes near the limit before a body leaves: forces of a
block between walls that cool down hold 0.9 of its loads where it falls."""

NEAR = 1.03
"""Factor on all loads that friction does not hold, from which on it is near its limit. In the last
answer before a block turns it has been up to 1.012. The next one, without a certificate, may hold
0.99991 of the loads."""


@dataclass(frozen=True, eq=False)
class Overcome:
    """A group of bodies whose friction the loads overcome."""

    bodies: Ints  # (bodies,)
    """Numbers of the bodies of the group."""
    share: float
    """Share of the loads that friction holds."""
    motion: Array  # (bodies · motions,)
    """Rigid motions in which the bodies leave."""


def may_hold(problem: DecomposedProblem, solution: Solution) -> bool:
    """Whether friction at the forces of an answer holds the loads of all bodies (collective)."""
    return all(group.share >= HOLDS for group in overcome(problem, solution))


def overcome(problem: DecomposedProblem, solution: Solution, factor: float = 1.0) -> list[Overcome]:
    """Groups whose friction, at the forces of an answer, its loads overcome (collective).

    Parameters
    ----------
    factor
        On all loads.
    """
    free, points, comm = problem.free_motions, problem.friction, problem.comm
    if free is None or not points.acts:
        return []
    limits = points.slip_limits(solution.multiplier)[points.point]
    row_of = np.cumsum(problem.inequality) - 1
    result = []
    for group in range(problem.bodies.group_count):
        images = rows_on_allowed_motions(problem, free, group)
        count = images.shape[1]
        if not count:
            continue
        load, scale = _work_of_loads(problem, free, group)
        load *= factor
        cones = FrictionCones(
            images[points.rows] / points.spread[:, None], row_of[points.normals],
            np.zeros(len(limits)), limits,
        )  # fmt: skip
        rows = np.zeros((0, count)), images[problem.inequality]
        escape = balance(comm, *rows, load, scale, cones).escape
        if escape is None:
            continue
        share = carried_share(comm, *rows, load, cones) or 0.0
        escape = slide(comm, *rows, escape, cones)
        bodies = np.flatnonzero(problem.bodies.groups == group)
        motion = np.concatenate([free.loose.allowed[b] @ escape for b in bodies])
        result.append(Overcome(bodies, share, motion))
    return result


def _work_of_loads(
    problem: DecomposedProblem, free: FreeMotions, group: int
) -> tuple[Array, float]:
    """Work of the loads on the allowed motions of a group, (k,), and their size (collective)."""
    bodies = np.flatnonzero(problem.bodies.groups == group)
    work, scale = np.zeros(free.loose.allowed[bodies[0]].shape[1]), 0.0
    for number, members in enumerate(free.members):
        for member in np.flatnonzero(np.isin(members, bodies)):
            force = problem.forces[number][:, member]
            for k, motion in enumerate(free.loose.allowed[members[member]].T):
                work[k] += force @ free.field(number, int(member), motion)
            scale += float(np.abs(force).sum())
    return problem.comm.allreduce(work), problem.comm.allreduce(scale)
