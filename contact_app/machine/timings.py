"""Wall-clock time by stage of a run."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STAGES = ("setup", "assembly", "factorization", "solve", "estimate", "output")


class Timings:
    """Wall-clock seconds by stage, counted from the creation of the object.

    Parameters
    ----------
    clock
        Function that returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._clock = clock
        self._start = clock()

        self._inner = 0.0  # seconds of inner stages of the running stage

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Context manager that adds its time to a stage; inner stages are not counted twice."""
        begin, outer = self._clock(), self._inner
        self._inner = 0.0
        try:
            yield
        finally:
            seconds = self._clock() - begin
            self.seconds[stage] += seconds - self._inner
            self._inner = outer + seconds

    def branched(self, total: float) -> "Timings":
        """A copy of the present timings, for one of several runs that share this part.

        Parameters
        ----------
        total
            Total seconds of the shared part.
        """
        result = Timings(self._clock)
        result.seconds = dict(self.seconds)
        result._start -= total
        return result

    def as_dict(self) -> dict[str, float]:
        """Seconds by stage and in total."""
        return {**self.seconds, "total": self._clock() - self._start}
