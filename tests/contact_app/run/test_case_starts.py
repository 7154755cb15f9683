"""Which answers of earlier load cases a case begins with."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.run.case_models import nearest_combination
from contact_app.run.cases import solved_cases
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


def test_the_opposite_of_a_case_and_what_is_far_away_take_none() -> None:
    assert factors([1, 0, 0], [-1, 0, 0]) is None
    assert factors([1, 0, 0], [1, 5, 0]) is None


def test_cases_that_do_not_differ_are_no_trouble() -> None:
    found = factors([1, 0, 0], [1, 0, 0], [1, 0.3, 0])
    assert found is not None
    np.testing.assert_allclose(found.sum(), 1.0)
    np.testing.assert_allclose(factors([0, 0, 0], [1, 0, 0], [2, 0, 0]), [0.0, 2.0])


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
