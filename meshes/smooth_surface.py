"""Approximation of a smooth surface by flat facets with vertices on it.

A facet of size h on a surface of radius R lies up to h²/8R below it. With the normals n_a of the
smooth surface at the vertices x_a of a facet and the linear shape functions φ_a, the height above
the facet is

    δ = ½ Σ_{a<b} φ_a φ_b (x_b - x_a)·(n_b - n_a),

on a sphere or a cylinder (n_b - n_a = (x_b - x_a)/R across it) the height of the parabola through
the vertices, with an error of fourth order (the quadratic form of curved point-normal triangles; A.
Vlachos and others, Curved PN triangles, 2001).

The normal at a vertex is that of a quadric through it, h = b·s + ½ s·C s + e h², which circles,
cylinders and balls are, fitted to the heights h of the vertices around it. Its frame is a first
normal: the value of a linear fit to the normals of the facets there, each at the centre of its
facet and weighted by the area. The normal of a triangle is not that of the surface there. On the
bore of `hub_on_shaft.yaml`, heights by the first normals are off by up to a tenth of the sagitta,
those of the quadric by a hundredth. The fits are as accurate at the end of a boundary as inside. If
two facets meet at an angle above `SMOOTH`, their edge is an edge of the body, and the fit of one
ignores the other.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from meshes.arrays import Array, Ints

SMOOTH = np.deg2rad(30.0)
"""Angle between facets above which their edge is not part of a round surface."""

RANK = 1e-6
"""Normals are not fitted along axes on which centres of facets spread less, over the largest."""

MOST_LAYERS = 4
"""Layers of facets about a vertex that are tried for a fit; the first two where these suffice."""

FEWEST_POINTS = (3, 8)
"""Vertices besides its own from which a quadric is fitted, in the plane and in space: as many as it
has coefficients, and two more in space, where vertices may lie on two lines."""

ROUNDING = 1e-13
"""Singular values below this times the largest are rounding errors."""

AT_ONCE = 20_000
"""Corners of facets whose normals are fitted together: some 50 facets lie about each, so that their
coordinates take 25 MB."""


def bulges(corners: Ints, points: Array, normals: Array) -> Array:
    """½ (x_b - x_a)·(n_b - n_a) of the vertices of each facet, (facets, v, v).

    Parameters
    ----------
    corners : (facets, v)
        Numbers of the vertices.
    points : (facets, v, 3)
        Their coordinates.
    normals : (facets, 3)
        Outward unit normals.
    """
    at_vertices = _normals_at_vertices(corners, points, normals)
    x = points[:, None, :] - points[:, :, None]
    n = at_vertices[:, None, :] - at_vertices[:, :, None]
    return np.asarray(0.5 * np.einsum("fabi,fabi->fab", x, n))


def _normals_at_vertices(corners: Ints, points: Array, normals: Array) -> Array:
    """Normals of the smooth surface at the vertices of each facet, (facets, v, 3)."""
    facets, v = corners.shape
    _, at, place = np.unique(corners, return_index=True, return_inverse=True)
    mesh = _Facets.of(place.reshape(corners.shape), points.reshape(-1, 3)[at], points, normals)
    result = np.empty((facets * v, 3))
    missing = np.argsort(place.ravel(), kind="stable")
    about = mesh.of_vertices @ mesh.neighbours
    for layer in range(1, MOST_LAYERS):
        about = about @ mesh.neighbours
        few = [
            _fit(mesh, part, about[place.ravel()[part]], result, layer == MOST_LAYERS - 1)
            for part in np.split(missing, np.arange(AT_ONCE, len(missing), AT_ONCE))
        ]
        missing = np.concatenate(few)
        if len(missing) == 0:
            break
    return result.reshape(facets, v, 3)


@dataclass(frozen=True, eq=False)
class _Facets:
    """The facets of a surface."""

    place: Ints  # (facets, v)
    """Vertices of each."""
    vertices: Array  # (vertices, 3)
    centres: Array
    normals: Array
    """Shape (facets, 3)."""
    areas: Array  # (facets,)
    """In their order of magnitude."""
    vertices_of: csr_matrix  # (facets, vertices)
    """Ones at the vertices of each."""
    neighbours: csr_matrix  # (facets, facets)
    """Positive where two share a vertex."""

    @classmethod
    def of(cls, place: Ints, vertices: Array, points: Array, normals: Array) -> "_Facets":
        """Facets with corners at points (facets, v, 3)."""
        facets, v = place.shape
        starts = np.arange(0, facets * v + 1, v)
        shape = facets, len(vertices)
        vertices_of = csr_matrix((np.ones(facets * v, bool), place.ravel(), starts), shape)
        centres = points.mean(axis=1)
        sizes = np.linalg.norm(points - centres[:, None], axis=2).max(axis=1)
        areas = sizes ** (v - 1 if v == 2 else 2)
        neighbours = (vertices_of @ vertices_of.T).tocsr()
        return cls(place, vertices, centres, normals, areas, vertices_of, neighbours)

    @property
    def of_vertices(self) -> csr_matrix:
        """Facets of each vertex, (vertices, facets)."""
        return self.vertices_of.T.tocsr()


def _fit(mesh: _Facets, corners: Ints, about: csr_matrix, result: Array, last: bool) -> Ints:
    """Write the normals at corners (c,); return the corners with too few vertices, unless last.

    Parameters
    ----------
    about : (c, facets)
        Facets about each.
    """
    v = mesh.place.shape[1]
    rings = _of_one_side(about, mesh.normals, corners // v)
    vertex = mesh.place.ravel()[corners]
    first, same = _distinct(vertex, rings)
    rings, vertex = rings[first], vertex[first]
    around = (rings @ mesh.vertices_of).tocsr()
    enough = np.diff(around.indptr) > FEWEST_POINTS[v > 2]
    if last:
        enough[:] = True
    if not enough.any():
        return corners
    rings, around, vertex = rings[enough], around[enough], vertex[enough]
    origin = mesh.vertices[vertex]
    facets, weights = _padded(rings)
    normal = _fitted(
        mesh.centres[facets] - origin[:, None], mesh.normals[facets], weights * mesh.areas[facets]
    )
    others, weights = _padded(around)
    away = (mesh.vertices[others] - origin[:, None]) * weights[..., None]
    values = np.empty((len(first), 3))
    values[enough] = _of_quadric(away, normal)
    result[corners[enough[same]]] = values[same[enough[same]]]
    return np.asarray(corners[~enough[same]])


def _of_one_side(about: csr_matrix, normals: Array, facets: Ints) -> csr_matrix:
    """Facets about each corner (c, facets) that no edge of the body parts from its own facet."""
    row = np.repeat(np.arange(about.shape[0]), np.diff(about.indptr))
    cosine = np.einsum("ri,ri->r", normals[about.indices], normals[facets[row]])
    smooth = cosine > np.cos(2.0 * SMOOTH)
    entries = np.ones(smooth.sum(), bool), (row[smooth], about.indices[smooth])
    return csr_matrix(entries, shape=about.shape)


def _distinct(vertex: Ints, rings: csr_matrix) -> tuple[Ints, Ints]:
    """First of the corners with one vertex and one set of facets, and their number for each.

    Sets are compared by sums of random numbers of their facets, modulo 2⁶⁴.
    """
    random = np.random.default_rng(0).integers(2**63, size=rings.shape[1], dtype=np.uint64)
    sums = np.add.reduceat(random[rings.indices], rings.indptr[:-1])
    keys = np.column_stack([vertex.astype(np.uint64), sums])
    _, first, same = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return first, same.ravel()


def _padded(rows: csr_matrix) -> tuple[Ints, Array]:
    """Columns of the entries of each row, (rows, most), and 1 where there is one, else 0."""
    counts = np.diff(rows.indptr)
    filled = np.arange(counts.max(initial=0)) < counts[:, None]
    columns = np.zeros(filled.shape, np.int64)
    columns[filled] = rows.indices
    return columns, filled.astype(np.float64)


def _of_quadric(around: Array, normal: Array) -> Array:
    """Normals at zero of quadrics through zero near points (r, n, 3), about given normals (r, 3).

    Points at zero do not count. Where the points do not determine the quadric, its coefficients
    are the smallest, C in the Frobenius norm: so the normal does not depend on the axes of s.
    """
    size = np.linalg.norm(around, axis=2)
    largest = size.max(axis=1)[:, None]
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    axes = np.linalg.svd(normal[:, None])[2][:, 1:]
    s = around @ axes.transpose(0, 2, 1) / largest[..., None]
    h = np.einsum("rni,ri->rn", around, normal) / largest
    x, y = s[..., 0], s[..., 1]
    columns = np.stack([x, y, x**2, np.sqrt(2.0) * x * y, y**2, h**2], axis=2)
    inverses = np.linalg.pinv(columns * inverse[..., None], rcond=RANK)
    slopes = np.einsum("rcn,rn->rc", inverses[:, :2], h * inverse)
    value = normal - np.einsum("rc,rci->ri", slopes, axes)
    return np.asarray(value / np.linalg.norm(value, axis=1, keepdims=True))


def _fitted(away: Array, normals: Array, weights: Array) -> Array:
    """Values at zero of linear fits to normals (r, n, 3) at places (r, n, 3), unit vectors."""
    root = np.sqrt(weights)[..., None]
    mean = np.einsum("rn,rni->ri", weights, away) / weights.sum(axis=1)[:, None]
    _, spread, axes = np.linalg.svd((away - mean[:, None]) * root, full_matrices=False)
    axes = axes[:, :2] * (spread[:, :2] > RANK * spread[:, :1])[..., None]
    columns = np.concatenate([np.ones_like(root), away @ axes.transpose(0, 2, 1)], axis=2)
    inverses = np.linalg.pinv(columns * root, rcond=ROUNDING)
    value = np.einsum("rn,rni->ri", inverses[:, 0], normals * root)
    return np.asarray(value / np.linalg.norm(value, axis=1, keepdims=True))
