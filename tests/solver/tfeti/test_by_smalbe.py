"""SMALBE-M where active sets did not settle, and active sets between its outer iterations."""

import numpy as np
import pytest

from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.driver import solve
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.by_smalbe import solve_by_smalbe
from solver.vectors import Array
from tests.solver.lattices import COLUMNS, ROWS, in_pieces

PIECES, TOLERANCE = 3, 1e-8


def pressed_beam() -> DualProblem:
    """A lattice in pieces that only a floor holds up, pressed down in its middle piece."""
    width = PIECES * COLUMNS + 1
    gaps = 0.02 * ((np.arange(width) - width // 2) / width) ** 2

    def down(x: Array) -> Array:
        return 0.01 * (x[:, 1] == ROWS) * (x[:, 0].min() == COLUMNS)

    return in_pieces(COLUMNS, PIECES, down, gaps, held=(True, False))


def by_smalbe(problem: DualProblem, active_sets: bool) -> Solution:
    rule = StoppingRule(TOLERANCE)
    task = Task(problem, rule, MPRGP(rtol=0.1 * TOLERANCE, max_iterations=10_000))
    return solve_by_smalbe(task, None, None, active_sets)


def test_active_sets_after_an_outer_iteration_end_it_where_contact_alone_holds_a_body() -> None:
    problem = pressed_beam()
    assert not problem.held_without_contact
    expected = solve(problem, SolverOptions(tolerance=TOLERANCE))
    assert expected.method == "active-set"
    alone, both = (by_smalbe(problem, active_sets) for active_sets in (False, True))
    for answer in (alone, both):
        assert answer.converged
        assert answer.reason is Reason.ACCEPTED
        assert answer.method == "smalbe"
        assert answer.measures.energy == pytest.approx(expected.measures.energy, rel=1e-8)
        assert not (answer.multiplier[problem.inequality] < 0.0).any()
    assert both.counts.outer == 1
    assert alone.counts.outer > 1
