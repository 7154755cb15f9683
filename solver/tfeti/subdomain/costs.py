"""The time that subdomains cost, and the choices that follow: how they are made and applied.

Seconds on one machine of two cores, fitted to some seventy runs of the shipped scenes and of cubes
of 10³ to 60³ hexahedra, each in several decompositions; choices depend on their ratios only. A
subdomain whose reflections form a group of `order` elements is factored and applied in as many
blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

APPLICATIONS = 50
"""Applications of the dual operator a solve is expected to need; weighs what is done once."""

BLOCK_LIMIT = 3e9
"""Largest dense block, in bytes."""

PRODUCT_RATE = 3.5e10
"""Dense products, in floating-point operations a second."""

SINGLE = 0.65
"""Time of a product in single precision, which a preconditioner takes, over one in double."""

SPLIT_SECONDS = 8e-9
"""Change to the coordinates of the characters and back, for each unknown."""

SPARSE_SECONDS = 2e-8
"""The lumped preconditioner's product with a sparse matrix, for each interface unknown."""

ROW_SECONDS = 4e-8
"""Products with B, projections and vector work of an iteration, for each row of B."""

CLASS_SECONDS = 1.3e-2
"""Mesh, forms and calls for a class, whatever its size; and for each operator application:"""

CALL_SECONDS = 1.5e-4

ASSEMBLY_SECONDS = {2: 8e-7, 3: 3.8e-6}
"""Assembly, for each unknown of a class, by dimension."""

UNKNOWN_SECONDS = 3e-7
"""Numbering, conditions and loads, for each unknown of the whole; for each subdomain:"""

SUBDOMAIN_SECONDS = 1.2e-4

COARSE_ROW_SECONDS = 1.7e-6
"""B, G and G Gᵀ, for each row of B."""

SETS = 5.0
"""Active sets of a solve, each with a coarse problem to factor."""

SET_SECONDS = {2: 5e-4, 3: 5e-3}
"""Calls of an active set, by dimension."""


class BlockKind(Enum):
    """How a class applies K⁺ on its interface."""

    NONE = "sparse solves"
    DENSE = "one dense block"
    SPLIT = "a dense block for each character of the reflections"


@dataclass(frozen=True)
class Group:
    """Subdomains that are alike.

    Attributes
    ----------
    dimension, unknowns, interface
        Of one member; unknowns of the interface.
    members
        How many there are.
    order
        Reflections, their products and the identity.
    """

    dimension: int
    unknowns: int
    interface: int
    members: int
    order: int

    @property
    def kind(self) -> BlockKind:
        """How K⁺ is applied."""
        return choose_block(self.unknowns, self.interface, self.members, self.order, self.dimension)


def run_seconds(
    groups: Sequence[Group], rows: int, applications: float, glued: bool = True
) -> float:
    """Set-up, assembly, factors and solve.

    Parameters
    ----------
    rows
        Of B.
    applications
        Of the dual operator.
    glued
        Whether there is a coarse problem.
    """
    subdomains = sum(g.members for g in groups)
    dimension = groups[0].dimension
    once, each = 0.005 + SUBDOMAIN_SECONDS * subdomains, ROW_SECONDS * rows
    for g in groups:
        kind = g.kind
        once += CLASS_SECONDS + (ASSEMBLY_SECONDS[g.dimension] + 1e-5) * g.unknowns
        once += UNKNOWN_SECONDS * g.unknowns * g.members
        once += factor_seconds(g.unknowns, g.order, g.dimension)
        once += build_seconds(kind, g.unknowns, g.interface, g.order, g.dimension)
        apply = apply_seconds(kind, g.unknowns, g.interface, g.order, g.dimension)
        each += g.members * apply
        if glued:
            relaxed = kind is not BlockKind.NONE
            each += g.members * (SINGLE * apply if relaxed else SPARSE_SECONDS * g.interface)
        each += CALL_SECONDS
        once += 2.0 * g.members * solve_seconds(g.unknowns, g.order, g.dimension)
    if glued:
        once += COARSE_ROW_SECONDS * rows
        once += SETS * (SET_SECONDS[dimension] + coarse_factor_seconds(subdomains, dimension))
        each += 2.0 * coarse_seconds(subdomains)
    return once + applications * each


