"""Protocols of a measured problem and answer, and the reference of errors in energy norm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.contact.bodies import Bodies
from solver.contact.friction_points import FrictionPoints

Array = NDArray[np.float64]

STRAINLESS = 1e4
"""a(u, u) over its rounding error, below which strains count as rounding errors."""

UNSTRAINED = 1e-20
"""Strains with a smaller a(u, u) are rounding errors of forces that cancel.

Such forces have ten digits. Relative to the a(u, u) that the loads would cause if each unknown gave
way alone.
"""

FORCED = 1e3
"""Forces on a group over their rounding errors, above which they count as forces."""

RESOLVED = 0.1
"""Rounding errors of the forces on a heated body, over the largest residual that the certificate
allows, if its contact forces are far smaller than its thermal loads."""

ROUNDED_LIMIT = 1e-6
"""Largest residual of equilibrium, over the load, that is attributed to rounding errors."""

IDLE = 1e-3
"""Load of a body over the load of its group.

The error of a body that carries less is measured as if it carried this share: its stresses need not
be as accurate.
"""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The residual of equilibrium K u - f + Bᵀ λ and its parts.

    Attributes
    ----------
    imbalance : (bodies,)
        2-norm of the residual over the free unknowns of each body.
    reactions : (bodies,)
        Σ |r_i| over the eliminated unknowns: the reactions.
    disturbances : (bodies,)
        Σ r_i² / K_ii, the squared energy norm of an error that leaves a residual r of no pattern.
    strains : (bodies,)
        a(u, u), computed so that large rigid motions leave no rounding errors.
    energy
        ½ a(u,u) - l(u).
    """

    imbalance: NDArray[np.float64]
    reactions: NDArray[np.float64]
    disturbances: NDArray[np.float64]
    strains: NDArray[np.float64]
    energy: float


@dataclass(frozen=True, eq=False)
class BodyForces:
    """Forces on the bodies: sums of magnitudes, (bodies,) each.

    Attributes
    ----------
    loads
    held
        Reactions and tied forces.
    contact
        Contact and friction forces.
    rounded
        Rounding errors of the forces.
    """

    loads: Array
    held: Array
    contact: Array
    rounded: Array

    @property
    def largest(self) -> Array:
        """The largest of loads, held and contact forces of each body, (bodies,)."""
        return np.max([self.loads, self.held, self.contact], axis=0)


