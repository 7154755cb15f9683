"""The sizes by which the numbers of a certificate are measured."""

import numpy as np
import pytest

from solver.contact.bodies import Bodies
from solver.problem.sizes import BodyForces, force_references


class _Group:
    """The data of one group of bodies that references of forces need."""

    def __init__(self, count: int) -> None:
        nothing = np.zeros(0, np.int64)
        groups = np.zeros(count, np.int64)
        self.bodies = Bodies(groups, (), nothing, nothing.reshape(0, 2), np.zeros(count, bool))
        self.heated = np.zeros(count, bool)


def test_a_body_without_load_is_measured_by_its_rounding_errors_up_to_a_limit() -> None:
    loads = np.array([100.0, 1e-3, 1e-3, 1e-3])
    rounded = np.array([1e-6, 1e-12, 1e-9, 1e-6])
    forces = BodyForces(loads, loads, loads, rounded)
    found = force_references(_Group(4), forces, tolerance=1e-6)
    assert found == pytest.approx([100.0, 1e-3, 1e-2, 0.1])
