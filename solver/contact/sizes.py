"""The numbers of an answer for its certificate, and the reference of errors in energy norm."""

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
"""a(u, u) over what rounding makes of it, below which strains are rounding errors: a hundredth of
them, squared."""

UNSTRAINED = 1e-20
"""a(u, u) over what loads make at their unknowns alone, below which strains are rounding errors of
forces that cancel: these have ten digits."""

FORCED = 1e3
"""Forces on a group over rounding errors, beyond which they are forces."""

IDLE = 1e-3
"""Load of a body over that of its group below which the error of its stresses is measured as if it
carried so much: what hardly carries anything need not be right to as many digits."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The residual of equilibrium K u - f + Bᵀ λ and its parts.

    Attributes
    ----------
    imbalance : (bodies,)
        2-norm of the residual over the free unknowns of each body.
    reactions : (bodies,)
        Σ |r_i| over the eliminated unknowns: what holds them.
    disturbances : (bodies,)
        Σ r_i² / K_ii, the squared energy norm of an error that leaves a residual r of no pattern.
    strains : (bodies,)
        a(u, u), in which rigid motions, however large, leave no rounding errors.
    energy
        ½ a(u,u) - l(u).
    """

    imbalance: NDArray[np.float64]
    reactions: NDArray[np.float64]
    disturbances: NDArray[np.float64]
    strains: NDArray[np.float64]
    energy: float


class MeasuredProblem(Protocol):
    """A problem as the certificate uses it; arrays are (rows,), local parts, or (bodies,)."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""

    @property
    def bodies(self) -> Bodies:
        """To which body each row belongs."""

    @property
    def inequality(self) -> NDArray[np.bool_]:
        """Rows with one-sided multipliers, (rows,)."""

    @property
    def conditional(self) -> NDArray[np.bool_]:
        """Rows that need not hold: contact rows and tangential ones, (rows,)."""

    @property
    def spread(self) -> Array:
        """Force over multiplier, and distance over residual by its inverse, (rows,)."""

    @property
    def friction(self) -> FrictionPoints | None:
        """Contact points with friction."""

    @property
    def free_lengths(self) -> Array:
        """Largest displacement without constraint forces, (bodies,)."""

    @property
    def free_strains(self) -> Array:
        """a(u, u) without constraint forces, (bodies,)."""

    def strains_at_unknowns(self) -> Array:
        """a(u, u) that loads make at their unknowns alone, (bodies,)."""


class MeasuredAnswer(Protocol):
    """An answer of a backend and how large it is in each body; using it is collective."""

    @property
    def problem(self) -> MeasuredProblem:
        """The problem that it answers."""

    @property
    def multiplier(self) -> Array:
        """λ, (rows,)."""

    @property
    def residual(self) -> Array:
        """B u - c, (rows,)."""

    def equilibrium(self) -> Equilibrium:
        """The residual of equilibrium K u - f + Bᵀ λ and its parts."""

    def round_off(self) -> tuple[Array, Array]:
        """The effect of rounding errors of u, (bodies,): ‖K δu‖ and δuᵀ K δu."""

    def largest_displacements(self) -> Array:
        """Largest |u| over the nodes of each body, (bodies,); zero for rigid bodies."""

    def largest_deformations(self) -> Array:
        """The same without the rigid motions that nothing resists, (bodies,)."""

    def forces_on_bodies(self, force: Array, reactions: Array) -> Array:
        """Sums of the magnitudes of loads, of reactions and ties, and of contact forces.

        (3, bodies).

        Parameters
        ----------
        force : (rows,)
            Contact and friction forces, zero on other rows.
        reactions : (bodies,)
            At eliminated unknowns.
        """

    def gaps(self, relaxations: int) -> Array:
        """The duality gap of each group of bodies, (groups,), after steps that sharpen it."""


def energy_scales(
    problem: MeasuredProblem,
    strains: NDArray[np.float64],
    roundings: NDArray[np.float64],
    forces: NDArray[np.float64],
    rounded: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The reference of squared errors in energy norm in each body, (bodies,).

    Its strains, a(u, u). A body that carries next to nothing is measured as if it carried `IDLE` of
    what its group does, and none by more than its group.

    Where nothing but rounding errors, of displacements or of forces, strains a group, a(u, u) tells
    nothing. If forces act on it all the same, far above those rounding makes, as loads on the face
    that an obstacle holds, it is measured by what the loads would do without constraints. If none
    act, contact forces that rounding makes apart, it is merely moved and has no error: zero. Else
    its strains are digits that are not there, and it fails by them.

    Parameters
    ----------
    forces : (3, bodies)
        Loads, reactions and contact forces.
    rounded : (bodies,)
        Force that rounding makes.
    """
    bodies, groups = problem.bodies, problem.bodies.groups
    load = forces.max(axis=0)
    whole = bodies.sum_by_group(strains)[groups]
    floor = STRAINLESS * roundings + UNSTRAINED * problem.strains_at_unknowns()
    still = whole <= bodies.sum_by_group(floor)[groups]
    if still.any():
        free = bodies.sum_by_group(problem.free_strains)[groups]
        loaded, given, pressed, noise = (
            bodies.sum_by_group(v)[groups] for v in (load, forces[0], forces[2], rounded)
        )
        acting = np.where(pressed > noise, given + pressed, given)
        strong = (loaded > FORCED * noise) & (free > 0.0)
        resting = np.where(strong, free, np.where(acting > 0.0, whole, 0.0))
        whole = np.where(still, resting, whole)
    carried = bodies.by_group(load)[groups]
    share = np.divide(IDLE * carried, load, out=np.full(len(load), np.inf), where=load > 0.0)
    own = np.where(strains > floor, strains, np.inf)
    return np.asarray(np.minimum(own * np.maximum(1.0, share) ** 2, whole))
