"""One side of a contact: its facets, oriented, with the frame of each."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.arrays import Array, Ints
from meshes.quadratic import FACETS
from meshes.smooth_surface import bulges

STRAIGHT = 1e-9
"""Distance of a middle node from the middle of its vertices, over the size: round-off."""


@dataclass(frozen=True, eq=False)
class Surface:
    """One side of a contact."""

    dimension: int
    """2 for lines, 3 for triangles and quadrilaterals."""
    nodes: Ints  # (facets, nodes per facet)
    """Global nodes: first the vertices, anticlockwise seen from outside. Facets of second order
    then have the middles of the edges that start in each vertex, and quadrilaterals their own
    middle."""
    points: Array  # (facets, nodes per facet, 3)
    """Coordinates."""
    normals: Array  # (facets, 3)
    """Outward unit normal of the plane of the vertices; for a warped quadrilateral normal to its
    diagonals."""
    bulge: Array | None = None  # (facets, v, v) or None
    """If the facets stand for a smooth surface: its height over a facet is ½ φᵀ bulge φ."""

    @classmethod
    def of(cls, dimension: int, nodes: Ints, points: Array, inside: Array) -> "Surface":
        """Order and orient facets.

        Parameters
        ----------
        nodes, points
            As the attributes; vertices first, otherwise in any order.
        inside : (facets, 3)
            A point of the body behind each facet.
        """
        order = np.lexsort(np.sort(nodes, axis=1).T)
        nodes, points, inside = nodes[order], points[order], inside[order]
        v = FACETS[dimension, nodes.shape[1]].vertices
        place = np.tile(np.arange(nodes.shape[1]), (len(nodes), 1))
        if v == 4:
            place[:, :v] = _around(points[:, :v])
        normals = _normals(np.take_along_axis(points, place[:, :v, None], axis=1))
        inward = np.einsum("ij,ij->i", normals, points[:, :v].mean(axis=1) - inside) < 0.0
        normals[inward] *= -1.0
        place[inward, :v] = place[inward, v - 1 :: -1]
        if nodes.shape[1] > v:
            vertices = np.take_along_axis(points, place[:, :v, None], axis=1)
            place[:, v:] = v + _middles(vertices, points[:, v:])
        return cls(
            dimension,
            np.take_along_axis(nodes, place, axis=1),
            np.take_along_axis(points, place[..., None], axis=1),
            normals,
        )

    def smooth(self) -> "Surface":
        """The surface with the heights of the smooth surface; unchanged where edges are curved."""
        v = self.vertices.shape[1]
        if is_curved(self.points, v):
            return self
        return replace(self, bulge=bulges(self.nodes[:, :v], self.vertices, self.normals))

    def height(self, facets: Ints, hats: Array) -> Array | float:
        """Height of the smooth surface over points of facets (q,) with hats (q, v)."""
        if self.bulge is None:
            return 0.0
        return 0.5 * np.einsum("qa,qab,qb->q", hats, self.bulge[facets], hats)

    def bulge_over(self, facets: Ints, corners: Array) -> Array:
        """Bulges of the smooth surface at facets (q,) over other facets near them, (q, v, v).

        Parameters
        ----------
        corners : (q, v, 3)
            Vertices of the other facets.
        """
        assert self.bulge is not None
        distinct, place = np.unique(facets, return_inverse=True)
        a, b = np.triu_indices(self.vertices.shape[1], 1)
        edges = self.vertices[distinct][:, b] - self.vertices[distinct][:, a]
        squares = (edges[..., :, None] * edges[..., None, :]).reshape(*edges.shape[:2], 9)
        curvatures = np.linalg.pinv(squares) @ self.bulge[distinct][:, a, b, None]
        other = corners[:, None] - corners[:, :, None]
        return np.einsum("qabi,qij,qabj->qab", other, curvatures.reshape(-1, 3, 3)[place], other)

    @property
    def vertices(self) -> Array:
        """Coordinates of the vertices, (facets, vertices, 3)."""
        return self.points[:, : FACETS[self.dimension, self.nodes.shape[1]].vertices]

    @cached_property
    def centres(self) -> Array:
        """Mean of the vertices of each facet, (facets, 3)."""
        return np.asarray(self.vertices.mean(axis=1))

    @cached_property
    def radii(self) -> Array:
        """Largest distance of a vertex from the centre, (facets,)."""
        away = self.vertices - self.centres[:, None]
        return np.asarray(np.linalg.norm(away, axis=2).max(axis=1))

    @cached_property
    def frames(self) -> Array:
        """Orthonormal axes of each facet, tangents first, the normal last, (facets, d, 3)."""
        normals = self.normals
        along = self.vertices[:, 1] - self.vertices[:, 0]
        along = along - np.einsum("ij,ij->i", along, normals)[:, None] * normals
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        if self.dimension == 2:
            return np.stack([along, normals], axis=1)
        return np.stack([along, np.cross(normals, along), normals], axis=1)

    @cached_property
    def areas(self) -> Array:
        """Area of each facet in its own plane, (facets,)."""
        away = self.vertices - self.centres[:, None]
        flat = np.einsum("pvk,pdk->pvd", away, self.frames)[..., :-1]
        if self.dimension == 2:
            return np.ptp(flat, axis=1)[:, 0]
        x, y = flat[..., 0], flat[..., 1]
        both = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
        return np.asarray(0.5 * np.abs(both.sum(axis=1)))


def is_curved(nodes: Array, v: int) -> bool:
    """Whether any facet (n, nodes, d) with v vertices has a node off its middle."""
    if nodes.shape[1] == v:
        return False
    corners = np.eye(v)
    hats = np.concatenate([0.5 * (corners + np.roll(corners, -1, axis=0)), np.full((1, v), 1 / v)])
    straight = np.einsum("mv,nvk->nmk", hats[: nodes.shape[1] - v], nodes[:, :v])
    size = np.ptp(nodes[:, :v], axis=1).max(initial=0.0)
    return bool(np.abs(nodes[:, v:] - straight).max(initial=0.0) > STRAIGHT * size)


def _around(points: Array) -> Ints:
    """Cyclic order of the vertices (n, 4): the order whose diagonals span the largest area."""
    orders = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 1, 3]])
    turned = points[:, orders]
    diagonals = turned[:, :, 2:] - turned[:, :, :2]
    area = np.linalg.norm(np.cross(diagonals[:, :, 0], diagonals[:, :, 1]), axis=-1)
    return orders[np.argmax(area, axis=1)]


def _middles(vertices: Array, points: Array) -> Ints:
    """Numbers of the further nodes (n, m, 3) in the middle of each edge, and of the facet."""
    targets = 0.5 * (vertices + np.roll(vertices, -1, axis=1))
    targets = np.concatenate([targets, vertices.mean(axis=1, keepdims=True)], axis=1)
    targets = targets[:, [0] if vertices.shape[1] == 2 else range(points.shape[1])]
    return np.linalg.norm(targets[:, :, None] - points[:, None], axis=3).argmin(axis=2)


def _normals(vertices: Array) -> Array:
    """Unit normals of facets (n, v, 3)."""
    if vertices.shape[1] == 2:
        along = vertices[:, 1] - vertices[:, 0]
        normals = np.stack([along[:, 1], -along[:, 0], np.zeros(len(along))], axis=1)
    elif vertices.shape[1] == 3:
        normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    else:
        normals = np.cross(vertices[:, 2] - vertices[:, 0], vertices[:, 3] - vertices[:, 1])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)
