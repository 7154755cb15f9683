"""Progress of a run: a live line on a terminal, plain lines in a pipe.

A monitor is a callable that gets every step of the solver and may return True to stop it.
`Progress`, `Interruption` and `contact_app.results.history.History` are monitors; `together` joins
several.
"""

import logging
import signal
import time
from types import FrameType
from typing import Any

from mpi4py import MPI
from rich.console import Console
from rich.live import Live
from rich.text import Text

from solver.qp.result import Counts, Monitor, Step

LIVE_SECONDS, PLAIN_SECONDS, OUTER_SECONDS = 0.1, 2.0, 0.2
"""Seconds between updates.

Of the line on a terminal, of lines in a pipe, and of lines on outer iterations.
"""

log = logging.getLogger("contact_app")


def together(*monitors: Monitor | None) -> Monitor:
    """One monitor for several: each gets every step, and any of them can stop the solver."""
    present = [monitor for monitor in monitors if monitor is not None]

    def monitor(event: Step) -> bool:
        answers = [bool(each(event)) for each in present]  # every monitor has to get the step
        return any(answers)

    return monitor


class Counting:
    """A monitor that counts the work of a solve, known also if it ends without an answer.

    Attributes
    ----------
    counts
        Of the steps so far.
    """

    OF_STEP = {
        "cg": Counts(hessian=1, cg=1),
        "expansion": Counts(hessian=2, expansion=1),
        "proportioning": Counts(hessian=1, proportioning=1),
    }

    def __init__(self) -> None:
        self.counts = Counts()

    def __call__(self, step: Step) -> None:
        """Count a step."""
        self.counts += self.OF_STEP.get(step.type, Counts(hessian=1))


class Progress:
    """Shows stages and solver steps; used as a context manager.

    Parameters
    ----------
    show
        False on ranks other than the first: nothing is shown there.
    console
        Output; standard error by default. A terminal gets one line that is rewritten. Other files
        get a line every few seconds, and one per outer iteration that takes long. The log has all
        lines.
    """

    def __init__(
        self,
        show: bool = True,
        console: Console | None = None,
        outer_seconds: float = OUTER_SECONDS,
    ) -> None:
        self._outer_seconds = outer_seconds
        self._show = show
        self._console = console or Console(stderr=True, highlight=False)
        self._live: Live | None = None
        self._shown = -PLAIN_SECONDS
        self._last: Step | None = None
        self._waiting = False

    def __enter__(self) -> "Progress":
        console = self._console
        if self._show and console.is_terminal and not console.is_dumb_terminal:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(self, *ended: object) -> None:
        self._say_last()
        if self._live is not None:
            self._live.stop()
            self._live = None

    def stage(self, name: str) -> None:
        """Show that a stage of the run begins, such as "assembling"."""
        if not self._show:
            return
        log.info("%s", name)
        self._say_last()
        self._line(f"{name} ...")

    def __call__(self, event: Step) -> None:
        """Show a step, unless the last one was shown a moment ago."""
        if not self._show:
            return
        begins = self._last is None or event.outer != self._last.outer
        if begins and self._last is not None:
            log.info("%s", _sentence(self._last))
        self._last = event
        now = time.monotonic()
        elapsed = now - self._shown
        if self._live is not None:
            due = elapsed >= LIVE_SECONDS
        else:
            due = elapsed >= (self._outer_seconds if begins else PLAIN_SECONDS)
        self._waiting = not due
        if due:
            self._shown = now
            self._line(_sentence(event))

    def _say_last(self) -> None:
        """In a pipe, show the last step of a stage if it was left out."""
        if self._waiting and self._last is not None and self._live is None:
            self._line(_sentence(self._last))
        self._waiting = False

    def _line(self, text: str) -> None:
        if self._live is not None:
            self._live.update(Text(text, overflow="ellipsis", no_wrap=True), refresh=True)
        else:
            self._console.print(text, soft_wrap=True, markup=False)


def _sentence(event: Step) -> str:
    """One line, short enough for a terminal."""
    parts = [f"outer {event.outer}"] if event.outer else []
    parts += [f"iteration {event.iteration}", f"residual {event.projected_gradient_norm:.1e}"]
    if event.equality_residual:
        parts.append(f"equalities {event.equality_residual:.1e}")
    parts += [f"active {event.active}", f"{event.seconds:.1f} s"]
    return ", ".join(parts)


class Interruption:
    """A monitor that stops the solve after Ctrl-C or SIGTERM, so that results are written.

    The second signal ends the program at once.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interruption":
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                self._before[number] = signal.signal(number, self._ask)
            except ValueError:  # not in the main thread: signals belong to the caller
                break
        return self

    def __exit__(self, *ended: object) -> None:
        self._restore()

    def __call__(self, event: Step) -> bool:
        """Whether to stop."""
        return self.requested

    def requested_by_any(self, comm: MPI.Intracomm) -> bool:
        """Whether any rank was interrupted (collective)."""
        return bool(comm.allreduce(self.requested, op=MPI.LOR))

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        log.warning("asked to stop by signal %d: partial results are saved", number)
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()
