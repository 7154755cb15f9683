"""The certificate of multipliers and displacements of a dual problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.contact.bodies import Bodies
from solver.contact.certificate import Certificate, Measures, certificate_of
from solver.contact.friction_points import FrictionPoints
from solver.contact.sizes import Equilibrium
from solver.tfeti import sizes
from solver.tfeti.dual import DualProblem
from solver.tfeti.duality_gap import group_gaps

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DualAnswer:
    """What the certificate asks of an answer (`solver.contact.sizes.MeasuredAnswer`).

    Attributes
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array a class
        u.
    """

    problem: DualProblem
    multiplier: Array
    displacements: list[Array]

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.problem.comm

    @property
    def bodies(self) -> Bodies:
        """To which body each row belongs."""
        return self.problem.bodies

    @property
    def contact_rows(self) -> NDArray[np.bool_]:
        """Rows with one-sided multipliers, (dual,)."""
        return self.problem.inequality

    @property
    def conditional(self) -> NDArray[np.bool_]:
        """Contact rows and tangential ones, (dual,)."""
        return self.problem.conditional

    @property
    def spread(self) -> Array:
        """Force over multiplier, (dual,)."""
        return self.problem.spread

    @property
    def friction(self) -> FrictionPoints | None:
        """Contact points with friction."""
        return self.problem.friction

    @property
    def free_lengths(self) -> Array:
        """Largest displacement without constraint forces, (bodies,)."""
        return self.problem.free_lengths

    @property
    def free_strains(self) -> Array:
        """a(u, u) without constraint forces, (bodies,)."""
        return self.problem.free_strains

    @cached_property
    def interface(self) -> Array:
        """u on the interface."""
        return self.problem.on_interface(self.displacements)

    @cached_property
    def residual(self) -> Array:
        """B u - c, (dual,)."""
        return self.problem.residual(self.interface)

    def strains_at_unknowns(self) -> Array:
        """a(u, u) that loads make at their unknowns alone, (bodies,)."""
        return self.problem.strains_at_unknowns()

    def equilibrium(self) -> Equilibrium:
        """What K u - f + Bᵀ λ comes to."""
        return sizes.equilibrium_of(self.problem, self.multiplier, self.displacements)

    def round_off(self) -> tuple[Array, Array]:
        """What rounding errors of u do, (bodies,): ‖K δu‖ and δuᵀ K δu."""
        return sizes.round_off(self.problem, self.displacements)

    def largest_displacements(self) -> Array:
        """Largest |u| over the nodes of each body, (bodies,)."""
        return sizes.largest_displacements(self.problem, self.displacements)

    def largest_deformations(self) -> Array:
        """The same without the rigid motions that nothing resists, (bodies,)."""
        return sizes.largest_deformations(self.problem, self.displacements)

    def forces_on_bodies(self, force: Array, reactions: Array) -> Array:
        """Magnitudes of loads, of reactions and ties, and of contact forces, (3, bodies)."""
        return sizes.forces_on_bodies(self.problem, self.multiplier, force, reactions)

    def gaps(self, relaxations: int) -> Array:
        """The duality gap of each group of bodies, (groups,)."""
        return group_gaps(self.problem, self.multiplier, self.interface, relaxations)


def certify(
    problem: DualProblem,
    multiplier: Array,
    displacements: list[Array],
    tolerance: float,
    relaxations: int = 0,
    unsolved: Array | None = None,
) -> tuple[Certificate, Measures]:
    """The certificate of an answer, as `certificate_of` computes it (collective).

    Parameters
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array a class
        u.
    """
    answer = DualAnswer(problem, multiplier, displacements)
    return certificate_of(answer, tolerance, relaxations, unsolved)
