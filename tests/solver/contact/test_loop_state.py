"""The record of sets on which all points slide."""

import numpy as np
from mpi4py import MPI

from solver.backend import Statuses
from solver.contact.loop_state import SlidingSets

TANGENTIAL = np.array([False, True, True, True, True])


def on_set(sticking: int) -> Statuses:
    """Statuses with so many sticking rows of four, all others sliding."""
    active = np.array([True, *(np.arange(4) < sticking)])
    return Statuses(active, np.where(active, 0.0, 1.0))


def yielded(*sticking: int, share: float = 0.5) -> list[int]:
    """The number of sets whose points yield, after each set of a history."""
    record, result = SlidingSets(), []
    for rows in sticking:
        record = record.after(MPI.COMM_SELF, on_set(rows), TANGENTIAL, share)
        result.append(record.yielded)
    return result


def test_points_yield_after_many_stuck_again_twice() -> None:
    assert yielded(0, 2, 0, 2, 0) == [0, 0, 0, 0, 1]
    assert yielded(0, 1, 0, 1, 0) == [0, 0, 0, 0, 0]  # a quarter is less than the share


def test_points_yield_for_more_sets_each_time() -> None:
    assert yielded(0, 2, 0, 2, 0, 0, 0) == [0, 0, 0, 0, 1, 2, 0]
    assert yielded(0, 2, 0, 2, 0, 1, 0, 0, 0, 0) == [0, 0, 0, 0, 1, 0, 1, 2, 3, 0]


def test_the_record_before_a_set_stays_as_it_was() -> None:
    before = SlidingSets(rows=4, followed=1)
    after = before.after(MPI.COMM_SELF, on_set(3), TANGENTIAL, 0.5)
    assert before == SlidingSets(rows=4, followed=1)
    assert after == SlidingSets(rows=0, followed=2, sticks=True)
