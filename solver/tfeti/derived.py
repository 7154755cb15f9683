"""Problems derived from a dual problem during its solution: for an active set, for turned frames.

They share its factors and the displacements under its loads without constraints.
"""

from dataclasses import replace

import numpy as np

from solver.backend import Turn
from solver.contact.row_kinds import RowKind
from solver.problem.constraints.friction import FrictionRows
from solver.problem.constraints.matrix import TurnedConstraintMatrix
from solver.tfeti.dual import DualProblem, Reused
from solver.vectors import Array, Mask


def with_active(
    problem: DualProblem,
    active: Mask,
    near: Array | None = None,
    tractions: Array | None = None,
    weights: Array | None = None,
) -> DualProblem:
    """The problem with these rows as equalities and without the other contact rows.

    Without active rows this is the problem without contact. It is admissible only if the bodies are
    `held_without_contact`; otherwise the coarse problem can be singular.

    Parameters
    ----------
    active : (dual,)
        Contact and tangential rows that hold with equality.
    near : (dual,)
        λ̃ is the multiplier in equilibrium nearest to this one, instead of the smallest one.
    tractions : (dual,)
        Multipliers that act as additional loads. Their effect is in `displacements_of_offset` and
        `rhs`, but not in `d`.
    weights : (dual,)
        Factors on the rows; λ is the factor times the multiplier of the scaled row.
    """
    keep = np.where(problem.conditional & ~active, 0.0, 1.0 if weights is None else weights)
    constraints = replace(
        problem.constraints,
        B=problem.B.scaled(keep),
        kinds=np.where(problem.conditional, np.int8(RowKind.SUPPORT), problem.kinds),
    )
    every_coarse = problem.coarse
    coarse = None if every_coarse is None else every_coarse.weighted(keep)
    offset = moved = None
    if near is not None or tractions is not None:
        offset = np.zeros(problem.size) if near is None else near * keep
    if offset is not None and coarse is not None:
        missing, change = np.empty_like(problem.e), np.empty(problem.size)
        coarse.restrict(offset, missing)
        if tractions is not None:
            loaded = np.empty_like(missing)
            every_coarse.restrict(tractions, loaded)  # type: ignore[union-attr]
            missing += loaded
        coarse.least_multiplier(problem.e - missing, change)
        offset += change
    if offset is not None and tractions is not None:
        moved = np.empty_like(problem.free_displacements)
        problem.F.solve_interface(problem.constraint_forces(tractions + keep * offset), moved)
        np.subtract(problem.free_displacements, moved, out=moved)
    none = problem.contact.none()
    return replace(
        problem,
        constraints=constraints,
        shared=replace(problem.shared, contact=none, friction=FrictionRows.none(none)),
        load_case=replace(problem.load_case, c=problem.c * keep),
        coarse=coarse,
        reused=Reused(
            free_solution=problem.free_solution,
            d=keep * problem.d,
            offset=offset,
            displacements=moved,
        ),
    )


def beside_moved(problem: DualProblem, moved: Array) -> DualProblem:
    """The problem with other right-hand sides of the constraints: c + moved, (dual,)."""
    loads = replace(problem.load_case, c=problem.c + moved)
    return replace(problem, load_case=loads, reused=replace(problem.reused, d=None))


def turned(problem: DualProblem, turn: Turn) -> DualProblem:
    """The problem in turned tangential frames."""
    B = TurnedConstraintMatrix(problem.B, turn)
    return replace(
        problem,
        constraints=replace(problem.constraints, B=B),
        load_case=replace(problem.load_case, c=turn.turned(problem.c)),
        coarse=None if problem.coarse is None else problem.coarse.turned(B),
        reused=Reused(free_solution=problem.free_solution, d=turn.turned(problem.d)),
    )


def beginning_at(problem: DualProblem, change: Array, displacements: Array) -> DualProblem:
    """The problem with another λ̃: a change that keeps G λ̃ = e is added.

    Parameters
    ----------
    change : (dual,)
    displacements : (interface,)
        K⁺ Bᵀ times the change.
    """
    reused = Reused(
        problem.F, problem.free_solution, problem.d, problem.offset + change,
        problem.displacements_of_offset - displacements,
    )  # fmt: skip
    return replace(problem, reused=reused)
