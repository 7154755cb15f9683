"""Wall-clock time by stage of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STAGES = ("setup", "assembly", "factorization", "solve", "estimate", "output")


class Timings:
    """Wall-clock seconds by stage, counted from when it was made.

    Parameters
    ----------
    clock
        Tells the seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._clock = clock
        self._start = clock()

        self._inner = 0.0  # seconds of stages inside the one that runs

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the time spent inside to a stage; stages inside it count for themselves alone."""
        begin, outer = self._clock(), self._inner
        self._inner = 0.0
        try:
            yield
        finally:
            spent = self._clock() - begin
            self.seconds[stage] += spent - self._inner
            self._inner = outer + spent

    def branched(self, total: float) -> Timings:
        """What was measured so far, as the start of one of several runs that share it.

        Parameters
        ----------
        total
            Seconds in all that the shared part took.
        """
        result = Timings(self._clock)
        result.seconds = dict(self.seconds)
        result._start -= total
        return result

    def as_dict(self) -> dict[str, float]:
        """Seconds by stage and in all."""
        return {**self.seconds, "total": self._clock() - self._start}
