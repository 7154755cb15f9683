"""Shared work: each rank computes a part of arrays that all ranks need, then all are exchanged."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI

from solver.vectors import Array

Make = Callable[[], Array]


def made_together(
    comm: MPI.Intracomm | None, makers: Sequence[Make], shapes: Sequence[tuple[int, ...]]
) -> list[Array]:
    """Arrays that are equal on all ranks, each computed by one rank in turn (collective).

    Parameters
    ----------
    comm
        The ranks that share the work; None for this rank alone.
    makers, shapes
        Function that computes each array, and its shape.

    Raises
    ------
    ArithmeticError, numpy.linalg.LinAlgError
        If a maker raised it, on this rank or (as a LinAlgError) on another rank.
    """
    if comm is None or comm.size == 1:
        return [make() for make in makers]
    made: dict[int, Array] = {}
    failure: Exception | None = None
    try:
        for k in range(comm.rank, len(makers), comm.size):
            made[k] = np.ascontiguousarray(makers[k]())
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        failure = error
    if comm.allreduce(int(failure is not None)):
        raise failure or np.linalg.LinAlgError("the block of another rank could not be computed")
    result = []
    for k, shape in enumerate(shapes):
        array = made[k] if k in made else np.empty(shape)
        comm.Bcast(array, root=k % comm.size)
        result.append(array)
    return result
