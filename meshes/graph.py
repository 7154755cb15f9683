"""Graph partitions: any mesh into any number of subdomains.

The dual graph (cells joined by facets) is partitioned by Scotch. A part may fall into pieces
that touch only along an edge or in a corner; such a part has more zero-energy modes than the
rigid motions, so every piece that hangs together through facets becomes a subdomain of its own,
whose kernel is exactly the rigid motions.

The graph is partitioned on the rank that holds the mesh; each other rank receives its
subdomains only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from meshes import versions
from meshes.box import BoxShape, sides_of
from meshes.subdomains import Reference, Subdomain


@dataclass(frozen=True, eq=False)
class Piece:
    """A subdomain as it travels from the partitioning rank: plain arrays.

    `cells` are local nodes in dolfinx's order; `exterior` and `boundaries` list facets by their
    sorted local nodes.
    """

    cell: str
    cells: NDArray[np.int64]
    points: NDArray[np.float64]
    nodes: NDArray[np.int64]
    exterior: NDArray[np.int64]
    boundaries: dict[str, NDArray[np.int64]]


def split_by_graph(box: BoxShape, parts: int) -> list[Piece]:
    """Partition the mesh of a box into `parts` subdomains or a few more.

    Returns
    -------
    Pieces with node numbers counted from zero; more than `parts` where a part was not connected
    through facets.
    """
    mesh = box.mesh()
    reference = Reference.of(mesh, box.cell)
    lattice = box.lattice(reference.points)
    sides = sides_of(box, lattice, reference.facets)
    cells = versions.cell_nodes(mesh)
    pairs, facet_cell = _dual_graph(mesh, reference.facet_entities)
    label = facet_connected_parts(pairs, len(cells), parts)
    points = reference.points[:, : box.dimension] + np.array(box.lower)
    number = lattice @ box.strides

    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(label.max() + 2))
    return [
        _piece(
            box.cell,
            cells[np.sort(order[a:b])],
            points,
            number,
            reference.facets,
            label[facet_cell] == part,
            sides,
        )
        for part, (a, b) in enumerate(zip(starts[:-1], starts[1:], strict=True))
    ]


def facet_connected_parts(pairs: NDArray[np.int64], cells: int, parts: int) -> NDArray[np.int64]:
    """Label each cell with its subdomain; every subdomain hangs together through facets.

    Parameters
    ----------
    pairs : (n, 2)
        Cells that share a facet.
    cells
        Number of cells.
    parts
        Parts asked of the partitioner.
    """
    joined = _symmetric(pairs, cells)
    part = (
        versions.scotch_parts((joined.indices, joined.indptr), parts)
        if parts > 1
        else np.zeros(cells, np.int32)
    )
    within = pairs[part[pairs[:, 0]] == part[pairs[:, 1]]]
    _, label = connected_components(_symmetric(within, cells), directed=False)
    # numbered by part, so that the numbers do not depend on the search above
    keys = part[np.unique(label, return_index=True)[1]]
    renumber = np.empty(len(keys), np.int64)
    renumber[np.argsort(keys, kind="stable")] = np.arange(len(keys))
    return renumber[label]


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
    scale = max(float(np.ptp(local, axis=0).max()), np.finfo(float).tiny)
    shape = np.rint(local / scale * 1e10).astype(np.int64)
    key = (piece.cell, scale, shape.tobytes(), piece.cells.tobytes())
    if key not in references:
        references[key] = Reference.of(
            versions.create_mesh(piece.cells, local, piece.cell), piece.cell
        )
    reference = references[key]
    given = np.asarray(reference.mesh.geometry.input_global_indices)
    translation = np.zeros(3)
    translation[: len(origin)] = origin
    table = np.sort(given[reference.facets], axis=1)
    return Subdomain(
        number=number,
        body=body,
        reference=reference,
        translation=translation,
        nodes=first_node + piece.nodes[given],
        exterior=_rows_of(table, piece.exterior),
        boundaries={name: _rows_of(table, rows) for name, rows in piece.boundaries.items()},
    )


def _rows_of(table: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int32]:
    """Row of `table` that equals each row of `wanted`; both hold sorted node tuples."""
    _, label = np.unique(np.concatenate([table, wanted]), axis=0, return_inverse=True)
    label = label.reshape(-1)
    place = np.empty(len(table) + len(wanted), np.int32)
    place[label[: len(table)]] = np.arange(len(table))
    return place[label[len(table) :]]


def _dual_graph(
    mesh: Any, surface: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Pairs of cells that share a facet, and the cell of each surface facet."""
    dimension = mesh.topology.dim
    mesh.topology.create_connectivity(dimension - 1, dimension)
    links, offsets = versions.adjacency(mesh.topology.connectivity(dimension - 1, dimension))
    inner = np.flatnonzero(np.diff(offsets) == 2)
    pairs = np.stack([links[offsets[inner]], links[offsets[inner] + 1]], axis=1)
    return pairs.astype(np.int64), links[offsets[surface]]


def _symmetric(pairs: NDArray[np.int64], size: int) -> sparse.csr_matrix:
    ones = np.ones(2 * len(pairs), dtype=np.int8)
    rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
    cols = np.concatenate([pairs[:, 1], pairs[:, 0]])
    return sparse.csr_matrix((ones, (rows, cols)), shape=(size, size))


def _piece(
    cell: str,
    cells: NDArray[np.int32],
    points: NDArray[np.float64],
    number: NDArray[np.int64],
    facets: NDArray[np.int32],
    own: NDArray[np.bool_],
    sides: dict[str, NDArray[np.int32]],
) -> Piece:
    """Cut one subdomain out of a mesh: its cells, nodes and its share of the body's surface."""
    used, local = np.unique(cells, return_inverse=True)
    local = local.reshape(cells.shape).astype(np.int64)
    place = np.full(len(points), -1, dtype=np.int64)
    place[used] = np.arange(len(used))

    def mine(rows: NDArray[np.int32]) -> NDArray[np.int64]:
        return np.sort(place[facets[rows[own[rows]]]], axis=1)

    return Piece(
        cell=cell,
        cells=local,
        points=points[used],
        nodes=number[used],
        exterior=mine(np.arange(len(facets), dtype=np.int32)),
        boundaries={name: mine(rows) for name, rows in sides.items()},
    )
