"""Decomposition of bodies into subdomains, and their distribution to ranks.

Subdomains are numbered body by body and given to the ranks in consecutive runs, so the numbers,
and with them the dual problem, do not depend on how many ranks there are. The runs have equal
lengths, or equal work where subdomains differ in cost.
"""

import math
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from meshes.box import BoxShape, split_regularly
from meshes.box_cells import BoxCells, Cells
from meshes.graph import (
    Piece,
    Rows,
    bisected,
    parts_along_graph,
    pieces_of,
    place_piece,
    rows_of,
    through_facets,
    without_crumbs,
)
from meshes.load_balance import balanced_runs
from meshes.subdomains import Partition, Subdomain, owned_range
from meshes.unstructured import CellMesh

Shape = BoxShape | CellMesh
"""The mesh of a body."""

PIECE_NODES = {2: 20_000, 3: 500}
"""Nodes of a subdomain of a mesh with `decomposition: auto`, by dimension.

Nearly the fastest size in sweeps over the bracket, the ball and cubes of tetrahedra with 3,000 to
50,000 nodes (``python -m contact_app.studies.settings``); twice or half as many nodes take at most
a fifth longer.
"""

WHOLE_NODES = {2: 20_000, 3: 2_000}
"""Nodes up to which a mesh is not cut, by dimension: its factor costs less than interfaces."""

Choose = Callable[[BoxShape, int], tuple[int, ...]]
"""Chooses the number of sub-boxes of a box along each axis, with at least so many in all."""


def barely(box: BoxShape, at_least: int) -> tuple[int, ...]:
    """One sub-box, or slabs across the axis with most cells if more are required."""
    split = [1] * box.dimension
    axis = int(np.argmax(box.cells))
    split[axis] = min(at_least, box.cells[axis])
    return tuple(split)


def decompose(
    shapes: Sequence[Shape],
    subdomains: None | int | tuple[int, ...],
    comm: MPI.Intracomm,
    choose: Choose = barely,
) -> Partition:
    """Cut the bodies into subdomains and distribute them to the ranks (collective).

    Parameters
    ----------
    shapes
        One box or mesh per body, the same on all ranks.
    subdomains
        None: regular splits of boxes by `choose`, and graph partitions of meshes. A tuple: number
        of sub-boxes along each axis for every box, and graph partitions of every mesh into the same
        total. A number: graph partitions; the number is distributed to the bodies by their cells.

    Raises
    ------
    ValueError
        More subdomains than cells, or fewer subdomains than ranks.
    """
    first_node = np.cumsum([0, *(shape.nodes for shape in shapes)], dtype=np.int64)
    first_cell = np.cumsum([0, *(shape.total_cells for shape in shapes)], dtype=np.int64)
    plans = _plans(shapes, subdomains, comm, choose)
    counts = [p if isinstance(p, int) else math.prod(p) for p in plans]
    pieces: dict[int, Piece] = {}
    graph = any(isinstance(plan, int) for plan in plans)
    if graph:
        counts, pieces = _cut(shapes, plans, counts, comm)
    starts = np.cumsum([0, *counts])
    begin, end = _share(int(starts[-1]), comm)
    if graph and comm.size > 1:
        begin, end, pieces = _evened(shapes, counts, pieces, comm)
    references: dict[Any, Any] = {}
    local: list[Subdomain] = []
    for body, (shape, plan) in enumerate(zip(shapes, plans, strict=True)):
        start, node = int(starts[body]), int(first_node[body])
        numbers = range(max(begin, start), min(end, int(starts[body + 1])))
        if isinstance(plan, tuple):
            assert isinstance(shape, BoxShape)
            local += split_regularly(shape, plan, body, start, node, numbers, references)
        else:
            local += [place_piece(pieces[n], body, n, node, references) for n in numbers]
    sizes = [len(s.reference.cells) for s in local]
    before = comm.exscan(sum(sizes)) or 0
    return Partition(
        comm=comm,
        dimension=shapes[0].dimension,
        subdomains=tuple(local),
        count=int(starts[-1]),
        subdomains_of_body=tuple(counts),
        first_node=first_node,
        first_cell=first_cell,
        cell_starts=before + np.cumsum([0, *sizes], dtype=np.int64)[:-1],
    )


def choose_parts(nodes: int, dimension: int, at_least: int = 1, degree: int = 1) -> int:
    """Number of subdomains of a mesh for `decomposition: auto`; one for a small body.

    Degree 2 has as many vertices per part, because gluing takes more iterations: fewer parts.
    """
    if nodes <= WHOLE_NODES[dimension]:
        return at_least
    return max(at_least, round(nodes / (PIECE_NODES[dimension] * degree**dimension)))


