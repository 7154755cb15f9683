"""The first active set: contact on coarse levels, each row a one-sided spring, coarse to fine.

On the coarse space of a level, Q = C P₁ … P_k, `solver.primal.spring_levels` states the problem.
s_i is the stiffness that K has against row i alone, so that the springs are as compliant as the
finest mesh at one node. At first, faint springs (w) hold bodies that only contact holds, and pull
open rows towards contact; then proximal steps replace these springs. Tangential rows have springs
that yield at the slip limit (`solver.primal.friction_springs`). Small levels are solved by a
factor, the others by a few conjugate gradients with a cycle of the levels below. The rows with a
pressing spring are the first active set, its points stick or slide as the springs do, and its solve
begins with this displacement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from solver.primal.block_rows import BlockRows
from solver.primal.blocks import petsc_blocks, rows_in_blocks
from solver.primal.cycle import CycleOnSets, CycleWithSprings, rows_on_levels
from solver.primal.factor import diagonal_below, row_stiffness, spread_means, squared_rows
from solver.primal.friction_springs import FrictionSprings
from solver.primal.hierarchy import Hierarchy
from solver.primal.merged import MergedSystem
from solver.primal.products import multiply, multiply_transposed
from solver.primal.rigid_bodies import with_motions
from solver.primal.spring_levels import (
    CycleLevel,
    DenseLevel,
    FirstSetOptions,
    Rows,
    SharedLevel,
)
from solver.primal.step import Position
from solver.vectors import Array, Mask


@dataclass(frozen=True, eq=False)
class FirstSet:
    """The initial active set of the loop and its displacement."""

    active: Mask  # (rows,)
    u: Array  # (unknowns,)
    multiplier: Array | None = None  # (rows,)
    """Forces of the springs, as multipliers; None where no springs were used."""
    cycle: CycleWithSprings | None = None
    """The cycle of the level below the finest one with springs on contact rows, if there is one."""


def find_first_set(
    system: MergedSystem, hierarchy: Hierarchy, options: FirstSetOptions | None = None
) -> FirstSet:
    """The rows with contact on coarse levels (collective)."""
    options = options or FirstSetOptions()
    stiff = row_stiffness(system)
    springs = multiply_transposed(squared_rows(system), stiff)
    hierarchy, A = with_motions(system, hierarchy, _with_means(system, hierarchy), springs)
    P = hierarchy.prolongations
    friction = FrictionSprings.of(system, options.sticking * stiff)
    rows = Rows(system.comm, system.c, system.normal, system.equality, stiff, friction)
    start = system.at_rest
    if not P:  # the problem itself is coarse
        Q = BlockRows.of_rows(system.C, A[0].getBlockSize())
        only_level = SharedLevel(rows, A[0], Q, system.load, options)
        x = only_level.minimise(np.zeros(system.size), options.exact_steps)
        active = only_level.pressed(x) | system.equality
        return FirstSet(active, x, only_level.multiplier(x))
    on_levels, loads = rows_on_levels(system.C, P), [system.load - multiply(system.K, start)]
    for prolongation in P:
        loads.append(multiply_transposed(prolongation, loads[-1]))
    x = np.zeros(len(loads[-1]))
    for k in range(len(P), 0, -1):
        below = replace(hierarchy, prolongations=P[k:], operators=tuple(A[k:]))
        level = CycleLevel(rows, below, on_levels[k - 1 :], loads[k], options)
        if A[k].getSize()[0] <= options.largest:
            x = _on_every_rank(level, x, k == len(P))
        elif k == len(P):  # bodies may have no place yet
            x = level.minimise(x, options.steps)
        else:
            x = level.proximal_step(x, options.steps, options.settled)
        if k > 1:
            x = multiply(P[k - 1], x)
    cycle = None if system.has_rigid_bodies else level.made  # it has unknowns of rigid bodies
    active = level.pressed(x) | system.equality
    return FirstSet(active, start + multiply(P[0], x), level.multiplier(x), cycle)


def corrected_set(
    system: MergedSystem, hierarchy: Hierarchy, cycle: CycleOnSets, begin: Position, forces: Array
) -> FirstSet:  # fmt: skip
    """The set and the displacement after a correction on the level below the finest (collective).

    The forces of the springs begin with those of a set (`solver.primal.augmented` has the same
    Lagrangian): a set that needs no other one needs no correction.

    Parameters
    ----------
    cycle
        Of the last set.
    begin
        The displacement that is corrected.
    forces : (rows,)
        λ of the set.
    """
    P, stiff = hierarchy.prolongations, row_stiffness(system)
    below = replace(hierarchy, prolongations=P[1:], operators=hierarchy.operators[1:])
    friction = FrictionSprings.of(system, stiff)
    penetration = np.divide(forces, stiff, out=np.zeros_like(forces), where=stiff > 0.0)
    reach = -begin.jumps - penetration
    rows = Rows(system.comm, reach, system.normal, system.equality, stiff, friction)
    of_means = multiply_transposed(system.C, np.where(stiff > 0.0, 0.0, forces))
    load, options = multiply_transposed(P[0], begin.left - of_means), FirstSetOptions()
    level = CycleLevel(rows, below, cycle.rows, load, options, cycle.coarse)
    x = level.proximal_step(np.zeros(len(load)), options.steps, options.settled)
    return FirstSet(level.pressed(x) | system.equality, begin.u + multiply(P[0], x))


def _on_every_rank(level: SharedLevel, start: Array, coarsest: bool) -> Array:
    """The solution of a small level; every rank solves the whole problem (collective).

    The messages of a small distributed problem cost more than its work. Faint springs place the
    bodies on the `coarsest` level; on the next one they would take five of the twelve Newton steps
    of a ribbed panel (30,135 unknowns) for the same set.
    """
    dense = DenseLevel.gathered(level)
    x = np.concatenate(level.comm.allgather(start))
    if coarsest:
        x = dense.minimise(x, level.options.exact_steps)
    x = dense.without_faint_springs(x)
    return x[slice(*level.A.getOwnershipRange())].copy()


def _with_means(system: MergedSystem, hierarchy: Hierarchy) -> Sequence[PETSc.Mat]:
    """The stiffness of each level with springs for motions held in the mean (collective).

    On coarser levels they are the diagonal of their Galerkin products.
    """
    if not system.comm.allreduce(int(system.means.any())):
        return hierarchy.operators
    springs = spread_means(system) * system.diagonal
    result = []
    for k, operator in enumerate(hierarchy.operators):
        if k == 0 and hierarchy.prolongations:  # only coarser levels are needed
            result.append(operator)
            springs = diagonal_below(hierarchy.prolongations[0], springs)
            continue
        result.append(petsc_blocks(rows_in_blocks(operator).plus_diagonal(springs)))
        if k < len(hierarchy.prolongations):
            springs = diagonal_below(hierarchy.prolongations[k], springs)
    return result
