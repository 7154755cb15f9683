"""From bodies and a wish to a partition: who holds which subdomain.

Subdomains are numbered body by body and dealt to the ranks in consecutive runs, so the numbers,
and with them the dual problem, do not depend on how many ranks there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from meshes.box import BoxShape, split_regularly
from meshes.graph import place_piece, split_by_graph
from meshes.subdomains import Partition, Subdomain, owned_range

WHOLE_BODY_NODES = 1500
"""Bodies of up to this many nodes stay whole: one small factor beats any gluing."""

EDGE_GROWTH = 1.25
"""`auto` makes sub-boxes of about this times √n cells along an edge, in a box of n along each.

The cost of dense interface blocks grows with the sub-box, that of the coarse problem with their
number; in a sweep over 20³ and 40³ cells the cheapest sub-boxes had 5³ and 8³.
"""


def decompose(
    boxes: Sequence[BoxShape],
    subdomains: None | int | tuple[int, ...],
    comm: MPI.Intracomm,
) -> Partition:
    """Cut the bodies into subdomains and give each rank its share.

    Parameters
    ----------
    boxes
        One box a body.
    subdomains
        None: regular splits of a size chosen here. A tuple: sub-boxes of every body along each
        axis. A number: graph partitions, the number shared among the bodies by their cells.

    Raises
    ------
    ValueError
        More subdomains than cells along an axis, or fewer subdomains than ranks.
    """
    first_node = np.cumsum([0, *(box.nodes for box in boxes)], dtype=np.int64)
    first_cell = np.cumsum([0, *(box.total_cells for box in boxes)], dtype=np.int64)
    if isinstance(subdomains, int):
        counts, local = _by_graph(boxes, subdomains, first_node, comm)
    else:
        counts, local = _by_splits(boxes, subdomains, first_node, comm)
    sizes = [len(s.reference.cells) for s in local]
    before = comm.exscan(sum(sizes)) or 0
    return Partition(
        comm=comm,
        dimension=boxes[0].dimension,
        subdomains=tuple(local),
        count=sum(counts),
        subdomains_of_body=tuple(counts),
        first_node=first_node,
        first_cell=first_cell,
        cell_starts=before + np.cumsum([0, *sizes], dtype=np.int64)[:-1],
    )


def choose_split(box: BoxShape, at_least: int = 1) -> tuple[int, ...]:
    """Sub-boxes along each axis for `decomposition: auto`.

    Sub-boxes about as long in every direction, which divide the box evenly if a split near the
    wish does, so that they are congruent; one subdomain for a small body.
    """
    if box.nodes <= WHOLE_BODY_NODES and at_least == 1:
        return (1,) * box.dimension
    mean_cells = math.prod(box.cells) ** (1.0 / box.dimension)
    mean_spacing = math.prod(box.spacing) ** (1.0 / box.dimension)
    edge = EDGE_GROWTH * math.sqrt(mean_cells) * mean_spacing
    split = [
        _near_even(cells, cells * spacing / edge)
        for cells, spacing in zip(box.cells, box.spacing, strict=True)
    ]
    while math.prod(split) < at_least:
        room = [cells / parts for cells, parts in zip(box.cells, split, strict=True)]
        axis = int(np.argmax(room))
        if room[axis] < 2:
            break
        split[axis] += 1
    return tuple(split)


def _near_even(cells: int, wish: float) -> int:
    """Number of parts near a wish, one that divides the cells evenly if there is one."""
    even = [parts for parts in range(1, math.ceil(2 * wish)) if cells % parts == 0]
    if even:
        nearest = min(even, key=lambda parts: abs(math.log(parts / wish)))
        if 2 / 3 < nearest / wish < 3 / 2:
            return nearest
    return min(cells, max(1, round(wish)))


def _by_splits(
    boxes: Sequence[BoxShape],
    parts: tuple[int, ...] | None,
    first_node: np.ndarray,
    comm: MPI.Intracomm,
) -> tuple[list[int], list[Subdomain]]:
    needed = -(-comm.size // len(boxes))
    splits = [parts or choose_split(box, needed) for box in boxes]
    for split, box in zip(splits, boxes, strict=True):
        for axis, (wanted, cells) in enumerate(zip(split, box.cells, strict=True)):
            if wanted > cells:
                raise ValueError(
                    f"{wanted} subdomains along {'xyz'[axis]}, where the box has only {cells} cells"
                )
    counts = [math.prod(split) for split in splits]
    begin, end = _share(sum(counts), comm)
    references: dict[Any, Any] = {}
    local: list[Subdomain] = []
    start = 0
    for body, (box, split, count) in enumerate(zip(boxes, splits, counts, strict=True)):
        numbers = range(max(begin, start), min(end, start + count))
        local += split_regularly(
            box, split, body, start, int(first_node[body]), numbers, references
        )
        start += count
    return counts, local


def _by_graph(
    boxes: Sequence[BoxShape], total: int, first_node: np.ndarray, comm: MPI.Intracomm
) -> tuple[list[int], list[Subdomain]]:
    weights = np.array([box.total_cells for box in boxes], dtype=float)
    wanted = np.maximum(1, np.rint(total * weights / weights.sum())).astype(int)
    for parts, box in zip(wanted, boxes, strict=True):
        if parts > box.total_cells:
            raise ValueError(f"{parts} subdomains of a body that has only {box.total_cells} cells")
    pieces = None
    if comm.rank == 0:
        pieces = [split_by_graph(box, int(n)) for box, n in zip(boxes, wanted, strict=True)]
    counts = comm.bcast([len(p) for p in pieces] if pieces is not None else None)
    begin, end = _share(sum(counts), comm)
    places = [(body, k) for body, count in enumerate(counts) for k in range(count)]
    if pieces is not None:
        for rank in range(1, comm.size):
            first, last = sum(counts) * rank // comm.size, sum(counts) * (rank + 1) // comm.size
            comm.send([pieces[body][k] for body, k in places[first:last]], dest=rank)
        mine = [pieces[body][k] for body, k in places[begin:end]]
    else:
        mine = comm.recv(source=0)
    references: dict[Any, Any] = {}
    local = [
        place_piece(piece, places[n][0], n, int(first_node[places[n][0]]), references)
        for n, piece in zip(range(begin, end), mine, strict=True)
    ]
    return counts, local


def _share(total: int, comm: MPI.Intracomm) -> tuple[int, int]:
    if total < comm.size:
        raise ValueError(
            f"{comm.size} ranks but only {total} subdomain{'s' * (total > 1)}: start at most "
            f"{total} rank{'s' * (total > 1)} or ask for more subdomains"
        )
    return owned_range(total, comm)
