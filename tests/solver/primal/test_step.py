"""Steps of active sets end where they penetrate far."""

import numpy as np
import pytest
from mpi4py import MPI

from solver.primal.step import Position, shortened


def of_one_unknown(u: float, gaps: np.ndarray) -> Position:
    """A spring of stiffness one under a load of one; it is at rest at u = 1."""
    return Position(np.array([u]), np.array([1.0 - u]), u - gaps)


def test_a_step_ends_where_springs_balance_it() -> None:
    gaps, stiff = np.array([0.5, 0.9, 2.0]), np.array([3.0, 5.0, 7.0])
    before, after = of_one_unknown(0.0, gaps), of_one_unknown(1.0, gaps)
    is_open = np.ones(3, bool)
    point, met = shortened(MPI.COMM_SELF, stiff, is_open, before, after)
    u = (1.0 + 3.0 * 0.5) / (1.0 + 3.0)  # 1 - u = 3 (u - 0.5); the second row stays open
    np.testing.assert_allclose(np.concatenate([point.u, point.left]), [u, 1.0 - u])
    np.testing.assert_allclose(point.jumps, u - gaps)
    np.testing.assert_array_equal(met, [True, False, False])


@pytest.mark.parametrize("closed", [1, 2])
def test_a_step_that_penetrates_few_rows_is_whole(closed: int) -> None:
    """Two rows are penetrated, and as many or more active."""
    gaps = np.array([0.5, 0.9, 1.0, 1.0])
    before, after = of_one_unknown(0.0, gaps), of_one_unknown(1.0, gaps)
    is_open = np.arange(4) < 4 - closed
    point, met = shortened(MPI.COMM_SELF, np.full(4, 3.0), is_open, before, after)
    assert (point is after) == (closed == 2)
    assert (met is None) == (closed == 2)


def test_rows_that_a_step_leaves_do_not_hold_it_back() -> None:
    """They were penetrated at its beginning already, for instance since their force was tensile."""
    gaps, stiff = np.array([-0.5, 0.2]), np.array([1e6, 4.0])
    before, after = of_one_unknown(0.0, gaps), of_one_unknown(1.0, gaps)
    before = Position(before.u, before.left, np.array([0.5, -0.2]))
    after = Position(after.u, after.left, np.array([0.2, 0.8]))
    point, met = shortened(MPI.COMM_SELF, stiff, np.ones(2, bool), before, after)
    np.testing.assert_allclose(point.u, (1.0 + 4.0 * 0.2) / 5.0)
    np.testing.assert_array_equal(met, [False, True])
