"""Runs of a study: each in a process of its own, so that time and memory are its own.

Every run prints one line of JSON. This application and methods that use one process get all cores
through the threads of BLAS; methods that gain from ranks get one rank per core.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any


class RunError(RuntimeError):
    """A run failed or ran out of time; the message is a short reason."""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0))


def python(
    *arguments: str, limit: float | None = None, ranks: int = 1, threads: int | None = None
) -> dict[str, Any]:
    """Run Python as `output` does, and return the JSON of its last line.

    Raises
    ------
    RunError
        As `output`, or there is no JSON.
    """
    try:
        text = output(*arguments, limit=limit, ranks=ranks, threads=threads)
        result: dict[str, Any] = json.loads(text.strip().splitlines()[-1])
    except (IndexError, json.JSONDecodeError):
        raise RunError("it printed no result") from None
    return result


def output(
    *arguments: str,
    limit: float | None = None,
    ranks: int = 1,
    threads: int | None = None,
    directory: Path | None = None,
) -> str:
    """Run Python with arguments on some ranks, and return all that it prints.

    Parameters
    ----------
    limit
        Seconds after which the run is ended.
    threads
        Threads of BLAS on each rank; unless given, the ranks share all cores.
    directory
        Where it runs; the modules of a checkout there are imported.

    Raises
    ------
    RunError
        The exit code is not zero, or the time limit is reached.
    """
    environment = dict(os.environ)
    command: list[str] = [sys.executable, *arguments]
    if ranks > 1 and threads is None:
        threads = max(1, cores() // ranks)
    if threads is not None:
        environment |= {"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    if ranks > 1:
        environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
        command = ["mpirun", "--oversubscribe", "--bind-to", "none", "--mca", "btl", "^tcp",
                   "-n", str(ranks), *command]  # fmt: skip
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=directory,
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        raise RunError(f"not done after {limit:g} s") from None
    finally:
        _end(process)
    if process.returncode:
        lines = err.strip().splitlines() or [f"exit code {process.returncode}"]
        telling = [one for one in lines if "Error" in one] or lines  # mpirun adds its own lines
        raise RunError(telling[-1][:200])
    return out


def parallel_ranks() -> int:
    """Number of ranks for methods that gain from them: one per core if ``mpirun`` exists."""
    return cores() if shutil.which("mpirun") else 1


def _end(process: subprocess.Popen[str]) -> None:
    """End a process with the ranks it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.communicate(timeout=5)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
