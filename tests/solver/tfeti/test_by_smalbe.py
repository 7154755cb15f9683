"""SMALBE-M where active sets did not settle, and active sets between its outer iterations."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.contact.stopping import StoppingRule
from solver.driver import solve
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Obstacle, Subdomain, problem_from_arrays
from solver.tfeti.methods.by_smalbe import solve_by_smalbe
from solver.tfeti.methods.task import Task
from tests.solver.tfeti.test_from_arrays import COLUMNS, ROWS, lattice

PIECES, TOLERANCE = 3, 1e-8


def pressed_beam() -> DualProblem:
    """A lattice in pieces that only a floor holds up, pressed down in its middle piece."""
    points, K = lattice(COLUMNS)
    stiffness, width = sparse.csr_matrix(K), PIECES * COLUMNS + 1
    pieces = []
    for piece in range(PIECES):
        moved = points + [piece * COLUMNS, 0]
        load = np.zeros((len(points), 2))
        load[moved[:, 1] == ROWS, 1] = -0.01 * (piece == 1)
        nodes = (moved[:, 1] * width + moved[:, 0]).astype(np.int64)
        pieces.append(Subdomain(stiffness, load.ravel(), nodes, moved))
    left = width * np.arange(ROWS + 1)
    held = Held(left, np.tile([True, False], (ROWS + 1, 1)), np.zeros((ROWS + 1, 2)))
    bottom = np.arange(width)
    gaps = 0.02 * ((bottom - width // 2) / width) ** 2
    floor = Obstacle(bottom, np.tile([0.0, -1.0], (width, 1)), gaps)
    return problem_from_arrays(MPI.COMM_SELF, pieces, held, [floor])


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
