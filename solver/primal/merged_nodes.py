"""The nodes of the undecomposed problem: nodes that subdomains share count once.

They keep the order of their subdomains, so that the stiffness of subdomains that share no nodes is
not renumbered: with one subdomain for each body that took most of the time of the merge. Each rank
owns a run of about equally many nodes, whichever rank holds the subdomains: of two bodies on two
ranks one is often half as large as the other. Neighbours in the order of dolfinx are near in the
body.
"""

from itertools import pairwise
from typing import TypeVar

import numpy as np
from scipy import sparse

from solver.exchange import NodeExchange
from solver.problem.decomposed import DecomposedProblem
from solver.vectors import Array, Ints, Mask

UNEVEN = 1.05
"""Most nodes of a rank over their mean from which on the nodes are divided anew."""

Rows = TypeVar("Rows", Ints, Array, Mask, sparse.csr_matrix)


class MergedNodes:
    """Every node once: numbers, ranks and copies of the nodes of all subdomains (collective).

    Attributes
    ----------
    copies : one (members, nodes) array per class
        Place of each copy among the distinct nodes of this rank.
    numbers : (distinct,)
        Merged number of each distinct node; a rank owns consecutive ones.
    points : (distinct, 3)
    body : (distinct,)
    first_here : (distinct,)
        Whether no rank before this one has the node.
    shared
        Whether some node is on several ranks.
    count
        Number of nodes that this rank owns.
    """

    def __init__(self, problem: DecomposedProblem) -> None:
        comm, places = problem.comm, problem.places
        every = [p.numbers.ravel() for p in places]
        unique, inverse = _distinct(np.concatenate([np.zeros(0, np.int64), *every]))
        ends = np.cumsum([0, *map(len, every)])
        self.copies = [
            inverse[a:b].reshape(p.numbers.shape)
            for a, b, p in zip(ends[:-1], ends[1:], places, strict=True)
        ]
        self.points = np.zeros((len(unique), 3))
        self.body = np.zeros(len(unique), np.int64)
        for at, p, body in zip(self.copies, places, problem.bodies.members, strict=True):
            self.points[at] = p.points + p.translations[:, None]
            self.body[at] = body[:, None]
        exchange = NodeExchange(comm, unique, problem.nodes)
        where = exchange.nodes - exchange.first
        lowest = np.full(exchange.last - exchange.first, comm.size)
        ranks = exchange.to_owners(np.full(len(unique), comm.rank))
        np.minimum.at(lowest, where, ranks)
        self.first_here = exchange.from_owners(lowest[where]) == comm.rank
        counts = comm.allgather(int(self.first_here.sum()))
        ends = np.cumsum([0, *counts])
        self.shared = bool(comm.allreduce(len(unique)) > ends[-1])
        self.numbers = np.full(len(unique), -1)
        self.numbers[self.first_here] = np.arange(*ends[comm.rank : comm.rank + 2])
        numbers = np.full(len(lowest), -1)
        np.maximum.at(numbers, where, exchange.to_owners(self.numbers))
        self.numbers = exchange.from_owners(numbers[where])
        starts = ends
        # unknowns of rigid bodies stay together, on the last rank
        if max(counts) * comm.size > UNEVEN * ends[-1] and not problem.bodies.rigid.any():
            starts = ends[-1] * np.arange(comm.size + 1) // comm.size
        self.count = int(starts[comm.rank + 1] - starts[comm.rank])
        self._comm, self._move = comm, bool((starts != ends).any())
        self._cuts = np.clip(starts, *ends[comm.rank : comm.rank + 2]) - ends[comm.rank]

    def at_owners(self, rows: Rows, each: int = 1) -> Rows:
        """Rows at the nodes that this rank has first, brought to the owners (collective).

        Parameters
        ----------
        rows : (nodes · each, …)
            An array or a sparse matrix, a number of rows for each node.
        """
        if not self._move:
            return rows
        parts = self._comm.alltoall([rows[a:b] for a, b in pairwise(each * self._cuts)])
        return sparse.vstack(parts, "csr") if sparse.issparse(rows) else np.concatenate(parts)

    def unknowns(self, nodes: Ints, dimension: int) -> Ints:
        """Unknowns of nodes, (…, nodes · dimension)."""
        spread = nodes[..., None] * dimension + np.arange(dimension)
        return np.asarray(spread.reshape(*nodes.shape[:-1], -1))


def _distinct(numbers: Ints) -> tuple[Ints, Ints]:
    """Distinct numbers in the order of their first appearance, and the place of each number."""
    unique, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return unique[order], place[inverse]
