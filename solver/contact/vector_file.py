"""Distributed vectors in one file, in the order of their rows.

Rank 0 writes and reads the parts of all ranks, so that disk errors occur on one rank only. Numbers
are little-endian of 8 bytes.
"""

from pathlib import Path

import numpy as np
from mpi4py import MPI

from solver.vectors import Array

NUMBER = np.dtype("<f8")


def write_vectors(path: Path, comm: MPI.Intracomm, vectors: list[Array]) -> None:
    """Write vectors of one size, one after another (collective).

    Parameters
    ----------
    vectors : list of (local rows,)

    Raises
    ------
    OSError
        On all ranks; the file is removed.
    """
    parts, fault = comm.gather(np.array(vectors, NUMBER)), None
    if parts is not None:
        try:
            with path.open("wb") as file:
                for number in range(len(vectors)):
                    for part in parts:
                        part[number].tofile(file)
        except OSError as error:
            path.unlink(missing_ok=True)
            fault = error
    fault = comm.bcast(fault)
    if fault is not None:
        raise fault


def read_vectors(path: Path, comm: MPI.Intracomm, size: int, count: int) -> list[Array]:
    """Read vectors that `write_vectors` wrote (collective).

    Parameters
    ----------
    size
        Rows of this rank.
    count
        Number of vectors.

    Raises
    ------
    OSError, ValueError
        On all ranks; ValueError where the file has another size.
    """
    sizes = comm.gather(size)
    parts: list[Array] | None = None
    fault: OSError | ValueError | None = None
    if sizes is not None:
        try:
            data = np.fromfile(path, NUMBER)
            if len(data) != count * sum(sizes):
                raise ValueError(f"{path.name} has not the size of {count} vectors")
            parts = np.split(data.reshape(count, -1), np.cumsum(sizes)[:-1], axis=1)
        except (OSError, ValueError) as error:
            fault = error
    fault = comm.bcast(fault)
    if fault is not None:
        raise fault
    return list(comm.scatter(parts).astype(np.float64))
