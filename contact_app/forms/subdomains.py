"""The subdomains of forms: parts of a mesh, or sub-boxes that several ranks have cells of.

A rank assembles the forms over its own cells. Where these are part of a sub-box that another rank
has the subdomain of, the matrix and the load go there and are added: K = Σ_r K_r over the ranks,
with the nodes of the sub-box in the order of the lattice.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI
from scipy import sparse

from contact_app.forms.grid import Grid
from contact_app.forms.parts import Parts
from contact_app.forms.uniform import EqualCells, added, box_stiffness
from meshes.arrays import Array, Ints

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class Subdomains:
    """The subdomains that this rank factors and solves."""

    parts: Parts
    """The cells of this rank, over which forms are integrated."""
    starts: Ints  # (subdomains + 1,)
    """First copy of a node of each subdomain, and the number of copies."""
    numbers: Ints  # (copies,)
    """Node of each copy, as all ranks number it."""
    points: Array  # (copies, 3)
    moved: "Moved | None" = None
    """Places that the parts go to; None if each part is a subdomain of its own rank."""
    grid: Grid | None = None
    """The cut of a regular mesh; None of others."""
    boxes: Ints | None = None  # (subdomains,)
    """Sub-box of the grid that each is."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        return self.parts.comm

    @property
    def dimension(self) -> int:
        """Components of a node."""
        return self.parts.dimension

    @property
    def count(self) -> int:
        """Subdomains of this rank."""
        return len(self.starts) - 1

    def copies(self, number: int) -> slice:
        """Copies of one subdomain."""
        return slice(int(self.starts[number]), int(self.starts[number + 1]))

    def unknowns(self, number: int) -> slice:
        """Unknowns of one subdomain among those of all copies."""
        d = self.dimension
        return slice(int(self.starts[number]) * d, int(self.starts[number + 1]) * d)

    def stiffness(self, form: Any, equal: EqualCells | None) -> list[sparse.csr_matrix]:
        """K of each, (n, n) with unknown ``node * dimension + component`` (collective).

        Sub-boxes of a grid whose matrices are equal may share one.
        """
        grid = self.grid
        if equal is None or grid is None or self.boxes is None:
            return self._integrated(form)
        of_body, others = equal.matrices, equal.others
        kinds = [(int(grid.bodies[box]), *map(int, grid.cells[box])) for box in self.boxes]
        made = {kind: box_stiffness(of_body[kind[0]], kind[1:], grid.degree) for kind in set(kinds)}
        result = [made[kind] for kind in kinds]
        if not others.empty():
            result = list(map(added, result, self._integrated(others)))
        return result

    def _integrated(self, form: Any) -> list[sparse.csr_matrix]:
        """K of each, integrated over all cells (collective)."""
        matrix = self.parts.stiffness(form)
        if self.moved is None:
            return matrix
        sent = self.moved.exchange([(K.indptr, K.indices, K.data) for K in matrix])
        result = []
        for number, pieces in enumerate(self.moved.of_subdomains(sent)):
            n = self.dimension * (self.starts[number + 1] - self.starts[number])
            result.append(self._sum(n, pieces))
        return result

    def _sum(self, n: int, pieces: list[tuple[Any, Ints]]) -> sparse.csr_matrix:
        """Matrices of pieces, added at the nodes of their subdomain."""
        if len(pieces) == 1 and self.dimension * len(pieces[0][1]) == n:
            (pointers, columns, values), _ = pieces[0]
            return sparse.csr_matrix((values, columns, pointers), shape=(n, n))
        rows, columns, values = [], [], []
        for (pointers, own_columns, own_values), nodes in pieces:
            unknown = self._unknowns_at(nodes)
            rows.append(np.repeat(unknown, np.diff(pointers)))
            columns.append(unknown[own_columns])
            values.append(own_values)
        entries = np.concatenate(rows), np.concatenate(columns)
        # entries that are zero stay: equal sub-boxes have equal patterns
        return sparse.csr_matrix((np.concatenate(values), entries), shape=(n, n)).sorted_indices()

    def loads(self, form: Any) -> list[Array]:
        """f of each subdomain, (n,) (collective)."""
        vector = self.parts.loads(form)
        if self.moved is None:
            return vector
        result = []
        for number, pieces in enumerate(self.moved.of_subdomains(self.moved.exchange(vector))):
            f = np.zeros(self.dimension * (self.starts[number + 1] - self.starts[number]))
            for values, nodes in pieces:
                f[self._unknowns_at(nodes)] += values
            result.append(f)
        return result

    def _unknowns_at(self, nodes: Ints) -> Ints:
        return (nodes[:, None] * self.dimension + np.arange(self.dimension)).ravel()


