"""The certificate of multipliers and displacements of a dual problem.

`DualAnswer` has the sizes of an answer in each body, the references of the certificate
(`solver.contact.certificate`): displacements, forces, energies and rounding errors, summed over
subdomains.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from solver.contact.bodies import MOTIONLESS, largest
from solver.contact.bodies import sizes as at_least
from solver.contact.certificate import Certificate, Measures, certificate_of, friction_numbers
from solver.contact.row_kinds import RowKind
from solver.contact.sizes import BodyForces, Equilibrium
from solver.tfeti.decomposed import DecomposedProblem
from solver.tfeti.dual_operator import interface_slices
from solver.tfeti.duality_gap import group_gaps
from solver.tfeti.free_motions import FreeMotions

Array = NDArray[np.float64]

PRESSING = 1e-6
"""Force of a row over the largest on its bodies, below which it does not resist a motion."""

SLID = 1e-4
"""Smallest reference of lengths of a body that slid, over its displacement: large slides leave
jumps of 1e-13 of them by rounding, which a tolerance of 1e-8 must allow."""

ROUNDED = 4.0
"""Rounding errors of displacements, in units of ε max|u|, that count for the forces."""


@dataclass(frozen=True, eq=False)
class DualAnswer:
    """An answer and its sizes in each body (protocol `solver.contact.sizes.MeasuredAnswer`).

    All methods are collective.

    Attributes
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array per class
        Displacements u.
    """

    problem: DecomposedProblem
    multiplier: Array
    displacements: list[Array]

    @cached_property
    def interface(self) -> Array:
        """u on the interface."""
        return self.problem.on_interface(self.displacements)

    @cached_property
    def residual(self) -> Array:
        """B u - c, (dual,)."""
        return self.problem.residual(self.interface)

    def equilibrium(self) -> Equilibrium:
        """The residual of equilibrium K u - f + Bᵀ λ and its parts."""
        problem, bodies = self.problem, self.problem.bodies
        forces = problem.constraint_forces(self.multiplier)
        sums, work = np.zeros((4, bodies.count)), 0.0
        for cls, part, u, load, body in zip(
            problem.classes,
            interface_slices(problem.classes),
            self.displacements,
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

    def round_off(self) -> tuple[Array, Array]:
        """Effect of the rounding errors δu of u, (bodies,) each: ‖K δu‖ and δuᵀ K δu.

        The first uses the sums of magnitudes in the rows of K, because loads of held unknowns are
        products with K, too (N. J. Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd
        ed., sec. 3.5). The second includes the rounding errors of the displacements without
        constraint forces, because the answer is a difference of such displacements.
        """
        problem, bodies = self.problem, self.problem.bodies
        unit = float(np.finfo(np.float64).eps)
        parts = []
        for cls, u, body in zip(problem.classes, self.displacements, bodies.members, strict=True):
            stiff = cls.stiffness.diagonal()[cls.free]
            size, free = np.maximum(u.max(axis=0), -u.min(axis=0)), problem.free_lengths[body]
            moved = np.where(size > MOTIONLESS * free, size, free)
            squares = float(np.sum(cls.row_sums[cls.free] ** 2)) * (ROUNDED * unit * moved) ** 2
            size = np.maximum(size, free)
            parts.append(np.stack([squares, float(stiff.sum()) * (unit * size) ** 2]))
        sums = np.array([bodies.sum_members([part[k] for part in parts]) for k in range(2)])
        squares, energies = problem.comm.allreduce(sums)
        return np.sqrt(squares), energies

    def largest_displacements(self) -> Array:
        """Largest |u| over the nodes of each body, (bodies,); zero for rigid bodies."""
        return _largest_displacements(self.problem, self.displacements)

    def largest_deformations(self) -> Array:
        """Largest |u| of each body without its free motions, (bodies,).

        These are motions that nothing resists, and those that no row with a force resists. Of a
        body that they move far, rounding errors are a share of its displacement: it has a small
        share of it at least.
        """
        problem, free = self.problem, self.problem.system.free
        if free is None:
            return self.largest_displacements()
        along = _unresisted(problem, free, self.multiplier)
        if not any(some.shape[1] for some in along):
            return self.largest_displacements()
        motions, left = free.of(self.displacements, along), []
        for number, (u, body) in enumerate(
            zip(self.displacements, problem.bodies.members, strict=True)
        ):
            deformed = u.copy(order="F")
            for member, b in enumerate(body):
                if motions[b].any():
                    deformed[:, member] -= free.field(number, member, motions[b])
            left.append(deformed)
        displaced = self.largest_displacements()
        return np.maximum(_largest_displacements(problem, left), SLID * displaced)

    def forces_on_bodies(self, force: Array, reactions: Array, rounded: Array) -> BodyForces:
        """The forces on the bodies (collective)."""
        loads, held, contact = _summed_forces(self.problem, self.multiplier, force)
        return BodyForces(loads, held + reactions, contact, rounded)

    def gaps(self) -> Array:
        """The duality gap of each group of bodies, (groups,)."""
        return group_gaps(self.problem, self.multiplier, self.interface)


def certify(
    problem: DecomposedProblem,
    multiplier: Array,
    displacements: list[Array],
    tolerance: float,
    unsolved: Array | None = None,
) -> tuple[Certificate, Measures]:
    """The certificate of an answer, as `certificate_of` computes it (collective).

    Parameters
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array per class
        Displacements u.
    """
    answer = DualAnswer(problem, multiplier, displacements)
    return certificate_of(answer, tolerance, unsolved)


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
    forces = _summed_forces(problem, multiplier, force)
    load = at_least(bodies, forces.max(axis=0))
    numbers = friction_numbers(problem, multiplier, jumps, load, lengths)
    return float(max(values.max() for values in numbers.values()))


def _summed_forces(problem: DecomposedProblem, multiplier: Array, force: Array) -> Array:
    """Sums of the magnitudes of loads, of forces that hold nodes, and of contact forces.

    (3, bodies), without reactions at eliminated unknowns (collective).

    Parameters
    ----------
    force : (dual,)
        Contact and friction forces, zero on other rows.
    """
    bodies = problem.bodies
    loads = bodies.sum_members([np.abs(f).sum(axis=0) for f in problem.forces])
    holding = (problem.kinds == RowKind.DIRICHLET) | problem.tied
    held = bodies.sum_rows(np.abs(multiplier * problem.spread), holding)
    touching = bodies.sum_rows(np.abs(force), problem.conditional)
    return np.asarray(problem.comm.allreduce(np.array([loads, held, touching])))


def _largest_displacements(problem: DecomposedProblem, displacements: list[Array]) -> Array:
    """Largest |u| over the nodes of each body, (bodies,) (collective); zero for rigid bodies."""
    result = np.zeros(problem.bodies.count)
    for cls, u, body in zip(problem.classes, displacements, problem.bodies.members, strict=True):
        for members in () if cls.rigid else cls.batches():
            some = u[:, members]
            squares = (some.reshape(-1, problem.dimension, some.shape[1]) ** 2).sum(axis=1)
            np.maximum.at(result, body[members], squares.max(axis=0))
    return np.sqrt(largest(problem.comm, result))


def rows_that_resist(problem: DecomposedProblem, multiplier: Array) -> NDArray[np.bool_]:
    """Mask (dual,) of the contact and tangential rows with a force (collective)."""
    bodies, force = problem.bodies, np.where(problem.conditional, np.abs(multiplier), 0.0)
    force = force * problem.spread
    most = np.zeros(bodies.count)
    for side in bodies.rows.T:
        np.maximum.at(most, side, force)
    most = largest(problem.comm, most)
    return np.asarray(force > PRESSING * most[bodies.rows].min(axis=1))


def rows_on_allowed_motions(problem: DecomposedProblem, free: FreeMotions, group: int) -> Array:
    """B applied to the allowed motions of a group, (dual, k) (collective)."""
    interfaces, moved = [cls.interface for cls in problem.classes], np.empty(problem.size)
    motions = free.allowed_motions(group, interfaces)
    images = np.empty((problem.size, motions.shape[1]))
    for column, motion in enumerate(motions.T):
        problem.B.apply(np.ascontiguousarray(motion), moved)
        images[:, column] = moved
    return images


def _unresisted(problem: DecomposedProblem, free: FreeMotions, multiplier: Array) -> list[Array]:
    """Motions that no row with a force resists, (motions, k) for each body (collective)."""
    bodies, resist = problem.bodies, rows_that_resist(problem, multiplier)
    result = list(free.loose.along)
    for group in range(bodies.group_count):
        images = rows_on_allowed_motions(problem, free, group)
        if not images.shape[1]:
            continue
        unresisted = free.unresisted(group, images[resist])
        for body, motions in zip(np.flatnonzero(bodies.groups == group), unresisted, strict=True):
            result[body] = motions
    return result
