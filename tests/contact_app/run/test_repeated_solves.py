"""Solving again and again, as charts and studies do, must not eat memory.

petsc4py 3.18 keeps objects that Python's garbage collector finds until it is told otherwise; a
solve that leaves its vectors and factors to it grows without bound.
"""

import gc
from pathlib import Path

import pytest

from tests import scenes
from tests.comparison import solve

STATM = Path("/proc/self/statm")


def resident_megabytes() -> float:
    gc.collect()
    return int(STATM.read_text().split()[1]) * 4096 / 1e6


@pytest.mark.skipif(not STATM.exists(), reason="reads the memory of a process from /proc")
@pytest.mark.parametrize("subdomains", [1, [3, 3, 3]], ids=str)
def test_memory_does_not_grow(subdomains: int | list[int]) -> None:
    """Less than half a megabyte a solve; the vectors of one solve are several.

    The heap of a process that has run other tests may grow once, but not in three series of solves.
    """
    made = scenes.wall("hexahedron", 6)
    for _ in range(3):
        solve(made, subdomains)
    grown: list[float] = []
    while len(grown) < 3 and min(grown, default=6.0) >= 6.0:
        before = resident_megabytes()
        for _ in range(12):
            solve(made, subdomains)
        grown.append(resident_megabytes() - before)
    assert min(grown) < 6.0
