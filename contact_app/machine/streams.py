"""Standard streams that are closed, full, or limited to ASCII.

A program is started with a stream closed (``>&-``), with one that a reader closes (``| head``), or
with one that cannot encode what is written. None of these must lose a solved scene.

- A closed descriptor 0, 1 or 2 is put on the null device. Otherwise the next file to be opened
  would get its number, and libraries that print to it would write into a file of results.
- Output to a pipe without a reader is dropped, and so is output that standard error cannot take.
- A character that is missing in the encoding is replaced by a question mark.
"""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO


class _Output(io.FileIO):
    """An output stream that drops what nobody reads, and all output after an error."""

    def __init__(self, descriptor: int, strict: bool) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._strict = strict

    def write(self, data) -> int:  # type: ignore[no-untyped-def, override]
        try:
            return super().write(data) or 0
        except OSError as error:
            _to_null(self.fileno())
            if self._strict and error.errno not in (errno.EPIPE, errno.EBADF):
                raise OSError(error.errno, error.strerror, "standard output") from error
            return memoryview(data).nbytes


@contextmanager
def safe_streams() -> Iterator[None]:
    """Context manager that replaces the standard streams.

    An error of standard output, other than a pipe without a reader, is still raised: its output is
    lost. Streams that another program has replaced, such as pytest, stay.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            _to_null(descriptor)
    before = sys.stdin, sys.stdout, sys.stderr
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    if sys.stdout in (None, sys.__stdout__):
        sys.stdout = _text(1, sys.stdout, strict=True)
    if sys.stderr in (None, sys.__stderr__):
        sys.stderr = _text(2, sys.stderr, strict=False)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        if before[1] is not None and before[2] is not None:
            sys.stdin, sys.stdout, sys.stderr = before


def _text(descriptor: int, before: TextIO | None, strict: bool) -> TextIO:
    """A text stream on a descriptor, with the encoding of the one it replaces."""
    if before is not None:
        with suppress(OSError):
            before.flush()
    encoding = (before.encoding if before is not None else None) or "utf-8"
    raw = _Output(descriptor, strict)
    through = descriptor == 2 or bool(getattr(before, "write_through", False))
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding, "replace", line_buffering=raw.isatty() or through
    )


def _to_null(descriptor: int) -> None:
    """Connect a descriptor to the null device."""
    null = os.open(os.devnull, os.O_RDWR)
    if null != descriptor:
        os.dup2(null, descriptor)
        os.close(null)
    os.set_inheritable(descriptor, True)
