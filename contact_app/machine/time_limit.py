"""A limit on the processor time of a run."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


class OutOfTime(Exception):
    """Time is up. No `TimeoutError`: that is an `OSError`, which some code may swallow."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Context manager that raises :class:`OutOfTime` after some processor time of this process.

    The processor time of all threads counts, that of other processes does not.
    """

    def ring(*_: object) -> None:
        raise OutOfTime

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
