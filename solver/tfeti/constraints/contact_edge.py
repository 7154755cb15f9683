"""The edge of contact: where an active set reaches too far, and its mirror image there.

If an active set reaches too far by a, the pressure at distance s from its edge is

    p(s) ≈ A √s - A a / (2 √s),

since to first order in a it is what the right edge makes of A √(s - a). It is tensile up to
s = a/2. Active sets that release tensile rows alone halve the excess with each set: the finer the
mesh, the more sets. If tensile rows leave together with their mirror image across the line where
tension ends, the excess that is left is of second order.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from solver.tfeti.dual import DualProblem

SLACK = {1: 2.5, 2: 2.5, 3: 5.5}
"""Rows at the inner edge of the mirror image that are left, by components of a node: where a set is
not solved to the end the edge of its tensile rows is ragged, along a surface more than along a
line."""

APART = 10.0
"""Distance that is put between contacts, over the extent of all: no contact is near another."""

AROUND = 8
"""Neighbours among which a row is the one farthest from all compressive rows."""

Array = NDArray[np.float64]


def mirror_image(
    problem: DualProblem, active: NDArray[np.bool_], leaving: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Active rows in the mirror image of leaving ones across the edge of contact (collective).

    A tensile row at distance w from all compressive ones stands for a tensile zone that is w wide
    there. The rows farthest inside such zones are asked, and the mirror image is what lies within
    2 w of them.

    Parameters
    ----------
    active : (dual,)
        The active set.
    leaving : (dual,)
        Its rows with tensile multipliers.

    Returns
    -------
    (dual,), compressive rows of the active set.
    """
    comm = problem.comm
    rows = np.flatnonzero(problem.inequality)
    places = _places(comm, problem.contact.points, problem.contact.sources)
    tensile = leaving[rows]
    compressive = active[rows] & ~tensile
    asked = np.concatenate(comm.allgather(places[tensile]))
    result = np.zeros(problem.size, bool)
    if not len(asked) or not comm.allreduce(int(compressive.sum())):
        return result
    depth = _tree(places[compressive]).query(asked)[0]
    comm.Allreduce(MPI.IN_PLACE, depth, op=MPI.MIN)
    spacing, innermost = _within(asked, depth)
    reach = 2.0 * depth - SLACK[problem.dimension] * spacing
    some = np.flatnonzero(innermost & (reach > depth) & (depth < 0.5 * APART))
    if len(some):
        distance, which = _tree(asked[some]).query(
            places[compressive], distance_upper_bound=float(reach[some].max())
        )
        found = distance < np.append(reach[some], 0.0)[which]
        result[rows[compressive][found]] = True
    return result


def _tree(points: Array) -> cKDTree:
    """A tree that is asked once: sooner made than well balanced."""
    return cKDTree(points, compact_nodes=False, balanced_tree=False)


def _places(comm: MPI.Intracomm, points: Array, sources: NDArray[np.int64]) -> Array:
    """Points (n, 3) over their extent, each contact's far from all others': (n, 4)."""
    corners = np.full((2, 3), -np.inf)
    if len(points):
        corners = np.stack([points.max(axis=0), -points.min(axis=0)])
    comm.Allreduce(MPI.IN_PLACE, corners, op=MPI.MAX)
    extent = float(np.linalg.norm(corners.sum(axis=0)))
    return np.column_stack([points / (extent or 1.0), APART * sources])


def _within(points: Array, depth: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance of each point to the next, and which are as deep as any around them.

    Parameters
    ----------
    depth : (n,)
        A point counts as deeper than another where it is by half their distance.
    """
    distance, which = _tree(points).query(points, AROUND + 1)
    distance = np.where(distance > 0.0, distance, np.inf)
    deeper = np.append(depth, 0.0)[which] - depth[:, None]
    return distance.min(axis=1), np.asarray(~(deeper > 0.5 * distance).any(axis=1))
