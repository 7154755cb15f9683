"""Counts of the messages between ranks during a solve.

PETSc counts the messages and bytes of its halo exchanges (of B and Bᵀ, and the scatters around the
coarse factor); the solver counts its sums over all ranks. The messages of MUMPS for the coarse
factor are not counted.
"""

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from solver import Counts

HALO = "VecScatterBegin"
"""PETSc's event in which a halo exchange is posted."""


class Communication:
    """Counts between its creation and `per_multiplication`; costs nothing on a single rank."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm
        if comm.size > 1:
            PETSc.Log.begin()
        self._before = self._messages()

    def _messages(self) -> Any:
        if self.comm.size == 1:
            return np.zeros(2)
        event = PETSc.Log.Event(HALO).getPerfInfo()
        return np.array([event["numMessages"], event["messageLength"]])

    def per_multiplication(self, counts: Counts) -> dict[str, float] | None:
        """Messages, bytes and sums for each Hessian multiplication, over all ranks (collective).

        None on a single rank.
        """
        if self.comm.size == 1:
            return None
        # PETSc counts what is sent and what is received
        messages, length = 0.5 * self.comm.allreduce(self._messages() - self._before)
        multiplications = max(counts.hessian, 1)
        return {
            "messages": round(messages / multiplications, 1),
            "bytes": round(length / multiplications, 1),
            "reductions": round(counts.collectives / multiplications, 1),
        }
