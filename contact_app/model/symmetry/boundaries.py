"""A boundary of a symmetric body, on its lower half and on the mirror image of that."""

from dataclasses import dataclass
from hashlib import sha1
from typing import Any

import numpy as np

from contact_app.scene.bodies import Body
from meshes.arrays import Array, Mask
from meshes.symmetric_half import HalfSurface

Key = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class BoundaryPart:
    """A boundary of a symmetric body, on the surface of its lower half and of the image of it."""

    nodes: Mask
    facets: Mask
    """Masks of nodes and facets of the half on the boundary, and of those whose images are on it.
    Shapes (2, nodes), (2, facets)."""
    off_plane: Mask  # (nodes,)
    """Mask of the nodes that do not lie on the plane."""
    samples: Mask  # (2, points)
    """Values of an expression at further points."""

    def key(self, image: bool = False) -> Key:
        """A key that is equal for equal boundaries; with `image`, the key of the mirror image."""
        order = slice(None, None, -1) if image else slice(None)
        parts = [np.packbits(m[order], axis=1) for m in (self.nodes, self.facets, self.samples)]
        return tuple(sha1(p.tobytes(), usedforsecurity=False).digest() for p in parts)

    def on_lower_side(self, by_facets: bool) -> bool:
        """Whether a condition here acts on the half; otherwise it is the image of one that does."""
        below, above = (self.facets if by_facets else self.nodes & self.off_plane).any(axis=1)
        return bool(below or not above)


def part_of(body: Body, surface: HalfSurface, boundary: str, samples: int) -> BoundaryPart:
    """The parts of a boundary on a symmetric body."""
    off_plane, points = ~surface.on_plane, (surface.points, surface.images)
    if boundary not in body.boundaries:
        facets = np.stack(surface.sides[boundary])
        nodes = np.zeros((2, len(off_plane)), bool)
        for mask, rows in zip(nodes, facets, strict=True):
            mask[surface.facets[rows]] = True
        nodes |= nodes[::-1] & ~off_plane  # nodes on the plane are their own images
        return BoundaryPart(nodes, facets, off_plane, np.zeros((2, 0), bool))
    expression = body.boundaries[boundary]
    is_outside = np.ones(len(surface.facets), bool)
    for name in body.cuts:
        is_outside &= ~np.any(surface.sides[name], axis=0)
    both = list(zip(points, surface.of, strict=True))
    nodes = np.stack([expression(x) & has for x, has in both])
    nodes[1, ~off_plane] = nodes[0, ~off_plane]
    facets = nodes[:, surface.facets].all(axis=2) & is_outside
    on_surface = np.zeros(len(off_plane), bool)
    on_surface[surface.facets[is_outside]] = True
    between = np.zeros((2, 0), bool)
    if samples:
        shares = _shares(len(body.mesh.lower), body.mesh.cell, samples)
        vertices = surface.facets[is_outside][:, : shares.shape[1]]
        places = [np.einsum("sv,fvi->fsi", shares, x[vertices]).reshape(-1, 3) for x in points]
        both = list(zip(places, surface.of, strict=True))
        between = np.stack([expression(x) & has for x, has in both])
    return BoundaryPart(nodes & on_surface, facets, off_plane, between)


def _shares(dimension: int, cell: str, count: int) -> Array:
    """Linear shape functions of a facet at points all over it, (points, vertices)."""
    t = np.linspace(0.0, 1.0, count + 1)
    line = np.stack([1.0 - t, t], axis=1)
    if dimension == 2:
        return line
    if cell == "hexahedron":  # vertices anticlockwise
        corners = np.einsum("si,tj->stij", line, line).reshape(-1, 4)
        return corners[:, [0, 1, 3, 2]]
    a, b = (g.ravel() for g in np.meshgrid(t, t))
    inside = a + b <= 1.0 + 1e-9
    return np.stack([1.0 - a - b, a, b], axis=1)[inside]
