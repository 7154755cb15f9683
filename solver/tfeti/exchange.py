"""Copies of shared nodes meet at the rank that owns the node.

A node on the interface of subdomains has a copy in each of them, and the subdomains may live on
different ranks. Nodes are owned by consecutive number, as PETSc owns rows; what is known of the
copies travels to the owner, and answers travel back the same way.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray


class NodeExchange:
    """Two-way exchange between copies of nodes and the owners of the nodes.

    Parameters
    ----------
    nodes : (copies,)
        Global number of the node each local copy stands for.
    total
        Nodes in all.
    starts : (ranks + 1,)
        First number each rank owns, and `total`; rank r owns those from ``total * r // size`` on
        unless given.

    Attributes
    ----------
    nodes : (arrived,)
        Node numbers of the copies that arrived at this rank, which owns them; ordered by the
        rank they come from and there as they were given.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        nodes: NDArray[np.int64],
        total: int,
        starts: NDArray[np.int64] | None = None,
    ) -> None:
        self.comm = comm
        self.total = total
        if starts is None:
            starts = total * np.arange(comm.size + 1, dtype=np.int64) // comm.size
        owner = np.searchsorted(starts, nodes, side="right") - 1
        self.first, self.last = int(starts[comm.rank]), int(starts[comm.rank + 1])
        self._order = np.argsort(owner, kind="stable")
        self._cuts = np.searchsorted(owner[self._order], np.arange(1, comm.size))
        arrived = self._sent(nodes[self._order], self._cuts)
        self._arrived_cuts = np.cumsum([len(a) for a in arrived])[:-1]
        self.nodes: NDArray[np.int64] = np.concatenate(arrived)

    def to_owners(self, values: NDArray) -> NDArray:
        """Bring one value (or row) a copy to the owners: (copies, …) to (arrived, …)."""
        if self.comm.size == 1:
            return values.copy()
        return np.concatenate(self._sent(values[self._order], self._cuts))

    def from_owners(self, values: NDArray) -> NDArray:
        """Bring one value (or row) an arrived copy back: (arrived, …) to (copies, …)."""
        if self.comm.size == 1:
            return values.copy()
        returned = np.concatenate(self._sent(values, self._arrived_cuts))
        result = np.empty_like(returned)
        result[self._order] = returned
        return result

    def _sent(self, values: NDArray, cuts: NDArray[np.int64]) -> list[NDArray]:
        """What all ranks have for this one; most of it, its own, is not copied into messages."""
        parts: list[NDArray | None] = list(np.split(values, cuts))
        own, parts[self.comm.rank] = parts[self.comm.rank], None
        arrived = self.comm.alltoall(parts)
        arrived[self.comm.rank] = own
        return arrived
