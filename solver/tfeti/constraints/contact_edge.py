"""The edge of contact: where an active set is too wide, rows leave with their mirror image.

If an active set is too wide by a, the pressure at distance s from its edge is

    p(s) ≈ A √s - A a / (2 √s),

to first order in a, since the pressure at the right edge is A √(s - a). It is tensile up to s =
a/2. Active sets that release tensile rows alone halve the excess with each set: the finer the mesh,
the more sets. If tensile rows leave together with their mirror image across the line where tension
ends, the excess that is left is of second order.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from solver.tfeti.dual import DualProblem

SLACK = {1: 2.5, 2: 2.5, 3: 5.5}
"""Rows at the inner edge of the mirror image that stay active, by components of a node.

If a set is not solved to the end, the edge of its tensile rows is ragged, on a surface more than on
a line.
"""

APART = 10.0
"""Distance added between contacts, over the extent of all points: no contact is near another."""

AROUND = 8
"""Number of neighbours among which the row farthest from all compressive rows is taken."""

Array = NDArray[np.float64]


def mirror_image(
    problem: DualProblem, active: NDArray[np.bool_], leaving: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Active rows in the mirror image of leaving ones across the edge of contact (collective).

    A tensile row at distance w from all compressive rows lies in a tensile zone of width w. The
    mirror image is made of the compressive rows within 2 w of the rows farthest inside such zones.

    Parameters
    ----------
    active : (dual,)
        The active set.
    leaving : (dual,)
        Its rows with tensile multipliers.

    Returns
    -------
    Mask (dual,) of compressive rows of the active set.
    """
    comm = problem.comm
    rows = np.flatnonzero(problem.inequality)
    places = _places(comm, problem.contact.points, problem.contact.sources)
    tensile = leaving[rows]
    compressive = active[rows] & ~tensile
    requested = np.concatenate(comm.allgather(places[tensile]))
    result = np.zeros(problem.size, bool)
    if not len(requested) or not comm.allreduce(int(compressive.sum())):
        return result
    depth = _tree(places[compressive]).query(requested)[0]
    comm.Allreduce(MPI.IN_PLACE, depth, op=MPI.MIN)
    spacing, innermost = _within(requested, depth)
    reach = 2.0 * depth - SLACK[problem.dimension] * spacing
    some = np.flatnonzero(innermost & (reach > depth) & (depth < 0.5 * APART))
    if len(some):
        distance, which = _tree(requested[some]).query(
            places[compressive], distance_upper_bound=float(reach[some].max())
        )
        found = distance < np.append(reach[some], 0.0)[which]
        result[rows[compressive][found]] = True
    return result


def _tree(points: Array) -> cKDTree:
    """A search tree for one query: built fast, not well balanced."""
    return cKDTree(points, compact_nodes=False, balanced_tree=False)


def _places(comm: MPI.Intracomm, points: Array, sources: NDArray[np.int64]) -> Array:
    """Points (n, 3) over their extent, with a fourth coordinate that separates contacts: (n, 4)."""
    corners = np.full((2, 3), -np.inf)
    if len(points):
        corners = np.stack([points.max(axis=0), -points.min(axis=0)])
    comm.Allreduce(MPI.IN_PLACE, corners, op=MPI.MAX)
    extent = float(np.linalg.norm(corners.sum(axis=0)))
    return np.column_stack([points / (extent or 1.0), APART * sources])


def _within(points: Array, depth: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance of each point to the next one, and the mask of points as deep as their neighbours.

    Parameters
    ----------
    depth : (n,)
        Depths. A point counts as deeper than another one if it is deeper by half their distance.
    """
    distance, which = _tree(points).query(points, AROUND + 1)
    distance = np.where(distance > 0.0, distance, np.inf)
    deeper = np.append(depth, 0.0)[which] - depth[:, None]
    return distance.min(axis=1), np.asarray(~(deeper > 0.5 * distance).any(axis=1))