def factor_seconds(unknowns: float, order: int, dimension: int = 3) -> float:
    """Sparse factors of a body of so many unknowns."""
    if dimension == 2:
        return 3.5e-6 * unknowns
    return order * 1e-9 * (unknowns / order) ** 2


def solve_seconds(unknowns: float, order: int = 1, dimension: int = 3) -> float:
    """One right-hand side through the sparse factors."""
    if dimension == 2:
        return 6e-8 * unknowns
    return order * 1.2e-8 * (unknowns / order) ** (4.0 / 3.0)


def apply_seconds(
    kind: BlockKind, unknowns: int, interface: int, order: int, dimension: int = 3
) -> float:
    """K⁺ on the interface of one member."""
    if kind is BlockKind.NONE:
        return solve_seconds(unknowns, order, dimension)
    if kind is BlockKind.DENSE:
        return 2.0 * interface**2 / PRODUCT_RATE
    return 2.0 * interface**2 / order / PRODUCT_RATE + SPLIT_SECONDS * interface


def build_seconds(
    kind: BlockKind, unknowns: int, interface: int, order: int, dimension: int = 3
) -> float:
    """The block, once K is factored: a solve for each interface unknown, many at once."""
    if kind is BlockKind.NONE:
        return 0.0
    solves = 0.35 * interface * solve_seconds(unknowns / order, 1, dimension)
    if kind is BlockKind.DENSE and order > 1:  # put together from the blocks of the characters
        solves += interface * apply_seconds(BlockKind.SPLIT, unknowns, interface, order)
    return solves


def relaxing_pays(interface: int, members: int, order: int) -> bool:
    """Whether a preconditioner of Schur complements beats one of plain stiffnesses.

    It costs an inverse of the block and as much as the block to apply, and saves iterations: the
    more, the more cells a subdomain has along an edge.
    """
    kind = BlockKind.SPLIT if order > 1 else BlockKind.DENSE
    block = apply_seconds(kind, 0, interface, order)
    rest = ROW_SECONDS * interface / 2.0
    inverse = order * (interface / order) ** 3 / PRODUCT_RATE
    lumped = APPLICATIONS * members * (block + SPARSE_SECONDS * interface + rest)
    both = (1.0 + SINGLE) * block + rest
    relaxed = APPLICATIONS * members * both * relaxed_share(interface)
    return inverse + relaxed < lumped


def relaxed_share(interface: int) -> float:
    """Iterations with the Schur complement over those with the plain stiffness."""
    edge = (interface / 18.0) ** 0.5  # cells along an edge of a box in space
    return min(1.0, (edge / 5.0) ** -0.35)


def coarse_seconds(subdomains: int) -> float:
    """One solve with G Gᵀ."""
    return 1.5e-7 * subdomains ** (4.0 / 3.0)


def coarse_factor_seconds(subdomains: int, dimension: int = 3) -> float:
    """The factor of G Gᵀ."""
    if dimension == 2:
        return 5e-6 * subdomains**1.5
    return max(8e-6 * subdomains**1.17, 2e-8 * subdomains**2.0)


def choose_block(
    unknowns: int, interface: int, members: int, order: int, dimension: int = 3
) -> BlockKind:
    """The cheapest way over a whole run, within `BLOCK_LIMIT`."""
    if interface == 0:
        return BlockKind.NONE
    kinds = [BlockKind.NONE]
    if 8.0 * interface**2 <= BLOCK_LIMIT:
        kinds.append(BlockKind.DENSE)
    if order > 1 and 8.0 * interface**2 / order <= BLOCK_LIMIT:
        kinds.append(BlockKind.SPLIT)
    return min(
        kinds,
        key=lambda kind: (
            build_seconds(kind, unknowns, interface, order, dimension)
            + APPLICATIONS * members * apply_seconds(kind, unknowns, interface, order, dimension)
        ),
    )
