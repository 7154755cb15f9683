"""The admissible multipliers of a dual problem as a separable convex set of x = λ - λ̃.

λ_n ≥ 0 on contact rows. With friction and given slip limits s also |λ_t| ≤ s: bounds at points with
one tangential row, a disc about -λ̃_t at points with two.
"""

import numpy as np

from solver.qp.box import Box
from solver.qp.convex_set import SeparableSet
from solver.qp.discs import BoxAndDiscs
from solver.tfeti.dual import DualProblem
from solver.vectors import Array


def admissible_set(problem: DualProblem, limits: Array | None) -> SeparableSet:
    """The admissible set for slip limits (points,), which are forces; None without friction."""
    lower = problem.lower
    points = problem.friction
    if limits is None:
        return Box(lower)
    radius = limits / points.spread[points.first]
    lower = np.full(problem.size, -np.inf) if lower is None else lower.copy()
    upper = np.full(problem.size, np.inf)
    alone = np.bincount(points.point, minlength=len(points.first)) == 1
    rows = points.rows[points.first[alone]]
    lower[rows], upper[rows] = (sign * radius[alone] - problem.offset[rows] for sign in (-1, 1))
    planar = points.planar
    if not problem.comm.allreduce(len(planar)):
        return Box(lower, upper)
    first, second = (points.rows[points.first[planar] + k] for k in (0, 1))
    center = -np.stack([problem.offset[first], problem.offset[second]])
    return BoxAndDiscs(Box(lower, upper), first, second, center, radius[planar])
