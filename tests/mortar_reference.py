"""Mortar rows of two flat-facetted surfaces, a second time: slowly, facet by facet.

The specification is that of `docs/guide/scenes.md`; nothing is shared with the application.
Overlaps are intersections of half planes (scipy's Qhull), integrals tensor Gauss rules on
triangles, shape functions come from solving small systems, and the loops are Python's.
"""

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError


@dataclass(frozen=True)
class Facet:
    """Nodes, coordinates (n, d), the v vertices first and in order around, outward unit normal."""

    nodes: tuple[int, ...]
    points: np.ndarray
    normal: np.ndarray
    vertices: int


VERTICES = {2: 2, 3: 3, 4: 4, 6: 3, 9: 4}
"""Vertices of a facet in space by its nodes; in the plane it has two."""


def facet(nodes: np.ndarray, points: np.ndarray, inside: np.ndarray) -> Facet:
    """Order the nodes (n, d) of a straight facet of a convex body around a point inside it."""
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    if points.shape[1] == 2:
        order = np.argsort(-distance)  # the middle last
        v = 2
        along = points[order[1]] - points[order[0]]
        normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    else:
        centred = points - points.mean(axis=0)
        u, _, vt = np.linalg.svd(centred)
        normal = vt[2]
        flat = centred @ vt[:2].T
        v = VERTICES[len(nodes)]
        corners = np.arange(v) if v == len(nodes) else _corners(flat)
        angle = np.arctan2(flat[corners, 1], flat[corners, 0])
        rest = np.setdiff1d(np.arange(len(nodes)), corners)
        order = np.concatenate([corners[np.argsort(angle)], rest])
    if normal @ (points[0] - inside) < 0:
        normal = -normal
    return Facet(tuple(int(n) for n in nodes[order]), points[order], normal, v)


def _corners(flat: np.ndarray) -> np.ndarray:
    """Nodes of a second-order facet (6 or 9, 2) that are no mean of two others."""
    middles = 0.5 * (flat[:, None] + flat)[~np.eye(len(flat), dtype=bool)]
    distance = np.linalg.norm(flat[:, None] - middles, axis=2).min(axis=1)
    return np.flatnonzero(distance > 1e-6 * np.ptp(flat))


def displacement_shape(points: np.ndarray, vertices: int, x: np.ndarray) -> np.ndarray:
    """Shape functions of the displacement (n,) at one point, by interpolating monomials."""
    if len(points) == vertices:
        return shape(points, x)
    corners = points[:vertices]
    if vertices == 4:  # biquadratic in the coordinates of the parallelogram
        edges = np.stack([corners[1] - corners[0], corners[3] - corners[0]], axis=1)
        powers = [(a, b) for a in range(3) for b in range(3)]
    else:
        edges = (corners[1:] - corners[0]).T
        powers = [(a,) for a in range(3)] if vertices == 2 else [
            (a, b) for a in range(3) for b in range(3 - a)
        ]  # fmt: skip
    at = np.linalg.solve(edges, np.column_stack([(points - corners[0]).T, x - corners[0]])).T
    monomials = np.array([np.prod(at ** np.array(p), axis=1) for p in powers])
    return np.linalg.solve(monomials[:, :-1], monomials[:, -1])


