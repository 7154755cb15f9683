"""The duality gap J(û) - D(λ) of an answer, by groups of bodies that can touch each other.

û is an admissible neighbour of the displacements u, λ is in equilibrium with the loads, and the gap
bounds ½ ‖û - u*‖²_K. See `solver.contact.certificate` for the derivation. With friction u* is the
solution with the slip limits frozen at those of λ.
"""

import numpy as np

from solver.problem.decomposed import DecomposedProblem
from solver.problem.feasible import (
    feasible_displacements,
    motion_energies,
    without_jumps,
    worth_closing,
)
from solver.vectors import Array, Mask


def nearest_admissible(
    problem: DecomposedProblem, multiplier: Array, displacements: list[Array]
) -> Array:
    """The admissible û with the least duality gap, on the interface; elsewhere û = u."""
    interface, bodies = problem.on_interface(displacements), problem.bodies
    changes, costs = _candidates(problem, multiplier, interface)
    second = (costs[-1] < costs[0])[bodies.groups[bodies.columns]]
    return interface + np.where(second, changes[-1], changes[0])


def duality_gap(
    problem: DecomposedProblem, multiplier: Array, interface: Array, rest: float = 0.0
) -> float:
    """J(û) - D(λ) for λ and the displacements of u on the interface, an energy.

    Parameters
    ----------
    multiplier : (dual,)
        λ ≥ 0 on contact rows, in equilibrium with the loads.
    rest
        As for `feasible_displacements`.
    """
    return float(group_gaps(problem, multiplier, interface, rest).sum())


def group_gaps(
    problem: DecomposedProblem, multiplier: Array, interface: Array, rest: float = 0.0
) -> Array:
    """`duality_gap` of each group, (groups,)."""
    return np.asarray(_candidates(problem, multiplier, interface, rest)[1].min(axis=0))


def _candidates(
    problem: DecomposedProblem, multiplier: Array, interface: Array, rest: float = 0.0
) -> tuple[list[Array], Array]:
    """Changes û - u to one or two admissible û, and their gaps in each group, (·, groups).

    One closes the contact rows of `worth_closing`, the other does not. Each group of bodies takes
    the one with the smaller gap.
    """
    bodies, tied = problem.bodies, without_jumps(problem, interface)
    candidates = [_candidate(problem, multiplier, tied, None, rest)]
    if problem.one_sided:
        closed = worth_closing(problem, multiplier, problem.residual(interface))
        candidates.insert(0, _candidate(problem, multiplier, tied, closed, rest))
    changes = [feasible - interface for feasible, _ in candidates]
    costs = np.array([
        opened + bodies.sum_by_group(motion_energies(problem, w))
        for w, (_, opened) in zip(changes, candidates, strict=True)
    ])  # fmt: skip
    return changes, problem.comm.allreduce(costs)


def _candidate(
    problem: DecomposedProblem, multiplier: Array, tied: Array, closed: Mask | None, rest: float
) -> tuple[Array, Array]:
    """An admissible û near displacements without jumps, and its terms in λ.

    These terms are λᵀ (c - B û), and with friction s |w| - λ_t · w for the slips w of û.
    """
    friction = problem.friction
    sliding = friction.sliding(multiplier)
    feasible, residual = feasible_displacements(problem, tied, closed, rest, sliding)
    work = np.where(problem.inequality, -multiplier * np.minimum(residual, 0.0), 0.0)
    rows, lost = friction.work_lost(multiplier, residual)
    work[rows] += lost
    bodies = problem.bodies
    groups = bodies.groups[bodies.rows[:, 0]]
    return feasible, np.bincount(groups, work, bodies.group_count).astype(np.float64)
