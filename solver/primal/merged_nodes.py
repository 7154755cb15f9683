"""The nodes of the undecomposed problem: nodes that subdomains share count once.

They keep the order of their subdomains, so that the stiffness of subdomains that share no nodes is
not renumbered: with one subdomain for each body that took most of the time of the merge.
"""

from __future__ import annotations

import numpy as np

from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.decomposed import DecomposedProblem
from solver.vectors import Ints


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
    owned : (distinct,)
        Whether this rank owns the node.
    """

    def __init__(self, problem: DecomposedProblem) -> None:
        comm, places = problem.comm, problem.system.places
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
        exchange = NodeExchange(comm, unique, problem.system.nodes)
        where = exchange.nodes - exchange.first
        lowest = np.full(exchange.last - exchange.first, comm.size)
        ranks = exchange.to_owners(np.full(len(unique), comm.rank))
        np.minimum.at(lowest, where, ranks)
        self.owned = exchange.from_owners(lowest[where]) == comm.rank
        self.count = int(self.owned.sum())
        first = comm.exscan(self.count) or 0
        self.numbers = np.full(len(unique), -1)
        self.numbers[self.owned] = first + np.arange(self.count)
        numbers = np.full(len(lowest), -1)
        np.maximum.at(numbers, where, exchange.to_owners(self.numbers))
        self.numbers = exchange.from_owners(numbers[where])

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
