"""Actions whose errors on one rank reach all ranks."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

from mpi4py import MPI

from contact_app.errors import ConfigurationError, ContactError

Result = TypeVar("Result")


def on_first(comm: MPI.Intracomm, action: Callable[[], Result]) -> Result:
    """Run an action on rank 0 alone; all ranks get its result or its error (collective)."""
    result: Any = None
    fault: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except (OSError, ContactError) as error:
            fault = error
    result, first_fault = comm.bcast((result, fault))
    if first_fault is not None:
        raise fault or first_fault
    return cast(Result, result)


@contextmanager
def agreed(comm: MPI.Intracomm) -> Iterator[None]:
    """Raise a `ConfigurationError` of any rank on all ranks."""
    message = None
    try:
        yield
    except ConfigurationError as error:
        message = str(error)
    messages = [m for m in comm.allgather(message) if m]
    if messages:
        raise ConfigurationError(messages[0])
