"""Graph partitions: any mesh into any number of subdomains.

Meshes of even cells are cut by planes (recursive coordinate bisection: M. Berger, S. Bokhari, *A
partitioning strategy for nonuniform problems on multiprocessors*, 1987): flat interfaces save a
fifth of the iterations, and sorting costs next to nothing. Graded meshes, where planes would pass
from fine to coarse, are cut along the dual graph (cells joined by facets) by Scotch. A part may
fall into pieces that touch only along an edge or in a corner; such a part has more zero-energy
modes than the rigid motions, so every piece that hangs together through facets becomes a subdomain
of its own, whose kernel is exactly the rigid motions; small ones are given to a neighbour instead.

A mesh is partitioned on the rank that holds it; each other rank receives its subdomains only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from meshes import versions
from meshes.quadratic import STRAIGHT, VERTICES, bulges
from meshes.subdomains import VTK_ORDER, Reference, Subdomain, vtk_order
from meshes.unstructured import CellMesh, matching_rows

CRUMB = 0.2
"""Share of the mean size below which a piece that broke off a part is given to a neighbour."""

EVEN = 3.0
"""Largest ratio of large to small cells (length, 95 and 5 of 100) of a mesh that planes cut."""

COINCIDENT = -33
"""Power of two: nodes that lie so near, over the size of a piece, are at one place in its copy."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A subdomain as it travels from the partitioning rank: plain arrays.

    `cells` are local nodes in VTK order, of degree 1 or 2; `tags` number the material of each
    cell; `exterior` and `boundaries` list facets by their sorted local nodes.
    """

    cell: str
    degree: int
    cells: NDArray[np.int64]
    tags: NDArray[np.int32]
    points: NDArray[np.float64]
    nodes: NDArray[np.int64]
    exterior: NDArray[np.int64]
    boundaries: dict[str, NDArray[np.int64]]


def split_by_graph(mesh: CellMesh, parts: int) -> list[Piece]:
    """Partition a mesh into `parts` subdomains or a few more.

    Returns
    -------
    Pieces with node numbers counted from zero; more than `parts` where a part was not connected
    through facets.
    """
    topology = mesh.topology
    nodes = mesh.points.T[:, mesh.cells.T]
    if parts == 1:
        part = np.zeros(mesh.total_cells, np.int32)
    elif _is_even(nodes):
        part = bisected(nodes.mean(axis=1).T, parts)
    else:
        joined = _symmetric(topology.pairs, mesh.total_cells)
        part = versions.scotch_parts((joined.indices, joined.indptr), parts)
    label = facet_connected_parts(topology.pairs, part, parts)
    facet_label = label[topology.facet_cells]
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(label.max() + 2))
    return [
        _piece(mesh, order[a:b], facet_label == part)
        for part, (a, b) in enumerate(zip(starts[:-1], starts[1:], strict=True))
    ]


def _is_even(nodes: NDArray[np.float64]) -> bool:
    """Whether cells, (dimension, nodes, cells), are of much the same size."""
    size = np.ptp(nodes, axis=1).max(axis=0)
    small, large = np.quantile(size, (0.05, 0.95))
    return bool(large <= EVEN * small)


def bisected(centres: NDArray[np.float64], parts: int) -> NDArray[np.int32]:
    """Part of each point, by planes across the longest extent of what is left.

    Parameters
    ----------
    centres : (cells, dimension)
    parts
        As equal as they can be.
    """
    axes = np.ascontiguousarray(centres.T)
    label = np.empty(len(centres), np.int32)
    left = [(np.arange(len(centres)), parts, 0)]
    while left:
        rows, count, first = left.pop()
        if count == 1:
            label[rows] = first
            continue
        half = count // 2
        places = axes[:, rows]
        along = places[int(np.argmax(places.std(axis=1)))]
        order = np.argpartition(along, len(rows) * half // count)
        below, above = np.split(rows[order], [len(rows) * half // count])
        left += [(below, half, first), (above, count - half, first + half)]
    return label


def facet_connected_parts(
    pairs: NDArray[np.int64], part: NDArray[np.int32], parts: int
) -> NDArray[np.int64]:
    """Label each cell with its subdomain; every subdomain hangs together through facets.

    Parameters
    ----------
    pairs : (n, 2)
        Cells that share a facet.
    part : (cells,)
        Part of each cell.
    parts
        Parts asked for.
    """
    cells = len(part)
    within = pairs[part[pairs[:, 0]] == part[pairs[:, 1]]]
    _, label = connected_components(_symmetric(within, cells), directed=False)
    of_piece = part[np.unique(label, return_index=True)[1]].astype(np.int64)
    label, of_piece = _without_crumbs(label, of_piece, pairs, CRUMB * cells / parts)
    # numbered by part, so that the numbers do not depend on the search above
    renumber = np.empty(len(of_piece), np.int64)
    renumber[np.argsort(of_piece, kind="stable")] = np.arange(len(of_piece))
    return renumber[label]


def _without_crumbs(
    label: NDArray[np.int64], part: NDArray[np.int64], pairs: NDArray[np.int64], least: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Give small pieces that broke off a part to the piece they share most facets with.

    Parameters
    ----------
    label : (cells,)
        Piece of each cell.
    part : (pieces,)
        Part each piece belongs to.
    least
        Cells below which a piece is given away, unless it is the largest of its part.

    Returns
    -------
    The same without the pieces given away.
    """
    size = np.bincount(label)
    largest = np.zeros(part.max() + 1, np.int64)
    np.maximum.at(largest, part, size)
    crumbs = np.flatnonzero((size < least) & (size < largest[part]))
    sides = label[pairs]
    sides = sides[sides[:, 0] != sides[:, 1]]
    for crumb in crumbs[np.argsort(size[crumbs], kind="stable")]:
        own = sides == crumb
        out = sides[own.any(axis=1)]
        taker = np.bincount(out[out != crumb]).argmax()
        sides[own] = taker
        label[label == crumb] = taker
    kept, label = np.unique(label, return_inverse=True)
    return label.reshape(-1), part[kept]