@dataclass(frozen=True, eq=False)
class Moved:
    """Rank of the subdomain of each part, and positions of a part's nodes in it."""

    comm: MPI.Intracomm
    rank: Ints  # (parts,)
    """Rank that holds the subdomain of each part of this rank."""
    subdomain: Ints
    """Subdomain of each part that arrives here."""
    nodes: list[Ints]  # one (n,) array per arrived part
    """Positions of its nodes among those of the subdomain."""
    count: int
    """Subdomains of this rank."""

    def exchange(self, values: list[Value]) -> list[Value]:
        """One value per part, sent to the rank of its subdomain (collective)."""
        return _exchanged(self.comm, self.rank, values)

    def of_subdomains(
        self, arrived: list[Value]
    ) -> list[list[tuple[Value, Ints]]]:  # fmt: skip
        """Arrived data of each subdomain, with the nodes of the parts."""
        result: list[list[tuple[Value, Ints]]] = [[] for _ in range(self.count)]
        for number, value, nodes in zip(self.subdomain, arrived, self.nodes, strict=True):
            result[number].append((value, nodes))
        return result


def _exchanged(comm: MPI.Intracomm, rank: Ints, values: list[Value]) -> list[Value]:
    """Values that go to a rank each; ordered by the rank they come from (collective)."""
    here = [value for value, to in zip(values, rank, strict=True) if to == comm.rank]
    leaving = [
        [] if r == comm.rank else [v for v, to in zip(values, rank, strict=True) if to == r]
        for r in range(comm.size)
    ]
    arrived = comm.alltoall(leaving)
    arrived[comm.rank] = here
    return [value for of_rank in arrived for value in of_rank]


def subdomains_of(parts: Parts, grid: Grid | None) -> Subdomains:
    """The subdomains of the parts: these themselves, or sub-boxes of a grid (collective)."""
    if grid is None or parts.comm.size == 1:
        boxes = None if grid is None else np.unique(grid.of_cell)
        return Subdomains(
            parts, parts.starts, parts.numbers, parts.points, grid=grid, boxes=boxes
        )  # fmt: skip
    comm, lattice = parts.comm, grid.lattice[parts.blocks]
    boxes = np.unique(grid.of_cell)
    rank = ranks_of(comm, grid)[boxes]
    parts_of_rank = []
    for number, box in enumerate(boxes):
        at = parts.copies(number)
        parts_of_rank.append((int(box), lattice[at], parts.numbers[at], parts.points[at]))
    arrived = _exchanged(comm, rank, parts_of_rank)
    of_rank, subdomain = np.unique([box for box, *_ in arrived], return_inverse=True)
    starts, numbers, points = [0], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    nodes: dict[int, Ints] = {}
    for number in range(len(of_rank)):
        pieces = np.flatnonzero(subdomain == number)
        places, ids, at = (
            np.concatenate([arrived[k][column] for k in pieces]) for column in (1, 2, 3)
        )  # fmt: skip
        every, first = np.unique(places, return_index=True)
        starts.append(starts[-1] + len(every))
        numbers.append(ids[first])
        points.append(at[first])
        nodes |= {int(k): np.searchsorted(every, arrived[k][1]) for k in pieces}
    moved = Moved(comm, rank, subdomain, [nodes[k] for k in range(len(arrived))], len(of_rank))
    return Subdomains(
        parts, np.array(starts, np.int64), np.concatenate(numbers), np.concatenate(points), moved,
        grid, of_rank,
    )  # fmt: skip


def ranks_of(comm: MPI.Intracomm, grid: Grid) -> Ints:
    """The rank that has each sub-box, (sub-boxes,): one with many of its cells (collective).

    All ranks have as many, but for one more or less.
    """
    table = np.zeros((grid.count, comm.size), np.int64)
    np.add.at(table[:, comm.rank], grid.of_cell, 1)
    table = comm.allreduce(table)
    room = np.diff(grid.count * np.arange(comm.size + 1) // comm.size)
    rank = np.full(grid.count, -1, np.int64)
    for at in np.argsort(-table, axis=None, kind="stable"):
        box, r = divmod(int(at), comm.size)
        if rank[box] < 0 and room[r] > 0:
            rank[box] = r
            room[r] -= 1
    return rank
