"""Programs on one rank or several: in processes of their own, or on ranks that wait for them."""

import atexit
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests import rank_pool

ROOT = Path(__file__).resolve().parents[1]

ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


def command(*arguments: str, ranks: int) -> list[str]:
    """`mpirun -n ranks python …`; one rank without mpirun."""
    alone = [sys.executable, *arguments]
    return alone if ranks == 1 else ["mpirun", "--oversubscribe", "-n", str(ranks), *alone]


def python(*arguments: str, ranks: int, limit: float) -> subprocess.CompletedProcess[str]:
    """`mpirun -n ranks python …` from the root of the project, where its end is the question.

    Parameters
    ----------
    limit
        Seconds after which the test fails.
    """
    return subprocess.run(
        command(*arguments, ranks=ranks), capture_output=True, text=True, timeout=limit, cwd=ROOT,
        env={**os.environ, **ENVIRONMENT},
    )  # fmt: skip


def execute(program: str, *arguments: str, ranks: int, limit: float = 180.0) -> str:
    """Output of a Python program, rank by rank; an error of any rank is raised here.

    Parameters
    ----------
    program
        Its text; it finds the arguments in ``sys.argv``, from the second on.
    ranks
        One: it runs in this process. More: on ranks that earlier programs have left waiting.
    limit
        Seconds after which it fails.
    """
    if ranks == 1:
        known = sys.argv
        try:
            printed, error = rank_pool.run(program, list(arguments))
        finally:
            sys.argv = known
        assert not error, error
        return printed
    if ranks not in _pools:
        _pools[ranks] = _Pool(ranks)
    try:
        return _pools[ranks].execute(program, arguments, limit)
    except AssertionError:
        _pools.pop(ranks).end()  # its ranks may wait for one another
        raise


class _Pool:
    """Ranks of `tests.rank_pool`."""

    def __init__(self, ranks: int) -> None:
        self.ranks, self.number = ranks, 0
        self.directory = Path(tempfile.mkdtemp(prefix="ranks"))
        self.log = (self.directory / "log").open("w+")
        program = ["-m", "tests.rank_pool", str(self.directory), str(os.getpid())]
        self.process = subprocess.Popen(
            command(*program, ranks=ranks), cwd=ROOT, env={**os.environ, **ENVIRONMENT},
            stdin=subprocess.DEVNULL, stdout=self.log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        atexit.register(self.end)

    def execute(self, program: str, arguments: tuple[str, ...], limit: float) -> str:
        asked = self.directory / "asked"
        asked.write_text(json.dumps([program, arguments]))
        asked.rename(self.directory / f"{self.number}.json")
        waiting = [self.directory / f"{self.number}.{rank}.json" for rank in range(self.ranks)]
        self.number += 1
        printed, until = {}, time.monotonic() + limit
        while len(printed) < self.ranks:
            time.sleep(rank_pool.PAUSE)
            for path in waiting:
                if path not in printed and path.exists():
                    printed[path], error = json.loads(path.read_text())
                    assert not error, error
            assert self.process.poll() is None, f"the ranks have ended: {self._said()}"
            assert time.monotonic() < until, f"no end after {limit} s: {self._said()}"
        return "".join(printed[path] for path in waiting)

    def _said(self) -> str:
        self.log.seek(0)
        return self.log.read()[-3000:]

    def end(self) -> None:
        atexit.unregister(self.end)
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.log.close()
        shutil.rmtree(self.directory)


_pools: dict[int, _Pool] = {}
