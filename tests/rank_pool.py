"""Ranks that wait for programs: ``mpirun -n 2 python -m tests.rank_pool DIRECTORY PID``.

Interpreters start once and not for each test. Program number n is ``n.json`` in the directory, and
each rank leaves what it printed and its error, if any, in ``n.RANK.json``. The ranks end when the
process PID has ended.
"""

import contextlib
import io
import json
import os
import shutil
import sys
import time
import traceback
from itertools import count
from pathlib import Path

from mpi4py import MPI

PAUSE = 0.01
"""Seconds between two looks; a barrier of MPI would keep the cores busy."""


def run(program: str, arguments: list[str]) -> tuple[str, str]:
    """Output of a program, and the traceback of its error or nothing."""
    printed, error = io.StringIO(), ""
    sys.argv = ["-c", *arguments]
    with contextlib.redirect_stdout(printed):
        try:
            exec(compile(program, "program on ranks", "exec"), {"__name__": "__main__"})
        except BaseException:
            error = traceback.format_exc()
    return printed.getvalue(), error


def lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def serve(directory: Path, owner: int) -> None:
    for number in count():
        asked = directory / f"{number}.json"
        while not asked.exists():
            time.sleep(PAUSE)
            if not lives(owner):  # a process of pytest-xdist ends without clearing up
                shutil.rmtree(directory, ignore_errors=True)
                return
        told = directory / f"{number}.{MPI.COMM_WORLD.rank}"
        told.write_text(json.dumps(run(*json.loads(asked.read_text()))))
        told.rename(told.with_suffix(f"{told.suffix}.json"))  # there as a whole or not at all


if __name__ == "__main__":
    serve(Path(sys.argv[1]), int(sys.argv[2]))