def shape(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Shape functions of a segment, triangle or parallelogram (v, d - 1) at one point."""
    v = len(points)
    if v == 4:
        r, s = np.linalg.solve(np.stack([points[1] - points[0], points[3] - points[0]], axis=1),
                               x - points[0])  # fmt: skip
        return np.array([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
    return np.linalg.solve(np.vstack([points.T, np.ones(v)]), np.append(x, 1.0))


def halfplanes(polygon: np.ndarray) -> np.ndarray:
    """Rows (a, b) with a·x + b ≤ 0 inside a convex polygon."""
    hull = ConvexHull(polygon)
    return hull.equations


def overlap(a: np.ndarray, b: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Gauss points and weights of the overlap of two segments (2, 1) or polygons (v, 2)."""
    t, w = np.polynomial.legendre.leggauss(4)
    t, w = 0.5 * (t + 1), 0.5 * w
    if a.shape[1] == 1:
        low, high = max(a.min(), b.min()), min(a.max(), b.max())
        if high - low < 1e-12 * np.ptp(a):
            return []
        return [
            (np.array([low + s * (high - low)]), (high - low) * k)
            for s, k in zip(t, w, strict=True)
        ]
    rows = np.vstack([halfplanes(a), halfplanes(b)])
    norm = np.linalg.norm(rows[:, :2], axis=1)
    found = linprog(  # the centre of the largest disc
        [0, 0, -1], A_ub=np.column_stack([rows[:, :2], norm]), b_ub=-rows[:, 2],
        bounds=[(None, None), (None, None), (0, None)],
    )  # fmt: skip
    if not found.success or found.x[2] < 1e-10 * np.ptp(a):
        return []
    centre = found.x[:2]
    try:
        corners = HalfspaceIntersection(rows, centre).intersections
    except QhullError:
        return []
    angle = np.arctan2(*(corners - centre).T[::-1])
    corners = corners[np.argsort(angle)]
    result = []
    for p, q in pairwise([*corners, corners[0]]):
        jacobian = abs(np.linalg.det(np.stack([p - centre, q - centre])))
        for s, ws in zip(t, w, strict=True):
            for r, wr in zip(t, w, strict=True):
                x = centre + s * ((1 - r) * (p - centre) + r * (q - centre))
                result.append((x, jacobian * s * ws * wr))
    return result


def mortar_rows(
    on: list[Facet], against: list[Facet], decided: Collection[int] = (), tied: bool = False
) -> tuple[dict[int, dict[int, np.ndarray]], dict[int, float], dict[int, float]]:
    """Rows by `on` node: vectors by node, mean gap, area.

    Rows of decided nodes are distributed to their neighbours.
    """
    rows: dict[int, dict[int, np.ndarray]] = {}
    gaps: dict[int, float] = {}
    areas: dict[int, float] = {}
    full: dict[int, float] = {}
    near: dict[int, dict[int, float]] = {}
    inside: set[int] = set()
    met: list[tuple[int, ...]] = []
    for s in on:
        d, v, second = len(s.normal), s.vertices, s.vertices < len(s.nodes)
        tangents = np.linalg.svd(np.eye(d) - np.outer(s.normal, s.normal))[0][:, : d - 1]
        origin = s.points[0]
        flat = (s.points - origin) @ tangents
        corners = flat[:v]
        own, weight, pieces = np.zeros((v, len(s.nodes))), np.zeros(v), []
        for m in against:
            if s.normal @ m.normal > -0.5:
                continue
            other = (m.points - origin) @ tangents
            for x, w in overlap(corners, other[: m.vertices]):
                psi = shape(corners, x)
                phi, theirs = (displacement_shape(p, k, x)
                               for p, k in ((flat, v), (other, m.vertices)))  # fmt: skip
                gap = s.normal @ (theirs @ m.points - phi @ s.points)
                own += w * np.outer(psi, phi)
                weight += w * psi
                pieces.append((m, w, psi, theirs, gap))
        area = np.ptp(flat) if d == 2 else ConvexHull(corners).volume
        covered = weight.sum() > (1 - 1e-6) * area
        dual = covered and not second
        C = np.diag(weight) @ np.linalg.inv(own) if dual else np.eye(v)
        slave = np.diag(weight) if dual else own
        for node in s.nodes[:v]:
            full[node] = full.get(node, 0.0) + area / v
        if not pieces:
            continue
        met.append(s.nodes[:v])
        inside |= set(s.nodes[:v]) if covered else set()
        for j, node in enumerate(s.nodes[:v]):
            row = rows.setdefault(node, {})
            areas[node] = areas.get(node, 0.0) + weight[j]
            for k, there in enumerate(s.nodes):
                row[there] = row.get(there, 0.0) + slave[j, k] * s.normal
                if there != node and k < v:
                    near.setdefault(node, {})
                    near[node][there] = near[node].get(there, 0.0) + weight[k]
            for m, w, hat, theirs, gap in pieces:
                psi = C[j] @ hat
                gaps[node] = gaps.get(node, 0.0) + w * psi * gap
                for k, there in enumerate(m.nodes):
                    row[there] = row.get(there, 0.0) - w * psi * theirs[k] * s.normal
    beside = {n for nodes in met if inside & set(nodes) for n in nodes}
    beyond = set() if tied else beside - inside
    strip = 0.15 if any(len(s.nodes) > s.vertices for s in on) else 0.05
    least = {n: strip if n in beyond else 0.01 for n in rows}
    weak = {n for n in rows if areas[n] < least[n] * full[n] or n in decided}
    before = {n: (dict(rows[n]), gaps[n], areas[n]) for n in weak}
    for n in weak:
        heirs = {k: w for k, w in near[n].items() if k not in weak and k in rows and w > 0}
        if not heirs:
            continue
        row, gap, area = before[n]
        for k, w in heirs.items():
            share = w / sum(heirs.values())
            for there, vector in row.items():
                rows[k][there] = rows[k].get(there, 0.0) + share * vector
            gaps[k] += share * gap
            areas[k] += share * area
        del rows[n], gaps[n], areas[n]
    for n in rows:
        rows[n] = {k: vector / areas[n] for k, vector in rows[n].items()}
        gaps[n] /= areas[n]
    return rows, gaps, areas
