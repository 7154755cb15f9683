"""What applying K⁺ costs, and with it the choice how a class applies it.

Seconds on one machine of two cores; the choice depends on their ratios only.
"""

from __future__ import annotations

from enum import Enum

APPLICATIONS = 100
"""Applications of the dual operator a solve is expected to need; weighs what is done once."""

BLOCK_LIMIT = 3e9
"""Largest dense block, in bytes."""

PRODUCT_RATE = 5e10
"""Dense products, in floating-point operations a second."""

SPARSE_RATE = 1e9
"""Multiplications a second with a sparse matrix and many columns."""


class BlockKind(Enum):
    """How a class applies K⁺ on its interface."""

    NONE = "sparse solves"
    DENSE = "one dense block"
    SPLIT = "a dense block for each character of the reflections"


def solve_seconds(unknowns: float) -> float:
    """One right-hand side among many through a sparse factor of a body of so many unknowns."""
    return 4e-8 * unknowns**1.2


def apply_seconds(kind: BlockKind, unknowns: int, interface: int, order: int) -> float:
    """K⁺ on the interface of one member.

    Parameters
    ----------
    order
        Elements of the group of reflections.
    """
    if kind is BlockKind.NONE:
        return solve_seconds(unknowns)
    if kind is BlockKind.DENSE:
        return 2.0 * interface**2 / PRODUCT_RATE
    product = 2.0 * interface**2 / order / PRODUCT_RATE
    return product + 2.0 * order * interface / SPARSE_RATE


def build_seconds(kind: BlockKind, unknowns: int, interface: int, order: int) -> float:
    """The block, once it is factored: a solve for each interface unknown."""
    if kind is BlockKind.NONE:
        return 0.0
    dense = 2.0 * interface**2 * order / SPARSE_RATE if kind is BlockKind.DENSE else 0.0
    return interface * solve_seconds(unknowns / order) + (dense if order > 1 else 0.0)


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