def _plans(
    shapes: Sequence[Shape],
    subdomains: None | int | tuple[int, ...],
    comm: MPI.Intracomm,
    choose: Choose,
) -> list[int | tuple[int, ...]]:
    """Plan of each body: a tuple of sub-boxes along each axis, or a number of graph parts."""
    plans: list[int | tuple[int, ...]] = []
    if isinstance(subdomains, int):
        weights = np.array([shape.total_cells for shape in shapes], dtype=float)
        shares = np.maximum(1, np.rint(subdomains * weights / weights.sum()))
        plans = [int(n) for n in shares]
    else:
        needed = -(-comm.size // len(shapes))
        for shape in shapes:
            if isinstance(shape, BoxShape):
                plans.append(subdomains or choose(shape, needed))
            elif subdomains:
                plans.append(math.prod(subdomains))
            else:
                plans.append(choose_parts(shape.nodes, shape.dimension, needed, shape.degree))
    for shape, plan in zip(shapes, plans, strict=True):
        if isinstance(plan, int):
            if plan > shape.total_cells:
                raise ValueError(
                    f"{plan} subdomains of a body that has only {shape.total_cells} cells"
                )
            continue
        assert isinstance(shape, BoxShape)
        for axis, (parts, cells) in enumerate(zip(plan, shape.cells, strict=True)):
            if parts > cells:
                raise ValueError(
                    f"{parts} subdomains along {'xyz'[axis]}, where the box has only {cells} cells"
                )
    return plans


def _cut(
    shapes: Sequence[Shape],
    plans: Sequence[int | tuple[int, ...]],
    counts: Sequence[int],
    comm: MPI.Intracomm,
) -> tuple[list[int], dict[int, Piece]]:
    """Subdomains of each body, and the pieces of this rank by subdomain number.

    A rank cuts out the parts that it holds and finds their connected pieces. If some part of a body
    is not connected, all ranks exchange its pieces, so there may be more pieces than parts.
    """
    counts = list(counts)
    bodies = {b: _cells(shapes[b]) for b, plan in enumerate(plans) if isinstance(plan, int)}
    label: dict[int, NDArray[np.int32]] = {}
    centres: dict[int, NDArray[np.float32]] = {}
    for b, cells in bodies.items():
        if counts[b] == 1:
            label[b] = np.zeros(cells.total_cells, np.int32)
        elif (places := cells.centres()) is not None:
            centres[b] = places
        else:
            by_first = parts_along_graph(cells, counts[b]) if comm.rank == 0 else None
            label[b] = comm.bcast(by_first)

    def rows(b: int, part_range: range) -> Rows:
        if b in label:
            return rows_of(label[b], part_range)
        return bisected(centres[b], counts[b], part_range)

    requested = _requested(counts, comm)
    parts_of = {b: rows(b, part_range) for b, part_range in requested.items() if b in bodies}
    hanging = {b: through_facets(bodies[b], parts) for b, parts in parts_of.items()}
    broken = np.array([len(hanging[b][1]) - len(parts) for b, parts in parts_of.items()])
    broken = comm.allreduce(broken)
    if broken.any():
        for b in np.array(list(parts_of))[broken > 0].tolist():
            piece, part = hanging[b]
            piece[piece >= 0] += comm.exscan(len(part)) or 0
            comm.Allreduce(MPI.IN_PLACE, piece, op=MPI.MAX)
            part = np.concatenate(comm.allgather(part))
            label[b] = without_crumbs(bodies[b], piece, part, counts[b])
            counts[b] = int(label[b].max()) + 1
        parts_of = {
            b: rows(b, part_range)
            for b, part_range in _requested(counts, comm).items()
            if b in bodies
        }
    centres.clear()
    starts = np.cumsum([0, *counts])
    return counts, {
        int(starts[b]) + part: piece
        for b, parts in parts_of.items()
        for part, piece in pieces_of(bodies[b], parts).items()
    }


def _evened(
    shapes: Sequence[Shape], counts: Sequence[int], pieces: dict[int, Piece], comm: MPI.Intracomm
) -> tuple[int, int, dict[int, Piece]]:
    """First and end subdomain of this rank, and its pieces, balanced by the work on them.

    Sub-boxes of a regular split count as equal.
    """
    kinds: list[tuple[Hashable, int]] = [
        (b, shape.total_cells // count)
        for b, (shape, count) in enumerate(zip(shapes, counts, strict=True))
        for _ in range(count)
    ]
    sizes = {n: (piece.kind, len(piece.cells)) for n, piece in pieces.items()}
    for of_rank in comm.allgather(sizes):
        for number, kind in of_rank.items():
            kinds[number] = kind
    starts = balanced_runs(kinds, comm.size)
    begin, end = starts[comm.rank], starts[comm.rank + 1]
    away = [
        {n: piece for n, piece in pieces.items() if first <= n < last and not begin <= n < end}
        for first, last in zip(starts[:-1], starts[1:], strict=True)
    ]
    for came in comm.alltoall(away):
        pieces = pieces | came
    return begin, end, pieces


def _cells(shape: Shape) -> Cells:
    return BoxCells(shape) if isinstance(shape, BoxShape) else shape


def _requested(counts: Sequence[int], comm: MPI.Intracomm) -> dict[int, range]:
    """Subdomains of each body on this rank, counted from the first one of the body."""
    begin, end = owned_range(sum(counts), comm)
    starts = np.cumsum([0, *counts]).tolist()
    return {
        b: range(min(max(begin - start, 0), n), min(max(end - start, 0), n))
        for b, (start, n) in enumerate(zip(starts, counts, strict=False))
    }


def _share(total: int, comm: MPI.Intracomm) -> tuple[int, int]:
    if total < comm.size:
        raise ValueError(
            f"{comm.size} ranks but only {total} subdomain{'s' * (total > 1)}: start at most "
            f"{total} rank{'s' * (total > 1)} or ask for more subdomains"
        )
    return owned_range(total, comm)
