"""The answer of a method: multipliers and displacements with their certificate."""

from dataclasses import replace

import numpy as np

from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.problem.certify import certify
from solver.problem.decomposed import DecomposedProblem
from solver.qp.result import Counts, Reason
from solver.vectors import Array

ROUNDED_FORCE = 1e3 * float(np.finfo(np.float64).eps)
"""Contact force over the forces on its bodies up to which it may be a rounding error of these."""


def certified(
    problem: DecomposedProblem,
    multiplier: Array,
    displacements: list[Array],
    tolerance: float,
    unsolved: Array | None = None,
) -> Solution:
    """The answer with its certificate (collective); parameters as of `certify`."""
    measured = certify(problem, multiplier, displacements, tolerance, unsolved)
    return Solution(multiplier, displacements, *measured, Counts(), Reason.CONVERGED, tolerance)


def without_rounded_forces(
    problem: DecomposedProblem,
    rule: StoppingRule,
    solution: Solution,
    unsolved: Array | None = None,
) -> Solution:
    """The answer without contact forces that are rounding errors, where it passes only without.

    Where bodies come apart that no load holds, as when a tool is drawn back, rounding errors of
    the forces that pressed them before remain. Bodies at rest have no strains without these forces.
    Thermal loads balance themselves up to rounding errors, which press bodies together that have no
    other load (collective).

    Parameters
    ----------
    unsolved
        As of `certify`.
    """
    if solution.converged or solution.reason is Reason.STOPPED:
        return solution
    measures, sides = solution.measures, problem.bodies.rows
    size = np.abs(solution.multiplier) * problem.spread
    dropped = size <= ROUNDED_FORCE * measures.loads[sides].max(axis=1)
    dropped |= (measures.scales == 0.0)[sides[:, 0]]
    multiplier = np.where(problem.conditional & dropped, 0.0, solution.multiplier)
    if not problem.comm.allreduce(int(np.not_equal(multiplier, solution.multiplier).any())):
        return solution
    certificate, measures = certify(
        problem, multiplier, solution.displacements, rule.tolerance, unsolved
    )
    separated = replace(
        solution, multiplier=multiplier, certificate=certificate, measures=measures,
        reason=Reason.CONVERGED,
    )  # fmt: skip
    separated = rule.judge(separated)
    return separated if separated.converged else solution
