"""Reasons why a solve missed its tolerance, as the user reads them."""

from dataclasses import replace

from solver.contact.options import SolverOptions
from solver.driver import reason_text, solve
from solver.qp.result import Reason
from tests import scenes


def test_a_limit_of_outer_iterations_names_the_method_to_take() -> None:
    problem = scenes.problem(scenes.wall("quadrilateral", 4))
    solution = solve(problem, SolverOptions())
    ended = replace(
        solution,
        reason=Reason.MAX_OUTER_ITERATIONS,
        certificate=replace(solution.certificate, passed=False),
    )
    told = reason_text(ended)
    assert "another solver.method" in told
    assert "equalities" not in told
