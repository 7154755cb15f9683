"""Work that every rank needs the result of, done once: each rank a part, then all tell all."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

Make = Callable[[], NDArray[np.float64]]


def made_together(
    comm: MPI.Intracomm | None, makers: Sequence[Make], shapes: Sequence[tuple[int, ...]]
) -> list[NDArray[np.float64]]:
    """Arrays that are the same on all ranks, made in turns (collective).

    Parameters
    ----------
    comm
        The ranks that make the same; None where this one is alone.
    makers, shapes
        How each array is made, and its shape.

    Raises
    ------
    ArithmeticError, numpy.linalg.LinAlgError
        A maker did, here or, as a LinAlgError, on another rank.
    """
    if comm is None or comm.size == 1:
        return [make() for make in makers]
    made: dict[int, NDArray[np.float64]] = {}
    failure: Exception | None = None
    try:
        for k in range(comm.rank, len(makers), comm.size):
            made[k] = np.ascontiguousarray(makers[k]())
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        failure = error
    if comm.allreduce(int(failure is not None)):
        raise failure or np.linalg.LinAlgError("another rank's block could not be made")
    result = []
    for k, shape in enumerate(shapes):
        array = made[k] if k in made else np.empty(shape)
        comm.Bcast(array, root=k % comm.size)
        result.append(array)
    return result
