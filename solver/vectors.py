"""Inner products over all ranks, and blocks of vectors for cache-sized operations.

A distributed vector is the array of this rank's components. Everything global in the solvers
goes through :class:`Reduction`: one collective operation reduces all sums and the minimum of a
pass.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]
Vector = NDArray[np.float64]  # of one dimension
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
Action = Callable[[PETSc.Vec, PETSc.Vec], None]

#: Components a block holds: ten vectors of a block fit a second-level cache, so that a pass of
#: several elementwise operations, block by block, reads the vectors from memory once.
BLOCK = 8192


def on_arrays(action: Action, source: PETSc.Vec, x: Vector, target: PETSc.Vec, out: Vector) -> None:
    """Apply a PETSc action to the arrays x and out, lent to two PETSc vectors without copies.

    Parameters
    ----------
    action
        Called with the two vectors, for example a product or a solve.
    """
    source.placeArray(x)
    target.placeArray(out)
    try:
        action(source, target)
    finally:
        source.resetArray()
        target.resetArray()


def blocks(size: int, block: int = BLOCK) -> Iterator[slice]:
    """Slices that cut ``range(size)`` into blocks; one (empty) block when size is 0.

    >>> list(blocks(5, 2))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    for start in range(0, max(size, 1), block):
        yield slice(start, min(start + block, size))


class Reduction:
    """Sums and minima over the ranks of a communicator, several in one collective.

    Every rank gathers the partial results and adds them in the order of ranks, so that all
    ranks hold the same bits and take the same branches.
    """

    WIDTH = 12

    def __init__(self, comm: MPI.Comm) -> None:
        self.comm = comm
        self._serial = comm.size == 1
        self._send = np.zeros(self.WIDTH)
        self._receive = np.zeros((comm.size, self.WIDTH))

    def sums(self, *values: float) -> list[float]:
        """Sum of each value over the ranks."""
        return self.sums_and_minimum(values, math.inf)[0]

    def sums_and_minimum(
        self, values: tuple[float, ...] | list[float], minimum: float
    ) -> tuple[list[float], float]:
        """Sums of ``values`` and the least ``minimum``, in one collective."""
        if self._serial:
            return [float(value) for value in values], float(minimum)
        count = len(values)
        self._send[:count] = values
        self._send[count] = minimum
        self.comm.Allgather(self._send, self._receive)
        totals = self._receive[:, :count].sum(axis=0)
        return totals.tolist(), float(self._receive[:, count].min())

    def norm(self, vector: Vector) -> float:
        """Euclidean norm of a distributed vector."""
        return math.sqrt(self.sums(float(np.dot(vector, vector)))[0])

    def offset(self, size: int) -> int:
        """Global number of this rank's first component."""
        return sum(self.comm.allgather(size)[: self.comm.rank])

    def argmax(self, values: Vector) -> int:
        """Global number of the largest component; the smallest number of several."""
        offset = self.offset(values.size)
        local = int(np.argmax(values)) if values.size else 0
        best = (float(values[local]), -(offset + local)) if values.size else (-math.inf, 0)
        return -max(self.comm.allgather(best))[1]

    def first(self, mask: Mask) -> int | None:
        """Global number of the first true component, or None."""
        offset = self.offset(mask.size)
        local = [offset + int(np.argmax(mask))] if mask.any() else []
        numbers = [number for part in self.comm.allgather(local) for number in part]
        return min(numbers) if numbers else None


def runs(begins: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Runs of consecutive numbers: for each begin, `counts` numbers from it on."""
    ends = np.cumsum(counts)
    nth = np.arange(ends[-1] if len(ends) else 0)
    return np.asarray(np.repeat(begins - (ends - counts), counts) + nth)


def largest_magnitude(comm: MPI.Intracomm, *arrays: NDArray[np.float64]) -> float:
    """Largest magnitude over all ranks (collective)."""
    local = max((float(np.abs(a).max()) for a in arrays if a.size), default=0.0)
    return float(comm.allreduce(local, op=MPI.MAX))
