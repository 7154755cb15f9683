"""Work that ranks with the same data share, and results put together."""

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from meshes.arrays import Ints


def share(comm: MPI.Intracomm, count: int) -> Ints:
    """This rank's share of so many items: consecutive ones."""
    return np.array_split(np.arange(count), comm.size)[comm.rank]


def joined(comm: MPI.Intracomm, local: NDArray) -> NDArray:
    """The rows of all ranks, in the order of ranks (collective)."""
    return local if comm.size == 1 else np.concatenate(comm.allgather(local))
