"""A cost model of subdomains, and the choices that follow from it.

Seconds on one machine of two cores, fitted to some seventy runs of the shipped scenes and of cubes
of 10³ to 60³ hexahedra, each in several decompositions; choices depend on their ratios only. A
subdomain whose reflections form a group of `order` elements is factored and applied in `order`
blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from solver.factors import factor_seconds

APPLICATIONS = 50
"""Expected applications of the dual operator in a solve; weighs them against set-up."""

BLOCK_LIMIT = 3e9
"""Largest dense block, in bytes."""

PRODUCT_RATE = 3.5e10
"""Speed of dense products, in floating-point operations per second."""

SPLIT_SECONDS = 8e-9
"""Seconds of the transform to the coordinates of the characters and back, per unknown."""

SPARSE_SECONDS = 2e-8
"""Seconds of the lumped preconditioner's product with a sparse matrix, per interface unknown."""

ROW_SECONDS = 4e-8
"""Seconds of products with B, projections and vector operations of an iteration, per row of B."""

CLASS_SECONDS = 1.3e-2
"""Seconds of mesh, forms and calls per class of any size; and per operator application:"""

CALL_SECONDS = 1.5e-4

ASSEMBLY_SECONDS = {2: 8e-7, 3: 3.8e-6}
"""Seconds of assembly per unknown of a class, by dimension."""

UNKNOWN_SECONDS = 3e-7
"""Seconds of numbering, conditions and loads, per unknown of all subdomains; per subdomain:"""

SUBDOMAIN_SECONDS = 1.2e-4

COARSE_ROW_SECONDS = 1.7e-6
"""Seconds of B, G and G Gᵀ per row of B."""

SETS = 5.0
"""Expected active sets of a solve, each with a coarse problem to factor."""

SET_SECONDS = {2: 5e-4, 3: 5e-3}
"""Seconds of the calls of an active set, by dimension."""


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
    subdomains = sum(g.members for g in groups)
    dimension = groups[0].dimension
    setup, application = 0.005 + SUBDOMAIN_SECONDS * subdomains, ROW_SECONDS * rows
    for g in groups:
        setup += CLASS_SECONDS + (ASSEMBLY_SECONDS[g.dimension] + 1e-5) * g.unknowns
        setup += UNKNOWN_SECONDS * g.unknowns * g.members
        setup += factor_seconds(g.unknowns, g.order, g.dimension)
        preconditioning = SPARSE_SECONDS * g.interface
        if g.has_block:
            setup += build_seconds(g.unknowns, g.interface, g.order, g.dimension)
            apply = preconditioning = apply_seconds(g.interface, g.order)
        else:
            apply = solve_seconds(g.unknowns, g.order, g.dimension)
        application += g.members * (apply + glued * preconditioning)
        application += CALL_SECONDS
        setup += 2.0 * g.members * solve_seconds(g.unknowns, g.order, g.dimension)
    if glued:
        setup += COARSE_ROW_SECONDS * rows
        setup += SETS * (SET_SECONDS[dimension] + coarse_factor_seconds(subdomains, dimension))
        application += 2.0 * coarse_seconds(subdomains)
    return setup + applications * application


def solve_seconds(unknowns: float, order: int = 1, dimension: int = 3) -> float:
    """Seconds of one right-hand side with the sparse factors."""
    if dimension == 2:
        return 6e-8 * unknowns
    return order * 1.2e-8 * (unknowns / order) ** (4.0 / 3.0)


def apply_seconds(interface: int, order: int) -> float:
    """Seconds of a dense block of K⁺ on the interface of one member."""
    split = SPLIT_SECONDS * interface if order > 1 else 0.0
    return 2.0 * interface**2 / order / PRODUCT_RATE + split


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
    if not 0.0 < 8.0 * interface**2 / order <= BLOCK_LIMIT:
        return False
    block = APPLICATIONS * members * apply_seconds(interface, order)
    block += build_seconds(unknowns, interface, order, dimension)
    return block < APPLICATIONS * members * solve_seconds(unknowns, order, dimension)