class MeasuredProblem(Protocol):
    """A problem as the certificate uses it; arrays are (rows,), local parts, or (bodies,)."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""

    @property
    def bodies(self) -> Bodies:
        """Body of each row."""

    @property
    def inequality(self) -> NDArray[np.bool_]:
        """Rows with one-sided multipliers, (rows,)."""

    @property
    def conditional(self) -> NDArray[np.bool_]:
        """Mask (rows,) of rows that may be inactive: contact rows and tangential rows."""

    @property
    def spread(self) -> Array:
        """Force over multiplier of each row, (rows,); its inverse is distance over residual."""

    @property
    def friction(self) -> FrictionPoints:
        """Contact points with friction."""

    @property
    def mechanical_loads(self) -> Array:
        """Σ |f| without thermal loads, (bodies,)."""

    @property
    def heated(self) -> NDArray[np.bool_]:
        """Bodies of groups with thermal loads, (bodies,)."""

    @property
    def free_lengths(self) -> Array:
        """Largest displacement without constraint forces, (bodies,)."""

    @property
    def free_strains(self) -> Array:
        """a(u, u) without constraint forces, (bodies,)."""

    def strains_at_unknowns(self) -> Array:
        """a(u, u) of the loads if each unknown gave way alone, (bodies,)."""


class MeasuredAnswer(Protocol):
    """An answer of a backend and its sizes in each body; all calls are collective."""

    @property
    def problem(self) -> MeasuredProblem:
        """The problem of this answer."""

    @property
    def multiplier(self) -> Array:
        """λ, (rows,)."""

    @property
    def residual(self) -> Array:
        """B u - c, (rows,)."""

    def equilibrium(self) -> Equilibrium:
        """The residual of equilibrium K u - f + Bᵀ λ and its parts."""

    def round_off(self) -> tuple[Array, Array]:
        """Effect of the rounding errors δu of u, (bodies,) each: ‖K δu‖ and δuᵀ K δu."""

    def largest_displacements(self) -> Array:
        """Largest |u| over the nodes of each body, (bodies,); zero for rigid bodies."""

    def largest_deformations(self) -> Array:
        """Largest |u| without the rigid motions that no row with a force resists, (bodies,)."""

    def forces_on_bodies(self, force: Array, reactions: Array, rounded: Array) -> BodyForces:
        """The forces on the bodies.

        Parameters
        ----------
        force : (rows,)
            Contact and friction forces, zero on other rows.
        reactions : (bodies,)
            At eliminated unknowns.
        rounded : (bodies,)
            Rounding errors of the forces.
        """

    def gaps(self) -> Array:
        """Duality gap of each group of bodies, (groups,)."""


def energy_scales(
    problem: MeasuredProblem, strains: Array, roundings: Array, forces: BodyForces
) -> Array:
    """The reference of squared errors in energy norm in each body, (bodies,).

    The reference is a(u, u) of the body. A body that carries nearly no load is measured as if it
    carried the share `IDLE` of the load of its group. No reference exceeds that of the group.

    If only rounding errors of displacements or forces strain a group, a(u, u) is meaningless. If
    the forces on the group are still far above rounding errors (for example loads on a face that an
    obstacle holds), the reference is the energy that the loads would cause without constraints. If
    no forces act but rounding errors of contact forces, the group moves rigidly and has no error:
    the reference is zero. Otherwise the strains have no correct digits, and the certificate of the
    group fails.

    Parameters
    ----------
    strains, roundings : (bodies,)
        a(u, u), and its rounding errors.
    """
    bodies, groups = problem.bodies, problem.bodies.groups
    load = forces.largest
    of_group = bodies.sum_by_group(strains)[groups]
    floor = STRAINLESS * roundings + UNSTRAINED * problem.strains_at_unknowns()
    unstrained = of_group <= bodies.sum_by_group(floor)[groups]
    if unstrained.any():
        free = bodies.sum_by_group(problem.free_strains)[groups]
        loaded, loads, pressed, noise = (
            bodies.sum_by_group(v)[groups]
            for v in (load, forces.loads, forces.contact, forces.rounded)
        )
        acting = np.where(pressed > noise, loads + pressed, loads)
        strong = (loaded > FORCED * noise) & (free > 0.0)
        resting = np.where(strong, free, np.where(acting > 0.0, of_group, 0.0))
        of_group = np.where(unstrained, resting, of_group)
    carried = bodies.by_group(load)[groups]
    share = np.divide(IDLE * carried, load, out=np.full(len(load), np.inf), where=load > 0.0)
    strained = np.where(strains > floor, strains, np.inf)
    return np.asarray(np.minimum(strained * np.maximum(1.0, share) ** 2, of_group))


def force_references(problem: MeasuredProblem, forces: BodyForces, tolerance: float) -> Array:
    """The references of forces, (bodies,): the largest of loads, reactions and contact forces.

    The contact forces of a body that carries nearly no load, such as an unloaded roller of a
    bearing, may have no correct digits. So the reference of a body is never so small that rounding
    errors exceed the tolerance, up to the share `IDLE` of the largest in its group.

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
    least = forces.rounded / min(RESOLVED * tolerance, ROUNDED_LIMIT)
    idle = np.minimum(least, IDLE * bodies.by_group(every)[bodies.groups])
    if not problem.heated.any():
        return np.maximum(every, idle)
    acting = np.maximum(problem.mechanical_loads, forces.contact)
    acting = np.where(acting > 0.0, acting, bodies.by_group(acting)[bodies.groups])
    used = problem.heated & (acting > 0.0)
    return np.where(used, np.minimum(np.maximum(acting, least), every), every)
