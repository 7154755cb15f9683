"""The answers of earlier load cases with which a case begins."""

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.run.case_models import nearest_combination
from contact_app.run.cases import solved_cases
from solver.contact.solution import Guess
from solver.contact.stopping import StoppingRule
from solver.primal.by_active_sets import solve_by_multigrid
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from tests import scenes


def factors(*vectors: list[float]) -> np.ndarray | None:
    """Factors of all but the last vector."""
    rows = np.array(vectors)
    return nearest_combination(rows @ rows.T)


def test_a_multiple_takes_the_case_itself() -> None:
    np.testing.assert_allclose(factors([1, 0, 0], [0, 1, 0], [0, 3, 0]), [0.0, 3.0])


def test_a_sum_of_two_cases_takes_both() -> None:
    found = factors([1, 0.1, 0], [0, 1, 0.2], [0, 0, 5], [2, 1.2, 0.2])
    np.testing.assert_allclose(found, [2.0, 1.0, 0.0], atol=1e-12)


def test_the_two_nearest_cases_of_many_on_a_line_are_taken() -> None:
    """All are sums of two loads: any two cases would do."""
    line = [[1.0, t, 0.0] for t in (-1.0, -0.5, 0.0, 0.5)]
    found = factors(*line, [1.0, 0.75, 0.0])
    np.testing.assert_allclose(found, [0.0, 0.0, -0.5, 1.5], atol=1e-12)


def test_the_opposite_of_a_case_and_far_loads_start_from_no_case() -> None:
    assert factors([1, 0, 0], [-1, 0, 0]) is None
    assert factors([1, 0, 0], [1, 5, 0]) is None


def test_cases_that_do_not_differ_are_no_trouble() -> None:
    found = factors([1, 0, 0], [1, 0, 0], [1, 0.3, 0])
    assert found is not None
    np.testing.assert_allclose(found.sum(), 1.0)
    np.testing.assert_allclose(factors([0, 0, 0], [1, 0, 0], [2, 0, 0]), [0.0, 2.0])


def test_nearly_parallel_cases_are_not_extrapolated_far() -> None:
    """The factors of both would be -9 and 10."""
    found = factors([1, 0, 0], [1, 0.1, 0], [1, 1, 0])
    np.testing.assert_allclose(found, [0.0, 1.1 / 1.01])


def test_loads_without_effect_take_no_case() -> None:
    assert factors([0, 0, 0], [0, 0, 0]) is None
    assert factors([0, 0, 0], [1, 0, 0]) is None


def on_a_block(friction: bool, history: dict[str, Any]) -> scenes.Config:
    """A block on another, held by contact alone; the load is on top, away from contact."""
    beside: dict[str, Any] = {"on": "up.y+", "displacement": [0, None]}
    return {
        "dimension": 2,
        "bodies": [scenes.box("low", [3, 1], [6, 4]), scenes.box("up", [2.5, 2], [5, 4], [0.5, 1])],
        "conditions": [
            {"on": "low.y-", "displacement": [0, 0]},
            {"on": "up.y+", "traction": [0, -10.0], "name": "press"},
            {"on": "up.x-", "traction": [1.0, 0.0]} if friction else beside,
        ],
        "contacts": [
            {"on": "up.y-", "against": "low.y+"}
            | ({"friction": {"coulomb": 0.3}} if friction else {})
        ],
        "solver": {"method": "primal"},
        **history,
    }


@pytest.mark.parametrize("friction", [False, True])
def test_multigrid_begins_a_case_with_the_contact_of_another(friction: bool) -> None:
    """From the loads at contact rows alone, of which there are none, it began without contact."""
    cases = {"cases": {"a": {"press": 1}, "b": {"press": 0.5}}}
    answers = contact_app.solve(on_a_block(friction, cases)).cases
    assert all(answer.certificate.passed for answer in answers.values())
    assert {answer.summary["solver"]["method"] for answer in answers.values()} == {"primal"}


def test_multigrid_begins_an_increment_with_the_contact_of_the_last() -> None:
    answer = contact_app.solve(on_a_block(False, {"steps": [{"press": 1}, {"press": 0.5}]}))
    assert answer.summary["certificate"]["passed"]
    assert answer.summary["solver"]["method"] == "primal"
    assert not answer.summary["certificate"]["warnings"]


def test_loads_away_from_contact_have_an_effect_without_factors() -> None:
    whole, half = (on_a_block(False, {}) for _ in range(2))
    half["conditions"][1]["traction"] = [0, -5.0]
    effects = [scenes.problem(made).effect_of_loads for made in (whole, half)]
    assert np.abs(effects[0]).max() > 0.0
    np.testing.assert_allclose(effects[0], 2.0 * effects[1])


def test_a_guess_that_holds_no_body_is_dropped() -> None:
    problem = scenes.problem(on_a_block(False, {}))
    task = Task(problem, StoppingRule(1e-6), MPRGP(rtol=1e-8, max_iterations=2000))
    found = solve_by_multigrid(task, Guess(np.zeros(problem.size)), None)
    assert found.converged
    assert (found.multiplier[problem.inequality] > 0.0).all()


@pytest.mark.ratchet
def test_cases_between_others_take_few_operator_applications() -> None:
    made = scenes.wall("hexahedron", 6)
    load = made["conditions"].pop()
    assert "traction" in load
    made["conditions"] += [
        {**load, "name": "press"}, {**load, "name": "push", "traction": [8.0, 0.0, 0.0]},
    ]  # fmt: skip
    made["decomposition"] = {"subdomains": [2, 2, 2]}
    made["cases"] = {f"c{i}": {"press": 1, "push": 0.25 * i} for i in range(6)}
    scene = scenes.build(made)
    counts = [s.solution.counts.hessian for s in solved_cases(scene, MPI.COMM_SELF, lambda _: None)]
    assert max(counts[3:]) <= 5 < counts[0]