def place_piece(
    piece: Piece,
    body: int,
    number: int,
    first_node: int,
    references: dict[Any, Reference],
) -> Subdomain:
    """Build the subdomain of a piece, on a reference it may share with congruent ones."""
    origin = piece.points.min(axis=0)
    local = piece.points - origin
    # a power of two, which the round-off of a translation does not change
    quantum = float(np.exp2(np.rint(np.log2(np.ptp(local, axis=0).max())) + COINCIDENT))
    shape = np.rint(local / quantum).astype(np.int64)
    key = (
        piece.cell, piece.degree, quantum, shape.tobytes(), piece.cells.tobytes(),
        piece.tags.tobytes(),
    )  # fmt: skip
    if key not in references:
        order = VTK_ORDER[piece.cell]  # its own inverse
        degree = 2 if _curved(piece) else 1
        if degree == 2:
            order = tuple(np.argsort(vtk_order(piece.cell, degree)).tolist())
        nodes = piece.cells[:, order]
        used, cells = np.unique(nodes, return_inverse=True)
        mesh = versions.create_mesh(cells.reshape(nodes.shape), local[used], piece.cell, degree)
        references[key] = Reference.of(mesh, piece.cell, piece.degree, piece.tags)
    reference = references[key]
    given = np.empty(len(local), np.int64)
    given[reference.cells] = piece.cells[versions.original_cells(reference.mesh)]
    translation = np.zeros(3)
    translation[: len(origin)] = origin
    table = np.sort(given[reference.facets], axis=1)
    return Subdomain(
        number=number,
        body=body,
        reference=reference,
        translation=translation,
        nodes=first_node + piece.nodes[given],
        exterior=matching_rows(table, piece.exterior).astype(np.int32),
        boundaries={
            name: matching_rows(table, rows).astype(np.int32)
            for name, rows in piece.boundaries.items()
        },
    )


def _curved(piece: Piece) -> bool:
    """Whether any edge of a piece is curved."""
    if piece.degree == 1:
        return False
    x = piece.points[piece.cells]
    v = VERTICES[piece.cell]
    return bool(bulges(x[:, :v], x[:, v:], piece.cell).max() > STRAIGHT)


def _symmetric(pairs: NDArray[np.int64], size: int) -> sparse.csr_matrix:
    ones = np.ones(2 * len(pairs), dtype=np.int8)
    rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
    cols = np.concatenate([pairs[:, 1], pairs[:, 0]])
    return sparse.csr_matrix((ones, (rows, cols)), shape=(size, size))


def _piece(mesh: CellMesh, rows: NDArray[np.int64], own: NDArray[np.bool_]) -> Piece:
    """Cut one subdomain out of a mesh: its cells, nodes and its share of the body's surface.

    Parameters
    ----------
    rows
        Its cells, ascending.
    own
        Which facets of the mesh's surface are its own.
    """
    cells = mesh.cells[rows]
    used, local = np.unique(cells, return_inverse=True)
    place = np.full(mesh.nodes, -1, dtype=np.int64)
    place[used] = np.arange(len(used))

    def mine(rows: NDArray[Any]) -> NDArray[np.int64]:
        return np.sort(place[mesh.topology.facets[rows[own[rows]]]], axis=1)

    return Piece(
        cell=mesh.cell,
        degree=mesh.degree,
        cells=local.reshape(cells.shape).astype(np.int64),
        tags=mesh.tags[rows],
        points=mesh.points[used],
        nodes=used,
        exterior=mine(np.arange(len(own))),
        boundaries={name: mine(rows) for name, rows in mesh.sides.items()},
    )
