"""From bodies and a wish to a partition: who holds which subdomain.

Subdomains are numbered body by body and dealt to the ranks in consecutive runs, so the numbers,
and with them the dual problem, do not depend on how many ranks there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from meshes.box import BoxShape, split_regularly
from meshes.graph import Piece, place_piece, split_by_graph
from meshes.subdomains import Partition, Subdomain, owned_range
from meshes.unstructured import CellMesh

Shape = BoxShape | CellMesh
"""What a body is made of."""

PIECE_NODES = {2: 20_000, 3: 500}
"""Nodes of a subdomain that `auto` makes of a mesh, by dimension: each has a factor of its own.

About the fastest in sweeps over the bracket, the ball and cubes of tetrahedra with 3,000 to 50,000
nodes (``python -m contact_app.studies.sweep``); twice or half as many are within a fifth of it.
"""

WHOLE_NODES = {2: 20_000, 3: 2_000}
"""Nodes up to which a mesh stays whole, by dimension: its factor costs less than faces do."""

Choose = Callable[[BoxShape, int], tuple[int, ...]]
"""Sub-boxes of a box along each axis, at least so many in all."""


def barely(box: BoxShape, at_least: int) -> tuple[int, ...]:
    """One sub-box, or slabs across the axis with most cells where there must be more."""
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
    """Cut the bodies into subdomains and give each rank its share.

    Parameters
    ----------
    shapes
        One box or mesh a body; on ranks other than the first a mesh serves for its sizes only.
    subdomains
        None: regular splits of boxes, as `choose` has them, and graph partitions of meshes. A
        tuple: sub-boxes of every box along each axis, and as many in all by graph partition of
        every mesh. A number: graph partitions, the number shared among the bodies by their cells.

    Raises
    ------
    ValueError
        More subdomains than cells, or fewer subdomains than ranks.
    """
    first_node = np.cumsum([0, *(shape.nodes for shape in shapes)], dtype=np.int64)
    first_cell = np.cumsum([0, *(shape.total_cells for shape in shapes)], dtype=np.int64)
    plans = _plans(shapes, subdomains, comm, choose)
    pieces = {b: p for b, p in enumerate(plans) if isinstance(p, int)}
    cut: dict[int, list[Piece]] = {}
    if comm.rank == 0:
        cut = {b: split_by_graph(_cell_mesh(shapes[b]), parts) for b, parts in pieces.items()}
    found = comm.bcast({b: len(p) for b, p in cut.items()})
    counts = [found[b] if b in found else math.prod(p) for b, p in enumerate(plans)]  # type: ignore[arg-type]
    starts = np.cumsum([0, *counts])
    begin, end = _share(int(starts[-1]), comm)
    mine = _dealt(cut, starts, comm) if pieces else {}
    references: dict[Any, Any] = {}
    local: list[Subdomain] = []
    for body, (shape, plan) in enumerate(zip(shapes, plans, strict=True)):
        start, node = int(starts[body]), int(first_node[body])
        numbers = range(max(begin, start), min(end, int(starts[body + 1])))
        if isinstance(plan, tuple):
            assert isinstance(shape, BoxShape)
            local += split_regularly(shape, plan, body, start, node, numbers, references)
        else:
            local += [place_piece(mine[n], body, n, node, references) for n in numbers]
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
    """Subdomains of a mesh for `decomposition: auto`; one for a small body.

    As many vertices a part at degree 2, where gluing takes more iterations: fewer parts.
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
    """How each body is cut: a tuple of sub-boxes along each axis, or a number of graph parts."""
    plans: list[int | tuple[int, ...]] = []
    if isinstance(subdomains, int):
        weights = np.array([shape.total_cells for shape in shapes], dtype=float)
        wanted = np.maximum(1, np.rint(subdomains * weights / weights.sum()))
        plans = [int(n) for n in wanted]
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


def _cell_mesh(shape: Shape) -> CellMesh:
    return shape.cell_mesh() if isinstance(shape, BoxShape) else shape


def _dealt(
    cut: dict[int, list[Piece]], starts: np.ndarray, comm: MPI.Intracomm
) -> dict[int, Piece]:
    """Pieces of this rank by subdomain number; rank 0 has cut them."""
    if comm.rank:
        received: dict[int, Piece] = comm.recv(source=0)
        return received
    by_number = {int(starts[b]) + k: piece for b, p in cut.items() for k, piece in enumerate(p)}
    total = int(starts[-1])
    for rank in range(1, comm.size):
        numbers = range(total * rank // comm.size, total * (rank + 1) // comm.size)
        comm.send({n: by_number[n] for n in numbers if n in by_number}, dest=rank)
    return by_number


def _share(total: int, comm: MPI.Intracomm) -> tuple[int, int]:
    if total < comm.size:
        raise ValueError(
            f"{comm.size} ranks but only {total} subdomain{'s' * (total > 1)}: start at most "
            f"{total} rank{'s' * (total > 1)} or ask for more subdomains"
        )
    return owned_range(total, comm)
