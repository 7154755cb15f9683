"""Bodies that slide wherever friction acts on them: how far they are carried along is open.

A bolt between two plates that slide may be carried along by either: where friction is at its limit
at all points, a rigid motion v along the slips changes no force as long as no slip turns round.
With D v = 0 on held rows, N v = 0 on contact rows that press, T v = 0 at points below their slip
limit and T v parallel to the friction force at points at their limit (nearly: forces under a round
head differ by some degrees), u + t v is another answer for all t with |w| + t dᵀ T v ≥ 0, w the
slip and d the direction of the friction force of a point.
"""

from collections.abc import Callable, Iterator

import numpy as np
from mpi4py import MPI
from scipy import sparse

from contact_app.results.undetermined import PRESSING, SMALL_PLAY, Movable, reach_of
from solver.contact.equilibrium import held_motions
from solver.contact.friction_points import FrictionPoints
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows
from solver.rigid_motions import MOTIONS
from solver.tfeti.dual import DualProblem
from solver.vectors import Array

PARALLEL = 0.01
"""Largest mean square of the sine between motion and friction force: six degrees change the
friction force along the motion by half a percent."""

RESOLVED = 1e-12
"""Mean square of the slips of a motion, over the largest, below which it moves no sliding point."""

SEEN = 1e-3
"""Share of the largest motion along the slips below which a point does not limit it."""


def carried(
    problem: DualProblem,
    solution: Solution,
    motions_of: Callable[[ContactRows], sparse.csr_matrix],
    bodies: Movable,
) -> Iterator[str]:
    """One sentence for each motion along the slips that friction leaves open (collective).

    Parameters
    ----------
    motions_of
        Rows applied to the rigid motions of each body, (rows, bodies · motions).
    """
    free, points, comm = problem.free_motions, problem.friction, problem.comm
    if free is None or not points.acts:
        return
    multiplier, point = solution.multiplier, points.point
    limits = points.slip_limits(multiplier)
    force = multiplier[problem.inequality] * problem.contact.spread
    least = PRESSING * comm.allreduce(float(force.max(initial=0.0)), op=MPI.MAX)
    rubs = (limits > least)[point]
    yields = points.sliding(multiplier)[points.rows] & rubs
    slips = points.slips(problem.jumps(solution.displacements))
    rows = motions_of(problem.shared.friction.rows)
    pressing = motions_of(problem.contact)[force > least]
    holding = sparse.vstack([pressing, rows[rubs & ~yields]])
    m = MOTIONS[problem.dimension]
    for group in bodies.groups:
        columns = (group[:, None] * m + np.arange(m)).ravel()
        allowed = np.concatenate([free.loose.allowed[b] for b in group])
        base = allowed @ held_motions(comm, np.asarray(holding[:, columns] @ allowed))
        images = np.where(yields[:, None], np.asarray(rows[:, columns] @ base), 0.0)
        along, across = _split(points, multiplier, images)
        weights = limits, limits[point]
        grams = [s.T @ (w[:, None] * s) for s, w in zip((along, across), weights, strict=True)]
        for part in _parallel(*comm.allreduce(np.stack(grams))).T:
            body, along_words, speed = bodies.fastest(group, base @ part)
            reach = speed * reach_of(comm, along @ part, points.sizes(slips), SEEN)
            if SMALL_PLAY * solution.measures.displacements[body] < reach < np.inf:
                yield (
                    f"{bodies.names[body]} slides wherever friction acts on it, and the "
                    "forces stay as they are if it is carried along by up to "
                    f"{reach:.3g} less or more, along {along_words}: the answer has one of "
                    "these positions; a displacement condition or unlike coefficients of friction "
                    "of its two sides determine it"
                )


def _split(points: FrictionPoints, multiplier: Array, rows: Array) -> tuple[Array, Array]:
    """Slips of points along their friction forces, (points, n), and across them, (k, n).

    Parameters
    ----------
    rows : (k, n)
        Tangential rows applied to n motions.
    """
    forces = points.forces(multiplier)
    sizes = points.sizes(forces)[points.point]
    direction = np.divide(forces, sizes, out=np.zeros_like(forces), where=sizes > 0.0)
    along = np.zeros((len(points.first), rows.shape[1]))
    np.add.at(along, points.point, direction[:, None] * rows)
    return along, rows - direction[:, None] * along[points.point]


def _parallel(along: Array, across: Array) -> Array:
    """Combinations (n, j) of motions that are parallel to the friction forces, by Gram matrices."""
    values, vectors = np.linalg.eigh(along + across)
    moving = values > RESOLVED * values.max(initial=0.0)
    basis = vectors[:, moving] / np.sqrt(values[moving])
    values, vectors = np.linalg.eigh(basis.T @ across @ basis)
    return np.asarray(basis @ vectors[:, values < PARALLEL])
