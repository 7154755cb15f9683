"""Speed of the machine for several ranks: dense products and memory bandwidth.

``mpirun -n N python -m contact_app.studies.machine_speed`` prints the sum over ranks of both in a
line of JSON, in 10⁹ operations and 10⁹ bytes per second. No program limited by these two scales
better than they do.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

REPEATS = 20
ORDER, COLUMNS = 1806, 108
"""Size of the product: a dense block of a subdomain of 10³ cells times as many vectors."""

ENTRIES = 4_000_000
"""Length of each of three vectors, 32 MB."""


def rate(comm: MPI.Intracomm, work: float, do: Callable[[], object]) -> float:
    """Work per second of all ranks together; the fastest of `REPEATS`."""
    do()
    best = np.inf
    for _ in range(REPEATS):
        comm.barrier()
        began = time.perf_counter()
        do()
        best = min(best, time.perf_counter() - began)
    return float(comm.allreduce(work / best))


def measure(comm: MPI.Intracomm) -> dict[str, float]:
    """Rates of dense products and of a sum of vectors (collective)."""
    rng = np.random.default_rng(0)
    A, X = rng.random((ORDER, ORDER)), rng.random((ORDER, COLUMNS))
    Y = np.empty_like(X)
    x, y, z = (rng.random(ENTRIES) for _ in range(3))
    operations, moved = 2.0 * A.size * COLUMNS, 3.0 * z.nbytes
    return {
        "dense": rate(comm, 1e-9 * operations, lambda: np.matmul(A, X, out=Y)),
        "memory": rate(comm, 1e-9 * moved, lambda: np.add(x, y, out=z)),
    }


def main() -> None:
    """Print the rates."""
    found = measure(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
