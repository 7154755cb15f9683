"""Integrals over plane parts of the surface, by weights of nodes that stand in every textbook."""

from collections.abc import Callable
from typing import Any

import numpy as np

WEIGHTS = {
    (2, 2): [1 / 2] * 2,
    (2, 3): [1 / 6, 1 / 6, 4 / 6],
    (3, 3): [1 / 3] * 3,
    (3, 4): [1 / 4] * 4,
    (3, 6): [0.0] * 3 + [1 / 3] * 3,
    (3, 9): [1 / 36] * 4 + [4 / 36] * 4 + [16 / 36],
}
"""∫ φ_k over the area of a straight facet by dimension and nodes, vertices and middles in turn."""

Where = Callable[[np.ndarray], np.ndarray]


def facets(solved: Any, where: Where) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Nodes, points and areas of the surface facets of each subdomain all of whose nodes are there.

    Parallelograms and triangles.
    """
    d, found = solved.model.scene.dimension, []
    for s in solved.model.partition.subdomains:
        nodes = s.reference.facets[s.exterior]
        points = s.points()[nodes]
        chosen = where(points).all(axis=1)
        nodes, points = nodes[chosen], points[chosen]
        first, second = points[:, 1] - points[:, 0], points[:, min(2, d - 1)] - points[:, 0]
        if d == 2:
            area = np.linalg.norm(first, axis=1)
        else:
            area = np.linalg.norm(np.cross(first, second), axis=1)
            area *= 0.5 if nodes.shape[1] in (3, 6) else 1.0
        found.append((s.nodes[nodes], points, area))
    return found


def integral(solved: Any, where: Where, values: np.ndarray) -> np.ndarray:
    """∫ of values (nodes, …) over the facets there."""
    d = solved.model.scene.dimension
    total = np.zeros(values.shape[1:])
    for nodes, _, area in facets(solved, where):
        weight = np.array(WEIGHTS[d, nodes.shape[1]])
        total += np.einsum("f,k,fk...->...", area, weight, values[nodes])
    return total


def pressure_of(solved: Any, number: int) -> np.ndarray:
    """The pressure of a contact, counted as the scene does, at all nodes; 0 off its boundary."""
    values = np.zeros(len(solved.nodes.points))
    contact = solved.nodes.contacts[number]
    values[contact.nodes] = contact.pressure
    return values
