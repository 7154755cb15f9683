"""Exchange between the copies of shared nodes and the ranks that own the nodes.

A node on the interface of subdomains has a copy in each of them, and the subdomains may live on
different ranks. Each rank owns consecutive node numbers, as PETSc distributes rows. Data of the
copies travel to the owner, and results travel back.
"""

from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.vectors import Ints


class NodeExchange:
    """Two-way exchange between copies of nodes and the owners of the nodes.

    Parameters
    ----------
    nodes : (copies,)
        Global number of the node each local copy stands for.
    total
        Nodes in all.
    starts : (ranks + 1,)
        First number that each rank owns, and `total`; by default rank r owns the numbers from
        ``total * r // size`` on.

    Attributes
    ----------
    starts : (ranks + 1,)
        First number that each rank owns, and `total`.
    nodes : (arrived,)
        Node numbers of the copies that arrived at this rank, the owner; ordered by their rank of
        origin, and for each rank as on that rank.
    local : (kept,)
        Copies on this rank of nodes that it owns.
    local_part
        Places of these copies among the arrived copies.
    """

    def __init__(
        self, comm: MPI.Intracomm, nodes: Ints, total: int, starts: Ints | None = None
    ) -> None:
        self.comm = comm
        self.total = total
        if starts is None:
            starts = total * np.arange(comm.size + 1, dtype=np.int64) // comm.size
        self.starts = starts
        owner = np.searchsorted(starts, nodes, side="right") - 1
        self.first, self.last = int(starts[comm.rank]), int(starts[comm.rank + 1])
        self._copies = len(nodes)
        self._of_rank = [np.flatnonzero(owner == rank) for rank in range(comm.size)]
        self.local: Ints = self._of_rank[comm.rank]
        self._of_rank[comm.rank] = self.local[:0]  # most copies stay on their rank
        arrived = comm.alltoall([nodes[copies] for copies in self._of_rank])
        arrived[comm.rank] = nodes[self.local]
        self._ends = np.cumsum([0, *map(len, arrived)])
        self.local_part = slice(*map(int, self._ends[comm.rank : comm.rank + 2]))
        self.nodes: Ints = np.concatenate(arrived)

    @cached_property
    def copies_of_nodes(self) -> tuple[Ints, Ints, Ints, Ints]:
        """Order (arrived,) that sorts the arrived copies by node; nodes, first copies and counts.

        The latter three are (owned nodes with copies,); the first copy is the place in that order.
        """
        order = np.argsort(self.nodes, kind="stable")
        distinct = np.unique(self.nodes[order], return_index=True, return_counts=True)
        return order, *distinct

    def among(self, nodes: Ints) -> "NodeExchange":
        """An exchange for other copies of the same nodes, with the same owners (collective)."""
        return NodeExchange(self.comm, nodes, self.total, self.starts)

    def to_owners(self, values: NDArray) -> NDArray:
        """Send one value (or row) per copy to the owners: (copies, …) to (arrived, …)."""
        if self.comm.size == 1:
            return values.copy()
        result = np.empty((len(self.nodes), *values.shape[1:]), values.dtype)
        others = self.of_others(values)
        result[: self.local_part.start] = others[: self.local_part.start]
        np.take(values, self.local, 0, out=result[self.local_part], mode="clip")
        result[self.local_part.stop :] = others[self.local_part.start :]
        return result

    def of_others(self, values: NDArray) -> NDArray:
        """The part of `to_owners` that comes from other ranks, (arrived - kept, …)."""
        return np.concatenate(self.comm.alltoall([values[copies] for copies in self._of_rank]))

    def from_owners(self, values: NDArray) -> NDArray:
        """Send one value (or row) per arrived copy back: (arrived, …) to (copies, …)."""
        if self.comm.size == 1:
            return values.copy()
        parts = np.split(values, self._ends[1:-1])
        parts[self.comm.rank] = values[:0]
        result = np.empty((self._copies, *values.shape[1:]), values.dtype)
        result[self.local] = values[self.local_part]
        for copies, part in zip(self._of_rank, self.comm.alltoall(parts), strict=True):
            result[copies] = part
        return result
