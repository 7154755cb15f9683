"""The size of an answer in each body: displacements, forces, energies and rounding errors.

These are the references of the certificate (`solver.contact.certificate`), summed over subdomains.
All functions are collective and return one value per body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.contact.bodies import largest
from solver.contact.row_kinds import RowKind
from solver.contact.sizes import Equilibrium
from solver.tfeti.dual import DualProblem
from solver.tfeti.dual_operator import interface_slices
from solver.tfeti.free_motions import FreeMotions

PRESSING = 1e-6
"""Force of a row over the largest on its bodies, below which it does not resist a motion."""

SLID = 1e-4
"""Smallest reference of lengths of a body that slid, over its displacement: large slides leave
jumps of 1e-13 of them by rounding, which a tolerance of 1e-8 must allow."""

ROUNDED = 4.0
"""Rounding errors of displacements, in units of ε max|u|, that count for the forces."""


def equilibrium_of(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    displacements: list[NDArray[np.float64]],
) -> Equilibrium:
    """Residual and energies of each body (collective)."""
    bodies, forces = problem.bodies, problem.constraint_forces(multiplier)
    sums, work = np.zeros((4, bodies.count)), 0.0
    for cls, part, u, load, body in zip(
        problem.classes,
        interface_slices(problem.classes),
        displacements,
        problem.forces,
        bodies.members,
        strict=True,
    ):
        force = forces[part].reshape(cls.members, -1)
        stiff = cls.resistance[:, None]
        held = np.ones(cls.unknowns, bool)
        held[cls.free] = False
        for members in cls.batches():
            some = u[:, members]
            strained = some - cls.motions @ (cls.motions.T @ some)
            Ku = cls.stiffness @ strained
            work += float(np.vdot(some, load[:, members]))
            strains = np.einsum("im,im->m", strained, Ku)
            Ku -= load[:, members]
            Ku[cls.interface] += force[members].T
            reactions = np.abs(Ku[held]).sum(axis=0)
            Ku[held] = 0.0
            squares = np.einsum("im,im->m", Ku, Ku)
            each = squares, reactions, np.einsum("im,im->m", Ku, Ku / stiff), strains
            for row, values in zip(sums, each, strict=True):
                row += np.bincount(body[members], values, bodies.count)
    sums, work = problem.comm.allreduce(sums), problem.comm.allreduce(work)
    energy = 0.5 * float(sums[3].sum()) - work
    return Equilibrium(np.sqrt(sums[0]), sums[1], sums[2], np.maximum(sums[3], 0.0), energy)


def round_off(
    problem: DualProblem, displacements: list[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Effect of the rounding errors δu of u, (bodies,) each: ‖K δu‖ and δuᵀ K δu (collective).

    The first uses the sums of magnitudes in the rows of K, because loads of held unknowns are
    products with K, too (N. J. Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd ed.,
    sec. 3.5). The second includes the rounding errors of the displacements without constraint
    forces, because the answer is a difference of such displacements.
    """
    unit = float(np.finfo(np.float64).eps)
    parts = []
    for cls, u, body in zip(problem.classes, displacements, problem.bodies.members, strict=True):
        stiff = cls.stiffness.diagonal()[cls.free]
        size = np.maximum(u.max(axis=0), -u.min(axis=0))
        squares = float(np.sum(cls.row_sums[cls.free] ** 2)) * (ROUNDED * unit * size) ** 2
        size = np.maximum(size, problem.free_lengths[body])
        parts.append(np.stack([squares, float(stiff.sum()) * (unit * size) ** 2]))
    sums = np.array([problem.bodies.sum_members([part[k] for part in parts]) for k in range(2)])
    squares, energies = problem.comm.allreduce(sums)
    return np.sqrt(squares), energies


def largest_displacements(
    problem: DualProblem, displacements: list[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Largest |u| over the nodes of each body, (bodies,) (collective); zero for rigid bodies."""
    result = np.zeros(problem.bodies.count)
    for cls, u, body in zip(problem.classes, displacements, problem.bodies.members, strict=True):
        for members in () if cls.rigid else cls.batches():
            some = u[:, members]
            squares = (some.reshape(-1, problem.dimension, some.shape[1]) ** 2).sum(axis=1)
            np.maximum.at(result, body[members], squares.max(axis=0))
    return np.sqrt(largest(problem.comm, result))


def largest_deformations(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    displacements: list[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Largest |u| of each body without its free motions, (bodies,) (collective).

    These are motions that nothing resists, and those that no row with a force resists. Of a body
    that they move far, rounding errors are a share of its displacement: it has a small share of it
    at least.
    """
    free = problem.system.free
    if free is None:
        return largest_displacements(problem, displacements)
    along = unresisted(problem, free, multiplier)
    if not any(some.shape[1] for some in along):
        return largest_displacements(problem, displacements)
    motions, left = free.of(displacements, along), []
    for number, (u, body) in enumerate(zip(displacements, problem.bodies.members, strict=True)):
        own = u.copy(order="F")
        for member, b in enumerate(body):
            if motions[b].any():
                own[:, member] -= free.field(number, member, motions[b])
        left.append(own)
    displaced = largest_displacements(problem, displacements)
    return np.maximum(largest_displacements(problem, left), SLID * displaced)


def unresisted(
    problem: DualProblem, free: FreeMotions, multiplier: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Motions that no row with a force resists, (motions, k) for each body (collective)."""
    bodies, force = problem.bodies, np.where(problem.conditional, np.abs(multiplier), 0.0)
    force = force * problem.spread
    most = np.zeros(bodies.count)
    for side in bodies.rows.T:
        np.maximum.at(most, side, force)
    most = largest(problem.comm, most)
    presses = force > PRESSING * most[bodies.rows].min(axis=1)
    interfaces, moved = [cls.interface for cls in problem.classes], np.empty(problem.size)
    result = list(free.loose.along)
    for group in range(bodies.group_count):
        images = []
        for motion in free.allowed_motions(group, interfaces).T:
            problem.B.apply(np.ascontiguousarray(motion), moved)
            images.append(moved[presses])
        if not images:
            continue
        found = free.unresisted(group, np.column_stack(images))
        for body, motions in zip(np.flatnonzero(bodies.groups == group), found, strict=True):
            result[body] = motions
    return result


def forces_on_bodies(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    force: NDArray[np.float64],
    reactions: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Sums of the magnitudes of loads, of reactions and ties, and of contact forces of each body.

    (3, bodies) (collective).

    Parameters
    ----------
    force : (dual,)
        Contact and friction forces, zero on other rows.
    reactions : (bodies,)
        At eliminated unknowns.
    """
    bodies = problem.bodies
    given = bodies.sum_members([np.abs(f).sum(axis=0) for f in problem.forces])
    holding = (problem.kinds == RowKind.DIRICHLET) | problem.tied
    held = bodies.sum_rows(np.abs(multiplier * problem.spread), holding)
    touching = bodies.sum_rows(np.abs(force), problem.conditional)
    sums = np.asarray(problem.comm.allreduce(np.array([given, held, touching])))
    return sums + np.stack([np.zeros(bodies.count), reactions, np.zeros(bodies.count)])
