"""Distributed vectors in one file, in the order of their rows.

Rank 0 writes and reads the parts of all ranks one after another, so that it holds one part at a
time and disk errors occur on one rank only. Numbers are little-endian of 8 bytes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

NUMBER = np.dtype("<f8")


def write_vectors(path: Path, comm: MPI.Intracomm, vectors: list[NDArray[np.float64]]) -> None:
    """Write vectors of one size, one after another (collective).

    Parameters
    ----------
    vectors : list of (local rows,)

    Raises
    ------
    OSError
        On all ranks; the file is removed.
    """
    sizes = comm.gather(len(vectors[0]))
    if sizes is None:
        for vector in vectors:
            comm.Send(np.ascontiguousarray(vector, NUMBER), dest=0)
        fault = None
    else:
        fault = _write_first(path, comm, vectors, sizes)
    fault = comm.bcast(fault)
    if fault is not None:
        raise fault


def _write_first(
    path: Path, comm: MPI.Intracomm, vectors: list[NDArray[np.float64]], sizes: list[int]
) -> OSError | None:
    """Rank 0: write what all ranks send, and go on receiving after an error."""
    fault: OSError | None = None
    try:
        file = path.open("wb")
    except OSError as error:
        file, fault = None, error
    for vector in vectors:
        for rank, size in enumerate(sizes):
            part = np.ascontiguousarray(vector, NUMBER) if rank == 0 else np.empty(size, NUMBER)
            if rank > 0:
                comm.Recv(part, source=rank)
            try:
                if file is not None and fault is None:
                    part.tofile(file)
            except OSError as error:
                fault = error
    try:
        if file is not None:
            file.close()
    except OSError as error:
        fault = fault or error
    if fault is not None:
        path.unlink(missing_ok=True)
    return fault


def read_vectors(
    path: Path, comm: MPI.Intracomm, size: int, count: int
) -> list[NDArray[np.float64]]:
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
    sizes = comm.allgather(size)
    vectors = np.empty((count, size), NUMBER)
    fault: OSError | ValueError | None = None
    if comm.rank == 0:
        try:
            if path.stat().st_size != NUMBER.itemsize * count * sum(sizes):
                raise ValueError(f"{path.name} has not the size of {count} vectors")
            shape = count, sum(sizes)
            data = np.memmap(path, NUMBER, "r", shape=shape) if sum(sizes) else vectors
        except (OSError, ValueError) as error:
            fault = error
    fault = comm.bcast(fault)
    if fault is not None:
        raise fault
    if comm.rank > 0:
        comm.Recv(vectors, source=0)
        return [np.array(row, np.float64) for row in vectors]
    ends = np.cumsum(sizes)
    for rank in range(1, comm.size):
        comm.Send(np.ascontiguousarray(data[:, ends[rank - 1] : ends[rank]]), dest=rank)
    return [np.array(row, np.float64) for row in data[:, :size]]
