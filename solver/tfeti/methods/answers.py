"""Answers: from multipliers to displacements with their certificate."""

import numpy as np

from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.problem.answer import certified
from solver.tfeti.active_set_problem import State
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible_multiplier import feasible_multiplier
from solver.tfeti.recovery import displacements, kernel_coefficients
from solver.vectors import Array


def answer_of_state(problem: DualProblem, rule: StoppingRule, state: State) -> Solution:
    """The certified answer of the solution on an active set, judged by a stopping rule."""
    multiplier = feasible_multiplier(problem, state.multiplier, state.active)
    u = displacements(problem, multiplier, state.motions)
    return rule.judge(certified(problem, multiplier, u, rule.tolerance))


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
    u = displacements(problem, multiplier, alpha)
    return certified(problem, multiplier, u, tolerance)
