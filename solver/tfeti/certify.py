"""The certificate of multipliers and displacements of a dual problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from solver.contact.bodies import sizes as at_least
from solver.contact.certificate import Certificate, Measures, certificate_of, friction_numbers
from solver.contact.sizes import Equilibrium
from solver.tfeti import sizes
from solver.tfeti.dual import DualProblem
from solver.tfeti.duality_gap import group_gaps

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DualAnswer:
    """Data of an answer for the certificate (protocol `solver.contact.sizes.MeasuredAnswer`).

    Attributes
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array per class
        Displacements u.
    """

    problem: DualProblem
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
        return sizes.equilibrium_of(self.problem, self.multiplier, self.displacements)

    def round_off(self) -> tuple[Array, Array]:
        """Effect of the rounding errors δu of u, (bodies,) each: ‖K δu‖ and δuᵀ K δu."""
        return sizes.round_off(self.problem, self.displacements)

    def largest_displacements(self) -> Array:
        """Largest |u| over the nodes of each body, (bodies,)."""
        return sizes.largest_displacements(self.problem, self.displacements)

    def largest_deformations(self) -> Array:
        """Largest |u| without the rigid motions that no row with a force resists, (bodies,)."""
        return sizes.largest_deformations(self.problem, self.multiplier, self.displacements)

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
    displacements : one (n, members) array per class
        Displacements u.
    """
    answer = DualAnswer(problem, multiplier, displacements)
    return certificate_of(answer, tolerance, relaxations, unsolved)


def friction_residual(
    problem: DualProblem, multiplier: Array, jumps: Array, lengths: Array
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
    if problem.friction is None:
        return 0.0
    force = np.where(problem.conditional, multiplier * problem.spread, 0.0)
    forces = sizes.forces_on_bodies(problem, multiplier, force, np.zeros(bodies.count))
    load = at_least(bodies, forces.max(axis=0))
    numbers = friction_numbers(problem, multiplier, jumps, load, lengths)
    return float(max(values.max() for values in numbers.values()))
