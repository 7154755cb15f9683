"""What factoring and applying K⁺ costs, and with it the choice how a class applies it.

Seconds on one machine of two cores, fitted to cubes of 4³ to 30³ hexahedra a subdomain; choices
depend on their ratios only. A subdomain whose reflections form a group of `order` elements is
factored and applied in as many blocks.
"""

from __future__ import annotations

from enum import Enum

APPLICATIONS = 100
"""Applications of the dual operator a solve is expected to need; weighs what is done once."""

BLOCK_LIMIT = 3e9
"""Largest dense block, in bytes."""

PRODUCT_RATE = 5e10
"""Dense products, in floating-point operations a second."""

SPLIT_SECONDS = 1.5e-8
"""Change to the coordinates of the characters and back, for each unknown."""

SPARSE_SECONDS = 2e-8
"""The lumped preconditioner's product with a sparse matrix, for each interface unknown."""

ROW_SECONDS = 1.2e-7
"""Products with B, projections and vector work of an iteration, for each row of B."""

CALL_SECONDS = 1.5e-3
"""What an iteration costs whatever its size."""


class BlockKind(Enum):
    """How a class applies K⁺ on its interface."""

    NONE = "sparse solves"
    DENSE = "one dense block"
    SPLIT = "a dense block for each character of the reflections"


def factor_seconds(unknowns: float, order: int) -> float:
    """Sparse factors of a body in space of so many unknowns."""
    return order * 2.5e-7 * (unknowns / order) ** 1.5


def solve_seconds(unknowns: float, order: int = 1) -> float:
    """One right-hand side among many through the sparse factors."""
    return order * 2.5e-8 * (unknowns / order) ** 1.16


def apply_seconds(kind: BlockKind, unknowns: int, interface: int, order: int) -> float:
    """K⁺ on the interface of one member."""
    if kind is BlockKind.NONE:
        return solve_seconds(unknowns)
    if kind is BlockKind.DENSE:
        return 2.0 * interface**2 / PRODUCT_RATE
    return 2.0 * interface**2 / order / PRODUCT_RATE + SPLIT_SECONDS * interface


def build_seconds(kind: BlockKind, unknowns: int, interface: int, order: int) -> float:
    """The block, once K is factored: a solve for each interface unknown."""
    if kind is BlockKind.NONE:
        return 0.0
    solves = interface * solve_seconds(unknowns / order)
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
    relaxed = APPLICATIONS * members * (2.0 * block + rest) * relaxed_share(interface)
    return inverse + relaxed < lumped


def relaxed_share(interface: int) -> float:
    """Iterations with the Schur complement over those with the plain stiffness."""
    edge = (interface / 18.0) ** 0.5  # cells along an edge of a box in space
    return min(1.0, (edge / 5.0) ** -0.35)


def coarse_seconds(subdomains: int) -> float:
    """One solve with G Gᵀ."""
    return 1.5e-7 * subdomains ** (4.0 / 3.0)


def iteration_seconds(rows: int, subdomains: int) -> float:
    """An iteration but for K⁺ and the lumped preconditioner's product."""
    return CALL_SECONDS + ROW_SECONDS * rows + 4.0 * coarse_seconds(subdomains)


def choose_block(unknowns: int, interface: int, members: int, order: int) -> BlockKind:
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
            build_seconds(kind, unknowns, interface, order)
            + APPLICATIONS * members * apply_seconds(kind, unknowns, interface, order)
        ),
    )
