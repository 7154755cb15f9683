"""The sizes of an answer in each body, which are the references of the certificate.

Displacements, forces, energies and rounding errors are summed over the subdomains of each body
(`solver.contact.certificate`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from solver.contact.bodies import MOTIONLESS, largest
from solver.contact.certificate import ROUNDED_LIMIT
from solver.contact.row_kinds import RowKind
from solver.problem.decomposed import DecomposedProblem
from solver.problem.free_motions import FreeMotions
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class ReferenceLimits:
    """The sizes above which strains, forces and motions are more than rounding errors."""

    strainless: float = 1e4
    """a(u, u) over its rounding error, below which strains count as rounding errors."""
    unstrained: float = 1e-20
    """Strains with a smaller a(u, u) are rounding errors of forces that cancel. Such forces have
    ten digits. Relative to the a(u, u) that the loads would cause if each unknown gave way
    alone."""
    forced: float = 1e3
    """Forces on a group over their rounding errors, above which they count as forces."""
    resolved: float = 0.1
    """Rounding errors of the forces on a heated body, over the largest residual that the
    certificate allows, if its contact forces are far smaller than its thermal loads."""
    idle: float = 1e-3
    """Load of a body over the load of its group. The error of a body that carries less is measured
    as if it carried this share: its stresses need not be as accurate."""
    pressing: float = 1e-6
    """Force of a row over the largest on its bodies, below which it does not resist a motion."""
    slid: float = 1e-4
    """Smallest reference of lengths of a body that slid, over its displacement: large slides leave
    jumps of 1e-13 of them by rounding, which a tolerance of 1e-8 must allow."""
    rounded: float = 4.0
    """Rounding errors of displacements, in units of ε max|u|, that count for the forces."""


SIZES = ReferenceLimits()


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The residual of equilibrium K u - f + Bᵀ λ and its parts."""

    imbalance: Array  # (bodies,)
    """2-norm of the residual over the free unknowns of each body."""
    reactions: Array  # (bodies,)
    """Σ |r_i| over the eliminated unknowns: the reactions."""
    disturbances: Array  # (bodies,)
    """Σ r_i² / K_ii, the squared energy norm of an error that leaves a residual r of no pattern."""
    strains: Array  # (bodies,)
    """a(u, u), computed so that large rigid motions leave no rounding errors."""
    energy: float
    """½ a(u,u) - l(u)."""


@dataclass(frozen=True, eq=False)
class BodyForces:
    """Forces on the bodies: sums of magnitudes, (bodies,) each."""

    loads: Array
    held: Array
    """Reactions and tied forces."""
    contact: Array
    """Contact and friction forces."""
    rounded: Array
    """Rounding errors of the forces."""

    @property
    def largest(self) -> Array:
        """The largest of loads, held and contact forces of each body, (bodies,)."""
        return np.max([self.loads, self.held, self.contact], axis=0)


@dataclass(frozen=True, eq=False)
class MeasuredAnswer:
    """An answer and its sizes in each body; all methods are collective."""

    problem: DecomposedProblem
    multiplier: Array  # (dual,)
    """λ, local part."""
    displacements: list[Array]  # one (n, members) array per class
    """Displacements u."""

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
            problem.slices,
            self.displacements,
            problem.forces,
            bodies.members,
            strict=True,
        ):
            force = forces[part].reshape(cls.members, -1)
            flexibility = 1.0 / cls.resistance
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
                Ku *= Ku
                each = Ku.sum(axis=0), reactions, flexibility @ Ku, strains
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
            stiff = 0.0 if cls.rigid else float(cls.resistance[cls.free].sum())
            size, free = np.maximum(u.max(axis=0), -u.min(axis=0)), problem.free_lengths[body]
            moved = np.where(size > MOTIONLESS * free, size, free)
            errors = SIZES.rounded * unit * moved
            squares = float(np.sum(cls.row_sums[cls.free] ** 2)) * errors**2
            size = np.maximum(size, free)
            parts.append(np.stack([squares, stiff * (unit * size) ** 2]))
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
        problem, free = self.problem, self.problem.free_motions
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
        return np.maximum(_largest_displacements(problem, left), SIZES.slid * displaced)

    def errors_of_held(self) -> Array:
        """Largest error of a prescribed displacement that is eliminated, (bodies,)."""
        problem, result = self.problem, np.zeros(self.problem.bodies.count)
        for cls, u, lifting, body in zip(
            problem.classes,
            self.displacements,
            problem.lifting,
            problem.bodies.members,
            strict=True,
        ):
            held = np.setdiff1d(np.arange(cls.unknowns), cls.free)
            errors = np.abs(u[held] - lifting[held]).max(axis=0, initial=0.0)
            np.maximum.at(result, body, errors)
        return largest(problem.comm, result)


