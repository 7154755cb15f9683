"""The surface of a mesh as segments or plane triangles, with bounds on their distance from it.

A straight facet is a segment, a triangle, or (a quadrilateral) two triangles. A facet with curved
edges is divided into n parts along each edge, with nodes on the true surface. With b the largest
distance of a node of second order from the middle of its vertices, the chords of a quadratic edge
are b / n² away from it, the triangles of a quadratic patch at most 4/3 b / n², those of a
biquadratic one at most 2 b / n² (its second derivatives are constant along an edge; the error of
linear interpolation is h²/8 times that, in each direction). A bilinear quadrilateral whose corners
a, b, c, d are not in one plane is |a - b + c - d| / (4 n²) from its triangles. n is chosen so that
this deviation is at most `FINE` times the size of the facet, but n is at most `MOST`. Facets joined
by curved edges have the same n, so that the surface stays closed.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from meshes.quadratic import CENTRED, STRAIGHT, VERTICES, facet_table, node_vertices
from meshes.subdomains import VTK_ORDER, vtk_shapes
from meshes.unstructured import FACETS, Topology

FINE = 0.05
"""Target of the deviation of the chords over the size of a facet."""

MOST = {2: 32, 3: 8}
"""Largest number of divisions along an edge of a facet, by dimension."""


@dataclass(frozen=True, eq=False)
class Chords:
    """The surface as simplices."""

    places: Array  # (nodes, d)
    simplices: Ints  # (simplices, d)
    """Rows of `places`; normals by the right-hand rule (in 2D to the right) point outward."""
    facet: Ints  # (simplices,)
    """Row of the facet of each simplex."""
    deviation: Array  # (facets,)
    """Largest distance of the simplices from each facet."""
    size: Array  # (facets,)
    """The least of the heights of a facet over its edges (in 2D, its length) and of the height of
    its cell over it."""


def chords(
    points: Array, cells: Ints, cell: str, topology: Topology, middles: Array | None
) -> Chords:
    """Divide the surface of a mesh into simplices.

    Parameters
    ----------
    points : (nodes, d)
    cells : (cells, vertices)
    middles : (cells, further nodes, d)
        The nodes of second order where edges are curved.
    """
    facets = topology.facets
    size = _sizes(points, cells, cell, topology)
    bend = _twists(points[facets])
    local = topology.facet_numbers
    curved = np.zeros((len(facets), len(FACETS[cell][0])), bool)
    if middles is not None:
        bulge, curved = _bulges(points, middles, cell, topology, local)
        bend = bend + (4.0 / 3.0 if cell == "tetrahedron" else 2.0) * bulge
    bent = np.flatnonzero(bend)
    extent = np.ptp(points[facets[bent]], axis=1).max(axis=1)
    bend[bent[bend[bent] <= STRAIGHT * extent]] = 0.0
    n = np.ceil(np.sqrt(bend / (FINE * size))).clip(1, MOST[points.shape[1]]).astype(np.int64)
    n = _joined(n, facets, curved)
    if (n == 1).all():
        weights, split = _split(facets.shape[1], 1)
        simplices = facets[:, weights.argmax(axis=1)[split]].reshape(-1, points.shape[1])
        facet = np.repeat(np.arange(len(facets)), len(split))
        return Chords(points, simplices, facet, bend, size)
    nodes = points[cells] if middles is None else np.concatenate([points[cells], middles], axis=1)
    places, simplices, facet = _divided(nodes, cell, topology, local, n)
    return Chords(places, simplices, facet, bend / n**2, size)


def reference_vertices(cell: str) -> Array:
    """Vertices of the reference cell in VTK order, (vertices, d)."""
    return dolfinx_compat.lagrange_nodes(cell, 1)[1][list(VTK_ORDER[cell])]


def _sizes(points: Array, cells: Ints, cell: str, topology: Topology) -> Array:
    """Sizes (facets,) as in `Chords.size`."""
    x, behind = points[topology.facets], points[cells[topology.facet_cells]]
    corners = x.shape[1]
    sides = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    size, area, normal = _normals(x)
    if corners > 2:
        size = 2.0 * area / sides.max(axis=1) / (2.0 if corners == 4 else 1.0)
    centre, middle = (np.einsum("fki->fi", y) / y.shape[1] for y in (behind, x))
    away = np.abs(np.einsum("fi,fi->f", centre - middle, normal))
    layers = 2.0 if cell in CENTRED else points.shape[1] + 1.0
    return np.minimum(size, layers * away)


def _normals(x: Array) -> tuple[Array, Array, Array]:
    """Length (in 3D unused), area (length) and unit normal of facets (facets, corners, d)."""
    if x.shape[1] == 2:
        along = x[:, 1] - x[:, 0]
        length = np.linalg.norm(along, axis=1)
        return length, length, np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None]
    if x.shape[1] == 3:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    else:
        normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    double = np.maximum(np.linalg.norm(normal, axis=1), np.finfo(float).tiny)
    return double, 0.5 * double, normal / double[:, None]


def _twists(x: Array) -> Array:
    """Distance of quadrilaterals (facets, 4, 3) from their two triangles; 0 for other facets."""
    if x.shape[1] < 4:
        return np.zeros(len(x))
    return np.linalg.norm(x[:, 0] - x[:, 1] + x[:, 2] - x[:, 3], axis=1) / 4.0


def _bulges(
    points: Array, middles: Array, cell: str, topology: Topology, local: Ints
) -> tuple[Array, Mask]:
    """Distance of second-order nodes from the middle of their vertices, and the curved edges.

    Returns the largest distance (facets,) and the mask of curved edges (facets, edges).
    """
    facets, v, on = topology.facets, VERTICES[cell], node_vertices(cell)
    corners = len(FACETS[cell][0])
    table = facet_table(FACETS[cell], cell)[:, corners:]
    bulge = np.zeros(len(facets))
    curved = np.zeros((len(facets), corners), bool)
    for f, around in enumerate(FACETS[cell]):
        rows = np.flatnonzero(local == f)
        x = points[facets[rows]]
        least = STRAIGHT * np.ptp(x, axis=1).max(axis=1)
        for node in table[f]:
            vertices = [around.index(i) for i in on[node]]
            middle = middles[topology.facet_cells[rows], node - v]
            away = np.linalg.norm(middle - x[:, vertices].mean(axis=1), axis=1)
            bulge[rows] = np.maximum(bulge[rows], away)
            for k in range(corners):
                if len(vertices) == 2 and {k, (k + 1) % corners} == set(vertices):
                    curved[rows, k] = away > least
    return bulge, curved


def _joined(n: Ints, facets: Ints, curved: Mask) -> Ints:
    """The largest n of all facets joined to one another by curved edges, (facets,)."""
    if facets.shape[1] == 2 or not curved.any():
        return n
    row, k = np.nonzero(curved)
    ends = np.sort(np.stack([facets[row, k], facets[row, (k + 1) % facets.shape[1]]], 1), axis=1)
    edge = np.unique(ends, axis=0, return_inverse=True)[1].ravel()
    total = len(facets) + edge.max() + 1
    label = connected((row, len(facets) + edge), total)[: len(facets)]
    most = np.zeros(label.max() + 1, np.int64)
    np.maximum.at(most, label, n)
    return most[label]


@cache
def _split(corners: int, n: int) -> tuple[Ints, Ints]:
    """A facet divided into n along each edge: weights of its corners and simplices.

    Weights are whole numbers (points, corners) over n (over n² for quadrilaterals); the simplices
    (simplices, d) are oriented as the facet is.
    """
    if corners == 2:
        k = np.arange(n + 1)
        return np.stack([n - k, k], axis=1), np.stack([k[:-1], k[1:]], axis=1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    row = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (m.ravel() for m in (row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]))
    lower = np.stack([a, b, c if corners == 4 else d], axis=1)
    upper = np.stack([a, c, d] if corners == 4 else [b, c, d], axis=1)
    if corners == 4:
        weights = np.stack([(n - i) * (n - j), i * (n - j), i * j, (n - i) * j], axis=1)
        return weights, np.concatenate([lower, upper])
    weights = np.stack([n - i - j, i, j], axis=1)
    within = weights[:, 0] >= 0
    number = np.cumsum(within) - 1
    simplices = np.concatenate([lower, upper])
    return weights[within], number[simplices[within[simplices].all(axis=1)]]


def _divided(
    nodes: Array, cell: str, topology: Topology, local: Ints, n: Ints
) -> tuple[Array, Ints, Ints]:
    """Places, simplices and their facets; facet f is divided into n[f] along each edge."""
    corners = len(FACETS[cell][0])
    vertices = reference_vertices(cell)
    degree = 1 if nodes.shape[1] == VERTICES[cell] else 2
    places, keys, simplices, owners, count = [], [], [], [], 0
    for f, table in enumerate(FACETS[cell]):
        for m in np.unique(n[local == f]):
            rows = np.flatnonzero((local == f) & (n == m))
            weights, split = _split(corners, int(m))
            unit = weights / weights.sum(axis=1, keepdims=True)
            shapes = vtk_shapes(cell, degree, unit @ vertices[list(table)])[0]
            places.append((shapes @ nodes[topology.facet_cells[rows]]).reshape(-1, nodes.shape[2]))
            keys.append(_keys(topology.facets[rows], rows, weights))
            parts = count + len(weights) * np.arange(len(rows))[:, None, None] + split
            simplices.append(parts.reshape(-1, nodes.shape[2]))
            owners.append(np.repeat(rows, len(split)))
            count += len(weights) * len(rows)
    key = np.concatenate(keys)
    first, number = np.unique(key, axis=0, return_index=True, return_inverse=True)[1:]
    return (
        np.concatenate(places)[first],
        number.ravel()[np.concatenate(simplices)],
        np.concatenate(owners),
    )


def _keys(facets: Ints, rows: Ints, weights: Ints) -> Ints:
    """Four numbers for each point of facets, equal where two facets share the point.

    A corner has (node, -1, 0, 0); a point of an edge the two nodes of the edge, the lower one
    first, and how far it is from the first (a fraction in lowest terms); others their facet.
    """
    on = weights > 0
    key = np.zeros((len(facets), len(weights), 4), np.int64)
    for p, (weight, has) in enumerate(zip(weights, on, strict=True)):
        at = np.flatnonzero(has)
        if len(at) == 1:
            key[:, p, 0], key[:, p, 1] = facets[:, at[0]], -1
        elif len(at) == 2:
            a, b = facets[:, at[0]], facets[:, at[1]]
            share = np.where(a < b, weight[at[1]], weight[at[0]])
            total = int(weight.sum())
            common = np.gcd(share, total)
            key[:, p] = np.stack(
                [np.minimum(a, b), np.maximum(a, b), share // common, total // common], axis=1
            )
        else:
            key[:, p, 0], key[:, p, 1], key[:, p, 2] = rows, -2, p
    return key.reshape(-1, 4)
