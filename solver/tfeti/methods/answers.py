"""Answers: from multipliers to displacements with their certificate."""

from dataclasses import replace

import numpy as np

from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.qp.result import Counts, Reason
from solver.tfeti.active_set_problem import State
from solver.tfeti.certify import certify
from solver.tfeti.decomposed import DecomposedProblem
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier
from solver.tfeti.recovery import displacements as recover
from solver.tfeti.recovery import kernel_coefficients
from solver.vectors import Array

ROUNDED_FORCE = 1e3 * float(np.finfo(np.float64).eps)
"""Contact force over the forces on its bodies up to which it may be a rounding error of these."""


def answer_of_iterate(
    problem: DualProblem, rule: StoppingRule, x: Array, equality_force: Array | None
) -> Solution:
    """The `certified_answer` of an iterate, judged by a stopping rule."""
    return certified_answer(problem, x, equality_force, rule.tolerance)


def answer_of_state(problem: DualProblem, rule: StoppingRule, state: State) -> Solution:
    """The certified answer of the solution on an active set, judged by a stopping rule."""
    multiplier = feasible_multiplier(problem, state.multiplier, state.active)
    return rule.judge(_certified(problem, multiplier, state.motions, rule.tolerance))


def certified_answer(
    problem: DualProblem, x: Array, equality_force: Array | None, tolerance: float
) -> Solution:
    """Recover the displacements of an iterate of the solver and certify them (collective).

    Contact rows whose x exceeds its bound carry force.

    Parameters
    ----------
    tolerance
        Limit of the numbers of the certificate.
    """
    balanced = x.copy()
    if problem.coarse is not None:
        problem.coarse.project(x, balanced)
    active = np.zeros(problem.size, bool)
    if problem.lower is not None:
        active = x > problem.lower
    active &= ~problem.friction.sliding(problem.offset + x)
    multiplier = feasible_multiplier(problem, problem.offset + balanced, active)
    alpha = kernel_coefficients(problem, multiplier, equality_force)
    return _certified(problem, multiplier, alpha, tolerance)


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


def _certified(problem: DualProblem, multiplier: Array, alpha: Array, tolerance: float) -> Solution:
    u = recover(problem, multiplier, alpha)
    certificate, measures = certify(problem, multiplier, u, tolerance)
    return Solution(multiplier, u, certificate, measures, Counts(), Reason.CONVERGED, tolerance)