def summed_forces(problem: DecomposedProblem, multiplier: Array, force: Array) -> Array:
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


def rows_that_resist(problem: DecomposedProblem, multiplier: Array) -> Mask:
    """Mask (dual,) of the contact and tangential rows with a force (collective)."""
    bodies, force = problem.bodies, np.where(problem.conditional, np.abs(multiplier), 0.0)
    force = force * problem.spread
    most = np.zeros(bodies.count)
    for side in bodies.rows.T:
        np.maximum.at(most, side, force)
    most = largest(problem.comm, most)
    return np.asarray(force > SIZES.pressing * most[bodies.rows].min(axis=1))


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


def energy_scales(
    problem: DecomposedProblem, strains: Array, roundings: Array, forces: BodyForces
) -> Array:
    """The reference of squared errors in energy norm in each body, (bodies,).

    The reference is a(u, u) of the body. A body that carries nearly no load is measured as if it
    carried the share `ReferenceLimits.idle` of the load of its group. No reference exceeds that of
    the group.

    If only rounding errors of displacements or forces strain a group, a(u, u) is meaningless. If
    the forces on the group are still far above rounding errors (for example loads on a face that an
    obstacle holds), the reference is the energy that the loads would cause without constraints. If
    no forces act but rounding errors of contact forces, or loads on held unknowns alone, the group
    moves rigidly and has no error: the reference is zero. Otherwise the strains have no correct
    digits, and the certificate of the group fails.

    Parameters
    ----------
    strains, roundings : (bodies,)
        a(u, u), and its rounding errors.
    """
    bodies, groups = problem.bodies, problem.bodies.groups
    load = forces.largest
    of_group = bodies.sum_by_group(strains)[groups]
    floor = SIZES.strainless * roundings + SIZES.unstrained * problem.strains_at_unknowns()
    unstrained = of_group <= bodies.sum_by_group(floor)[groups]
    if unstrained.any():
        free = bodies.sum_by_group(problem.free_strains)[groups]
        loaded, loads, pressed, noise = (
            bodies.sum_by_group(v)[groups]
            for v in (load, forces.loads, forces.contact, forces.rounded)
        )
        acting = np.where(free > 0.0, loads, 0.0)
        acting = np.where(pressed > noise, acting + pressed, acting)
        strong = (loaded > SIZES.forced * noise) & (free > 0.0)
        resting = np.where(strong, free, np.where(acting > 0.0, of_group, 0.0))
        of_group = np.where(unstrained, resting, of_group)
    carried = bodies.by_group(load)[groups]
    share = np.divide(SIZES.idle * carried, load, out=np.full(len(load), np.inf), where=load > 0.0)
    strained = np.where(strains > floor, strains, np.inf)
    return np.asarray(np.minimum(strained * np.maximum(1.0, share) ** 2, of_group))


def force_references(problem: DecomposedProblem, forces: BodyForces, tolerance: float) -> Array:
    """The references of forces, (bodies,): the largest of loads, reactions and contact forces.

    The contact forces of a body that carries nearly no load, such as an unloaded roller of a
    bearing, may have no correct digits. So the reference of a body is never so small that rounding
    errors exceed the tolerance, up to the share `ReferenceLimits.idle` of the largest in its group.

    In groups with heat, only contact forces and mechanical loads count. Thermal loads balance
    themselves and cause reactions and tied forces that do so, too, all often far larger than the
    contact forces. A body on which neither acts is measured by the largest of its group, and
    rounding errors raise the references without that limit.

    Parameters
    ----------
    tolerance
        Upper limit of the certificate's numbers.
    """
    bodies, every = problem.bodies, forces.largest
    least = forces.rounded / min(SIZES.resolved * tolerance, ROUNDED_LIMIT)
    idle = np.minimum(least, SIZES.idle * bodies.by_group(every)[bodies.groups])
    if not problem.heated.any():
        return np.maximum(every, idle)
    acting = np.maximum(problem.mechanical_loads, forces.contact)
    acting = np.where(acting > 0.0, acting, bodies.by_group(acting)[bodies.groups])
    used = problem.heated & (acting > 0.0)
    return np.where(used, np.minimum(np.maximum(acting, least), every), every)
