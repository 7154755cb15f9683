"""Ranks that wait for programs tell errors, and start anew after one."""

import pytest

from tests.ranks import execute

NUMBER = "from mpi4py import MPI; print(1 / MPI.COMM_WORLD.rank); MPI.COMM_WORLD.barrier()"


@pytest.mark.mpi
def test_an_error_of_one_rank_for_which_another_waits_is_reported() -> None:
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        execute(NUMBER, ranks=2)
    assert execute("import sys; print(sys.argv[1])", "again", ranks=2) == "again\nagain\n"
    with pytest.raises(AssertionError, match="NameError"):
        execute("unknown", ranks=1)
