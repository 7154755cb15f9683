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

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SMOOTH = np.deg2rad(30.0)
"""Angle between facets above which their edge is not part of a round surface."""

RANK = 1e-6
"""Normals are not fitted along axes on which centres of facets spread less, over the largest."""

MOST_LAYERS = 4
"""Layers of facets about a vertex that are tried for a fit; the first two where these suffice."""

FEWEST_POINTS = (3, 8)
"""Vertices besides its own from which a quadric is fitted, in the plane and in space: as many as it
has coefficients, and two more in space, where vertices may lie on two lines."""

Array = NDArray[np.float64]


def bulges(corners: NDArray[np.int64], points: Array, normals: Array) -> Array:
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


def _normals_at_vertices(corners: NDArray[np.int64], points: Array, normals: Array) -> Array:
    """Normals of the smooth surface at the vertices of each facet, (facets, v, 3)."""
    facets, v = corners.shape
    numbers, at, place = np.unique(corners, return_index=True, return_inverse=True)
    vertices, place = points.reshape(-1, 3)[at], place.reshape(corners.shape)
    of_vertex: list[list[int]] = [[] for _ in numbers]
    for facet, nodes in enumerate(place):
        for vertex in nodes:
            of_vertex[vertex].append(facet)
    centres = points.mean(axis=1)
    sizes = np.linalg.norm(points - centres[:, None], axis=2).max(axis=1)
    area = sizes ** (points.shape[1] - 1 if v == 2 else 2)
    result = np.empty((facets, v, 3))
    of_ring: dict[tuple[int, bytes], Array] = {}
    for facet in range(facets):
        for k in range(v):
            near = set(of_vertex[place[facet, k]])
            for layer in range(MOST_LAYERS):
                near = {g for f in near for w in place[f] for g in of_vertex[w]}
                ring = np.array(sorted(near))
                ring = ring[normals[ring] @ normals[facet] > np.cos(2.0 * SMOOTH)]
                if layer and len(np.unique(place[ring])) > FEWEST_POINTS[v > 2]:
                    break
            key = int(place[facet, k]), ring.tobytes()
            if key not in of_ring:
                first = _fitted(centres[ring] - points[facet, k], normals[ring], area[ring])
                others = np.setdiff1d(place[ring], place[facet, k])
                around = vertices[others] - vertices[place[facet, k]]
                of_ring[key] = _of_quadric(around, first)
            result[facet, k] = of_ring[key]
    return result


def _of_quadric(around: Array, normal: Array) -> Array:
    """Normal at zero of the quadric through zero near points (n, 3), given about its normal.

    Where the points do not determine the quadric, its coefficients are the smallest, C in the
    Frobenius norm: so the normal does not depend on the axes of s.
    """
    size = np.linalg.norm(around, axis=1)
    axes = np.linalg.svd(normal[None])[2][1:]
    s, h = around @ axes.T / size.max(), around @ normal / size.max()
    twist = np.sqrt(2.0) * s[:, 0] * s[:, 1]
    square = np.column_stack([s[:, 0] ** 2, twist, s[:, 1] ** 2, h**2])
    columns = np.hstack([s, square]) / size[:, None]
    slopes = np.linalg.lstsq(columns, h / size, rcond=RANK)[0][:2]
    value = normal - slopes @ axes
    return np.asarray(value / np.linalg.norm(value))


def _fitted(away: Array, normals: Array, weights: Array) -> Array:
    """Value at zero of a linear fit to normals (n, 3) at places (n, 3), a unit vector."""
    root = np.sqrt(weights)[:, None]
    mean = (weights @ away) / weights.sum()
    _, spread, axes = np.linalg.svd((away - mean) * root, full_matrices=False)
    axes = axes[:2][spread[:2] > RANK * spread[0]] if spread[0] > 0.0 else axes[:0]
    columns = np.hstack([np.ones((len(away), 1)), away @ axes.T])
    value = np.linalg.lstsq(columns * root, normals * root, rcond=None)[0][0]
    return np.asarray(value / np.linalg.norm(value))
