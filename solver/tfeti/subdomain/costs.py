"""A cost model of subdomains, and the choices that follow from it.

Seconds on one machine of two cores, fitted to some seventy runs of the shipped scenes and of cubes
of 10³ to 60³ hexahedra, each in several decompositions; choices depend on their ratios only. A
subdomain whose reflections form a group of `order` elements is factored and applied in `order`
blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from solver.factors import factor_seconds


@dataclass(frozen=True)
class Costs:
    """The coefficients of the model."""

    applications: int = 50
    """Expected applications of the dual operator in a solve; weighs them against set-up."""
    largest_block: float = 3e9
    """Largest dense block, in bytes."""
    product_rate: float = 3.5e10
    """Speed of dense products, in floating-point operations per second."""
    split: float = 8e-9
    """Seconds of the transform to the coordinates of the characters and back, per unknown."""
    sparse_product: float = 2e-8
    """Seconds of the lumped preconditioner's product with a sparse matrix, per interface
    unknown."""
    row: float = 4e-8
    """Seconds of products with B, projections and vector operations of an iteration, per row of
    B."""
    of_class: float = 1.3e-2
    call: float = 1.5e-4
    """Seconds of mesh, forms and calls per class of any size; and per operator application."""
    assembly: tuple[float, float] = (8e-7, 3.8e-6)
    """Seconds of assembly per unknown of a class, in the plane and in space."""
    unknown: float = 3e-7
    subdomain: float = 1.2e-4
    """Seconds of numbering, conditions and loads, per unknown of all subdomains; per subdomain."""
    coarse_row: float = 1.7e-6
    """Seconds of B, G and G Gᵀ per row of B."""
    sets: float = 5.0
    """Expected active sets of a solve, each with a coarse problem to factor."""
    active_set: tuple[float, float] = (5e-4, 5e-3)
    """Seconds of the calls of an active set, in the plane and in space."""


COSTS = Costs()


@dataclass(frozen=True)
class Group:
    """A group of equal subdomains."""

    dimension: int
    unknowns: int
    interface: int
    """Dimension, unknowns and interface unknowns of one member."""
    members: int
    """Number of subdomains."""
    order: int
    """Number of reflections, their products and the identity."""

    @property
    def has_block(self) -> bool:
        """Whether K⁺ on the interface is a dense block."""
        return block_pays(self.unknowns, self.interface, self.members, self.order, self.dimension)


def run_seconds(
    groups: Sequence[Group], rows: int, applications: float, glued: bool = True
) -> float:
    """Seconds of a run: set-up, assembly, factors and solve.

    Parameters
    ----------
    rows
        Number of rows of B.
    applications
        Number of applications of the dual operator.
    glued
        Whether there is a coarse problem.
    """
    costs, subdomains = COSTS, sum(g.members for g in groups)
    dimension = groups[0].dimension
    setup, application = 0.005 + costs.subdomain * subdomains, costs.row * rows
    for g in groups:
        setup += costs.of_class + (costs.assembly[g.dimension - 2] + 1e-5) * g.unknowns
        setup += costs.unknown * g.unknowns * g.members
        setup += factor_seconds(g.unknowns, g.order, g.dimension)
        preconditioning = costs.sparse_product * g.interface
        if g.has_block:
            setup += build_seconds(g.unknowns, g.interface, g.order, g.dimension)
            apply = preconditioning = apply_seconds(g.interface, g.order)
        else:
            apply = solve_seconds(g.unknowns, g.order, g.dimension)
        application += g.members * (apply + glued * preconditioning)
        application += costs.call
        setup += 2.0 * g.members * solve_seconds(g.unknowns, g.order, g.dimension)
    if glued:
        setup += costs.coarse_row * rows
        of_set = costs.active_set[dimension - 2] + coarse_factor_seconds(subdomains, dimension)
        setup += costs.sets * of_set
        application += 2.0 * coarse_seconds(subdomains)
    return setup + applications * application


def solve_seconds(unknowns: float, order: int = 1, dimension: int = 3) -> float:
    """Seconds of one right-hand side with the sparse factors."""
    if dimension == 2:
        return 6e-8 * unknowns
    return order * 1.2e-8 * (unknowns / order) ** (4.0 / 3.0)


def apply_seconds(interface: int, order: int) -> float:
    """Seconds of a dense block of K⁺ on the interface of one member."""
    split = COSTS.split * interface if order > 1 else 0.0
    return 2.0 * interface**2 / order / COSTS.product_rate + split


def build_seconds(unknowns: int, interface: int, order: int, dimension: int = 3) -> float:
    """Seconds to build the block from the factor of K.

    One solve per interface unknown, many at once.
    """
    return 0.35 * interface * solve_seconds(unknowns / order, 1, dimension)


def coarse_seconds(subdomains: int) -> float:
    """Seconds of one solve with G Gᵀ."""
    return 1.5e-7 * subdomains ** (4.0 / 3.0)


def coarse_factor_seconds(subdomains: int, dimension: int = 3) -> float:
    """Seconds of the factor of G Gᵀ."""
    if dimension == 2:
        return 5e-6 * subdomains**1.5
    return max(8e-6 * subdomains**1.17, 2e-8 * subdomains**2.0)


def block_pays(unknowns: int, interface: int, members: int, order: int, dimension: int = 3) -> bool:
    """Whether a dense block of K⁺ is cheaper in a whole run than solves with the sparse factors.

    It consists of `order` blocks, one for each character of the reflections.
    """
    if not 0.0 < 8.0 * interface**2 / order <= COSTS.largest_block:
        return False
    block = COSTS.applications * members * apply_seconds(interface, order)
    block += build_seconds(unknowns, interface, order, dimension)
    return block < COSTS.applications * members * solve_seconds(unknowns, order, dimension)
