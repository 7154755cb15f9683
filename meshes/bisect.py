"""Local refinement of triangles and tetrahedra: marked edges are halved, without hanging nodes.

All edges have one order: longer ones first, equal ones by the numbers of their ends. A cell is cut
in two at the first of its marked edges, each half at the first of its remaining marked edges, and
so on. A facet between two cells is cut in the same order from both sides, so that the mesh stays
conforming. To keep the shapes of cells good, further edges are marked before: if a cell or one of
its facets has a marked edge, its longest edge is marked, too (M. C. Rivara, *Algorithms for
refining triangular grids suitable for adaptive and multigrid techniques*, IJNME 20, 1984; A. Plaza,
G. F. Carey, *Local refinement of simplicial grids based on the skeleton*, Appl. Numer. Math. 32,
2000).

New nodes are midpoints of straight edges: a boundary stays the same polygon or polyhedron.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np

from meshes.arrays import Ints
from meshes.unstructured import CellMesh, Topology, matching_rows

ALIKE = 1e-9
"""Relative difference up to which lengths count as equal."""


def bisected(mesh: CellMesh, marked: Ints) -> CellMesh:
    """The mesh with all edges of some cells halved, and further edges that keep it conforming.

    Parameters
    ----------
    mesh
        Triangles or tetrahedra with straight edges, of degree 1.
    marked : (n,)
        Cells.

    Returns
    -------
    The refined mesh, with the groups and named boundaries of the old one.
    """
    if mesh.cell not in ("triangle", "tetrahedron") or mesh.degree != 1:
        raise ValueError("only first-order triangles and tetrahedra are bisected")
    edges, of_cells = _edges(mesh.cells)
    lengths = np.linalg.norm(np.diff(mesh.points[edges], axis=1)[:, 0], axis=1)
    size_classes = np.round(np.log(lengths) / ALIKE)
    order = np.lexsort((np.arange(len(edges)), -size_classes))
    rank = np.empty(len(edges), np.int64)
    rank[order] = np.arange(len(edges))

    halved = np.zeros(len(edges), bool)
    halved[of_cells[marked]] = True
    groups = [of_cells]
    if mesh.cell == "tetrahedron":
        pairs = list(combinations(range(4), 2))
        groups += [
            of_cells[:, [k for k, pair in enumerate(pairs) if set(pair) <= set(face)]]
            for face in combinations(range(4), 3)
        ]
    while True:
        before = halved.sum()
        for group in groups:
            touched = group[halved[group].any(axis=1)]
            first = rank[touched].argmin(axis=1)
            halved[touched[np.arange(len(touched)), first]] = True
        if halved.sum() == before:
            break

    chosen = np.flatnonzero(halved)
    chosen = chosen[np.argsort(rank[chosen])]
    ends = edges[chosen]
    middles = len(mesh.points) + np.arange(len(ends))
    points = np.concatenate([mesh.points, mesh.points[ends].mean(axis=1)])
    cells, parent = _cut(mesh.cells, ends, middles)
    topology = Topology.of(cells, mesh.cell)
    pieces, facet = _cut(mesh.topology.facets, ends, middles)
    place = matching_rows(np.sort(topology.facets, axis=1), np.sort(pieces, axis=1))
    return replace(
        mesh,
        points=points,
        cells=cells,
        topology=topology,
        sides={
            name: np.sort(place[np.isin(facet, rows)]).astype(np.int32)
            for name, rows in mesh.sides.items()
        },
        groups={name: np.flatnonzero(np.isin(parent, rows)) for name, rows in mesh.groups.items()},
        inner={name: np.flatnonzero(np.isin(parent, rows)) for name, rows in mesh.inner.items()},
        tags=mesh.tags[parent],
        coarse=mesh.coarse or mesh,
    )


def _edges(cells: Ints) -> tuple[Ints, Ints]:
    """Ends of the edges (n, 2), ascending, and the edges of each cell by pairs of its vertices."""
    pairs = np.array(list(combinations(range(cells.shape[1]), 2)))
    ends = np.sort(cells[:, pairs].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    return edges, number.reshape(len(cells), -1)


def _cut(simplices: Ints, ends: Ints, middles: Ints) -> tuple[Ints, Ints]:
    """Simplices (n, vertices) cut at edges, and the given simplex of each part.

    Parameters
    ----------
    ends : (edges, 2)
        Ends of each edge, ascending; edges in the order of the cuts.
    middles : (edges,)
        Their nodes.
    """
    parent = np.arange(len(simplices))
    pairs = np.array(list(combinations(range(simplices.shape[1]), 2)))
    most = max(int(simplices.max(initial=0)), int(middles.max(initial=0))) + 1
    keys = ends[:, 0] * most + ends[:, 1]
    sorting = np.argsort(keys)
    finished, ancestors = [], []
    while len(simplices):
        edges = np.sort(simplices[:, pairs], axis=2)
        key = edges[..., 0] * most + edges[..., 1]
        at = np.minimum(np.searchsorted(keys[sorting], key), len(keys) - 1)
        rank = np.where(keys[sorting][at] == key, sorting[at], len(keys))
        first = rank.argmin(axis=1)
        edge = rank[np.arange(len(rank)), first]
        unmarked = edge == len(keys)
        finished.append(simplices[unmarked])
        ancestors.append(parent[unmarked])
        simplices, parent, first, edge = (a[~unmarked] for a in (simplices, parent, first, edge))
        halves = []
        for side in (0, 1):
            half = simplices.copy()
            half[np.arange(len(half)), pairs[first, side]] = middles[edge]
            halves.append(half)
        simplices, parent = np.concatenate(halves), np.concatenate([parent, parent])
    return np.concatenate(finished), np.concatenate(ancestors)
