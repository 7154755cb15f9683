"""``history.csv``: one row for each inner iteration of a solve.

`active` counts the components of the problem at a bound, `active_rows` the contact rows that are
closed: those of the active set, or in SMALBE-M and MPRGP those whose multiplier is positive.
`seconds` begin with each solve of the method, `total_seconds` with the run. Of a load history
`increment` is the number of the increment.
"""

import logging
import time
from pathlib import Path
from typing import TextIO

from solver.qp.result import Step

log = logging.getLogger("contact_app")

COLUMNS = (
    "outer",
    "iteration",
    "step",
    "projected_gradient",
    "equality_residual",
    "active",
    "seconds",
    "active_set",
    "active_rows",
    "total_seconds",
)

FLUSH_SECONDS = 1.0
"""Seconds after which rows are flushed to disk, for interrupted runs."""


class History:
    """A monitor that writes each inner iteration to a CSV file.

    Parameters
    ----------
    path
        The file; None on ranks that write none, where the monitor does nothing.
    go_on
        Whether to keep the rows of the earlier run of a resumed one.
    increments
        Of a load history: a last column has the number of the increment.

    Attributes
    ----------
    increment
        Number of the present increment.
    """

    def __init__(
        self,
        path: Path | None,
        go_on: bool = False,
        flush_seconds: float = FLUSH_SECONDS,
        increments: bool = False,
    ) -> None:
        self._increments, self.increment = increments, 0
        self._flush_seconds = flush_seconds
        self._file: TextIO | None = None
        self._began = self._flushed = time.monotonic()
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            go_on = go_on and path.is_file()
            self._file = path.open("a" if go_on else "w", encoding="utf-8")
            try:
                if not go_on:
                    more = ("increment",) if increments else ()
                    self._file.write(",".join((*COLUMNS, *more)) + "\n")
                self._file.flush()
            except OSError:  # otherwise Python's collector would fail at the full disk once more
                self.close()
                raise

    def __enter__(self) -> "History":
        return self

    def __exit__(self, *ended: object) -> None:
        self.close()

    def __call__(self, event: Step) -> None:
        """Write one row; the start of an outer iteration writes none."""
        if self._file is None or event.type == "start":
            return
        try:
            self._write(event)
        except OSError as error:  # a full disk must not end the solve
            log.warning("history.csv ends here: %s", error.strerror)
            self.close()

    def _write(self, event: Step) -> None:
        assert self._file is not None
        now, rows = time.monotonic(), "" if event.active_rows is None else event.active_rows
        self._file.write(
            f"{event.outer},{event.iteration},{event.type},{event.projected_gradient_norm:.9e},"
            f"{event.equality_residual:.9e},{event.active},{event.seconds:.6f},{event.active_set},"
            f"{rows},{now - self._began:.6f}"
            + (f",{self.increment}\n" if self._increments else "\n")
        )
        if now - self._flushed >= self._flush_seconds:
            self._file.flush()
            self._flushed = now

    def close(self) -> None:
        """Write the remaining rows and close the file; further calls do nothing."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                log.warning("history.csv is incomplete: %s", error.strerror)
