"""Graph partitions: any mesh into any number of subdomains.

Meshes of even cells are cut by planes (recursive coordinate bisection: M. Berger, S. Bokhari, *A
partitioning strategy for nonuniform problems on multiprocessors*, 1987): flat interfaces save a
fifth of the iterations, and sorting is fast. Graded meshes, where planes would pass from fine to
coarse, are cut along the dual graph (cells joined by facets) by Scotch. A part may consist of
pieces that touch only along an edge or at a corner. Such a part has more zero-energy modes than
rigid motions. So every piece connected through facets becomes a subdomain of its own, whose kernel
is exactly the rigid motions; small pieces join a neighbour instead.

Every rank cuts out only its own subdomains; the first rank partitions the graph.
"""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha1
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask, distinct_numbers, in_order
from meshes.box_cells import Cells
from meshes.quadratic import STRAIGHT, VERTICES, bulges
from meshes.subdomains import VTK_ORDER, Reference, Subdomain, vtk_order
from meshes.unstructured import matching_rows

CRUMB = 0.2
"""Share of the mean size below which a separate piece of a part joins a neighbour."""

ALIKE = 1e-3
"""Share by which the extent along one axis has to exceed that along another to count as longer."""

COINCIDENT = -33
"""Distance of two nodes, over the size of a piece, up to which they coincide; a power of two."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A subdomain before it has a dolfinx mesh: plain arrays.

    `cells` are local nodes in VTK order, of degree 1 or 2. `tags` has the number of the material of
    each cell. `exterior` lists facets on the surface by their sorted local nodes, and `boundaries`
    are rows of `exterior`.
    """

    cell: str
    degree: int
    cells: Ints
    tags: NDArray[np.int32]
    points: Array
    nodes: Ints
    exterior: Ints
    boundaries: dict[str, Ints]

    @property
    def origin(self) -> Array:
        """Lower corner of the piece."""
        return self.points.min(axis=0)

    @cached_property
    def kind(self) -> bytes:
        """Key that is equal for pieces that are translates of each other."""
        local = self.points - self.origin
        # a power of two, which the round-off of a translation does not change
        quantum = np.exp2(np.rint(np.log2(np.ptp(local, axis=0).max())) + COINCIDENT)
        digest = sha1(f"{self.cell} {self.degree} {quantum}".encode(), usedforsecurity=False)
        for array in (np.rint(local / quantum).astype(np.int64), self.cells, self.tags):
            digest.update(np.ascontiguousarray(array).data)
        return digest.digest()


Rows = dict[int, NDArray[Any]]
"""Cells of parts by their number, ascending."""


def parts_along_graph(cells: Cells, parts: int) -> NDArray[np.int32]:
    """Part of each cell, along the dual graph."""
    joined = _symmetric(_all_pairs(cells), cells.total_cells)
    return dolfinx_compat.scotch_parts((joined.indices, joined.indptr), parts)


