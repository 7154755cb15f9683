"""Actions of one rank whose errors reach all ranks."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

from contact_app.errors import ContactError


def on_first(comm: MPI.Intracomm, action: Callable[[], object]) -> None:
    """Run an action on rank 0 alone; its errors are raised on all ranks (collective)."""
    fault: Exception | None = None
    if comm.rank == 0:
        try:
            action()
        except (OSError, ContactError) as error:
            fault = error
    first_fault = comm.bcast(fault)
    if first_fault is not None:
        raise fault or first_fault
