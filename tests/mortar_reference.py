"""Mortar rows of two flat-facetted surfaces, a second time: slowly, facet by facet.

The specification is that of `docs/scenes.md`; nothing is shared with the application. Overlaps
are intersections of half planes (scipy's Qhull), integrals tensor Gauss rules on triangles, shape
functions come from solving small systems, and the loops are Python's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError


@dataclass(frozen=True)
class Facet:
    """Nodes, coordinates (v, d) in order around, and outward unit normal (d,)."""

    nodes: tuple[int, ...]
    points: np.ndarray
    normal: np.ndarray


def facet(nodes: np.ndarray, points: np.ndarray, inside: np.ndarray) -> Facet:
    """Order the vertices (v, d) of a facet of a convex body around a point inside it."""
    if len(nodes) == 2:
        along = points[1] - points[0]
        normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        order = [0, 1]
    else:
        centred = points - points.mean(axis=0)
        u, _, vt = np.linalg.svd(centred)
        normal = vt[2]
        flat = centred @ vt[:2].T
        order = np.argsort(np.arctan2(flat[:, 1], flat[:, 0])).tolist()
    if normal @ (points[0] - inside) < 0:
        normal = -normal
    return Facet(tuple(int(n) for n in nodes[order]), points[order], normal)


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
    on: list[Facet], against: list[Facet]
) -> tuple[dict[int, dict[int, np.ndarray]], dict[int, float], dict[int, float]]:
    """Rows by `on` node: vectors by node, mean gap, area."""
    rows: dict[int, dict[int, np.ndarray]] = {}
    gaps: dict[int, float] = {}
    areas: dict[int, float] = {}
    full: dict[int, float] = {}
    near: dict[int, dict[int, float]] = {}
    for s in on:
        d, v = len(s.normal), len(s.nodes)
        tangents = np.linalg.svd(np.eye(d) - np.outer(s.normal, s.normal))[0][:, : d - 1]
        origin = s.points[0]
        flat = (s.points - origin) @ tangents
        own, weight, pieces = np.zeros((v, v)), np.zeros(v), []
        for m in against:
            if s.normal @ m.normal > -0.5:
                continue
            other = (m.points - origin) @ tangents
            for x, w in overlap(flat, other):
                phi, theirs = shape(flat, x), shape(other, x)
                gap = s.normal @ (theirs @ m.points - phi @ s.points)
                own += w * np.outer(phi, phi)
                weight += w * phi
                pieces.append((m, w, phi, theirs, gap))
        area = np.ptp(flat) if d == 2 else ConvexHull(flat).volume
        covered = weight.sum() > (1 - 1e-6) * area
        C = np.diag(weight) @ np.linalg.inv(own) if covered else np.eye(v)
        slave = np.diag(weight) if covered else own
        for node in s.nodes:
            full[node] = full.get(node, 0.0) + area / v
        if not pieces:
            continue
        for j, node in enumerate(s.nodes):
            row = rows.setdefault(node, {})
            areas[node] = areas.get(node, 0.0) + weight[j]
            for k, there in enumerate(s.nodes):
                row[there] = row.get(there, 0.0) + slave[j, k] * s.normal
                if there != node:
                    near.setdefault(node, {})
                    near[node][there] = near[node].get(there, 0.0) + weight[k]
            for m, w, phi, theirs, gap in pieces:
                psi = C[j] @ phi
                gaps[node] = gaps.get(node, 0.0) + w * psi * gap
                for k, there in enumerate(m.nodes):
                    row[there] = row.get(there, 0.0) - w * psi * theirs[k] * s.normal
    weak = {n for n in rows if areas[n] < 0.01 * full[n]}
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