def bisected(centres: NDArray[np.floating], parts: int, part_range: range) -> Rows:
    """Parts by recursive bisection with planes across the longest extent.

    Of points in a cutting plane, those with lower numbers are below it. So the parts do not depend
    on which of them are requested.

    Parameters
    ----------
    centres : (dimension, cells)
    parts
        Number of parts, of nearly equal size.
    part_range
        Requested parts; other parts are not cut further.
    """
    result: Rows = {}
    left = [(np.arange(centres.shape[1], dtype=np.int32), list(centres), parts, 0)]
    while left:
        rows, places, count, first = left.pop()
        if count == 1:
            result[first] = rows
            continue
        half = count // 2
        below = _lowest(places[_longest(places)], len(rows) * half // count)
        for side, start, share in ((below, first, half), (~below, first + half, count - half)):
            if start < part_range.stop and part_range.start < start + share:
                inside = np.flatnonzero(side)
                left.append((rows[inside], [x[inside] for x in places], share, start))
    return result


def _longest(places: list[NDArray[np.floating]]) -> int:
    """The axis of largest extent; the last one of nearly equal axes.

    The last one, because nodes of a lattice are numbered along the first axes: ranks then own most
    nodes of their subdomains.
    """
    spread = []
    for x in places:
        away = x - x.mean()
        np.square(away, out=away)
        spread.append(float(away.mean()))
    return int(np.flatnonzero(np.array(spread) >= (1.0 - ALIKE) * max(spread))[-1])


def _lowest(x: NDArray[np.floating], count: int) -> Mask:
    """Mask of the `count` smallest numbers; of equal numbers the first ones."""
    cut = np.partition(x, count)[count]
    lowest = np.asarray(x < cut)
    equal = np.flatnonzero(x == cut)
    lowest[equal[: count - np.count_nonzero(lowest)]] = True
    return lowest


def rows_of(label: NDArray[np.int32], part_range: range) -> Rows:
    """Cells of the wanted parts by the part of each cell."""
    inside = np.flatnonzero((label >= part_range.start) & (label < part_range.stop))
    ones, ends = np.ones(len(inside), np.int8), np.arange(len(inside) + 1)
    part = sparse.csr_matrix(
        (ones, label[inside] - part_range.start, ends), (len(inside), len(part_range))
    )
    by_part = part.tocsc()  # sorts by counting
    return {
        part: inside[by_part.indices[a:b]]
        for part, a, b in zip(part_range, by_part.indptr[:-1], by_part.indptr[1:], strict=True)
    }


def through_facets(cells: Cells, rows: Rows) -> tuple[NDArray[np.int32], Ints]:
    """The facet-connected pieces of some parts.

    Returns
    -------
    Piece of each cell (cells,), -1 outside the parts, and the part of each piece (pieces,),
    ascending.
    """
    label = _labels(cells, rows)
    inside = np.flatnonzero(label >= 0)
    number = np.empty(len(label), np.int32)
    number[inside] = np.arange(len(inside))
    ends = cells.neighbours(label, lambda a, b: (a == b) & (a >= 0))
    count, component = connected_components(
        _graph((number[ends[0]], number[ends[1]]), len(inside)), directed=False
    )
    part = np.empty(count, np.int64)
    part[component] = label[inside]
    order = np.argsort(part, kind="stable")  # numbers do not depend on the search above
    renumber = np.empty(count, np.int32)
    renumber[order] = np.arange(count)
    label[inside] = renumber[component]
    return label, part[order]


def without_crumbs(
    cells: Cells, label: NDArray[np.int32], part: Ints, parts: int
) -> NDArray[np.int32]:
    """Join small separate pieces of a part to the piece with most common facets.

    Parameters
    ----------
    label : (cells,)
        Piece of each cell.
    part : (pieces,)
        Part of each piece, ascending.
    parts
        Number of requested parts. A piece below `CRUMB` of their mean size joins another piece,
        unless it is the largest of its part.

    Returns
    -------
    The subdomain of each cell.
    """
    size = np.bincount(label)
    largest = np.zeros(part.max() + 1, np.int64)
    np.maximum.at(largest, part, size)
    crumb = (size < CRUMB * len(label) / parts) & (size < largest[part])
    ends = cells.neighbours(crumb[label], lambda a, b: a | b)
    sides = np.stack([label[end] for end in ends], axis=1)
    sides = sides[sides[:, 0] != sides[:, 1]]
    taker = np.arange(len(size))
    crumbs = np.flatnonzero(crumb)
    for piece in crumbs[np.argsort(size[crumbs], kind="stable")]:
        of_piece = sides == piece
        out = sides[of_piece.any(axis=1)]
        taker[taker == piece] = at = np.bincount(out[out != piece]).argmax()
        sides[of_piece] = at
    _, subdomain = np.unique(taker, return_inverse=True)
    return subdomain.astype(np.int32)[label]


def pieces_of(cells: Cells, rows: Rows) -> dict[int, Piece]:
    """Cut parts out of a body: their cells, nodes and share of the surface."""
    label = _labels(cells, rows)
    skin = cells.skin(label >= 0)
    order = np.argsort(label[skin.cells], kind="stable")
    parts = sorted(rows)
    of = label[skin.cells][order]
    bounds = zip(*(np.searchsorted(of, parts, side=s) for s in ("left", "right")), strict=True)
    place = np.empty(cells.nodes, np.int32)  # only the entries of the nodes of this piece are valid
    result = {}
    for part, (a, b) in zip(parts, bounds, strict=True):
        members = order[a:b]
        nodes = cells.nodes_at(rows[part])
        used = distinct_numbers(nodes)
        place[used] = np.arange(len(used))
        result[part] = Piece(
            cell=cells.cell,
            degree=cells.degree,
            cells=place[nodes].astype(np.int64),
            tags=cells.tags_at(rows[part]),
            points=cells.points_at(used),
            nodes=used,
            exterior=in_order(place[skin.facets[members]]).astype(np.int64),
            boundaries={name: np.flatnonzero(on[members]) for name, on in skin.sides.items()},
        )
    return result


def _labels(cells: Cells, rows: Rows) -> NDArray[np.int32]:
    """Part of each cell; -1 for cells in no part."""
    label = np.full(cells.total_cells, -1, np.int32)
    for part, inside in rows.items():
        label[inside] = part
    return label


def _all_pairs(cells: Cells) -> Ints:
    """Cells that share a facet, (pairs, 2)."""
    every = np.ones(cells.total_cells, bool)
    return np.stack(cells.neighbours(every, lambda a, b: a & b), axis=1)


def place_piece(
    piece: Piece, body: int, number: int, first_node: int, references: dict[Any, Reference]
) -> Subdomain:
    """Build the subdomain of a piece, on a reference that congruent pieces share."""
    origin = piece.origin
    local = piece.points - origin
    if piece.kind not in references:
        order = VTK_ORDER[piece.cell]  # its own inverse
        degree = 2 if _curved(piece) else 1
        if degree == 2:
            order = tuple(np.argsort(vtk_order(piece.cell, degree)).tolist())
        nodes, corners = piece.cells[:, order], local
        if degree < piece.degree:
            used, inverse = np.unique(nodes, return_inverse=True)
            nodes, corners = inverse.reshape(nodes.shape), local[used]
        mesh = dolfinx_compat.create_mesh(nodes, corners, piece.cell, degree)
        references[piece.kind] = Reference.of(mesh, piece.cell, piece.degree, piece.tags)
    reference = references[piece.kind]
    node_of = np.empty(len(local), np.int64)
    node_of[reference.cells] = piece.cells[dolfinx_compat.original_cells(reference.mesh)]
    translation = np.zeros(3)
    translation[: len(origin)] = origin
    table = in_order(node_of[reference.facets])
    exterior = matching_rows(table, piece.exterior).astype(np.int32)
    return Subdomain(
        number=number,
        body=body,
        reference=reference,
        translation=translation,
        nodes=first_node + piece.nodes[node_of],
        exterior=exterior,
        boundaries={name: exterior[rows] for name, rows in piece.boundaries.items()},
    )


def _curved(piece: Piece) -> bool:
    """Whether any edge of a piece is curved."""
    if piece.degree == 1:
        return False
    x = piece.points[piece.cells]
    v = VERTICES[piece.cell]
    return bool(bulges(x[:, :v], x[:, v:], piece.cell).max() > STRAIGHT)


def _symmetric(pairs: Ints, size: int) -> sparse.csr_matrix:
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return _graph((both[:, 0], both[:, 1]), size)


def _graph(ends: tuple[NDArray[Any], NDArray[Any]], size: int) -> sparse.csr_matrix:
    ones = np.ones(len(ends[0]), dtype=np.int8)
    return sparse.csr_matrix((ones, ends), shape=(size, size))
