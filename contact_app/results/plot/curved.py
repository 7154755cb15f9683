"""Skin of ten-node tetrahedra in pieces that look round.

The middles of edges cut a side of six nodes into four triangles, and these once more, with new
nodes where the side's own polynomial has them: x = Σ_k N_k x_k, and the same of every field.
"""

from dataclasses import replace

import numpy as np

from contact_app.results.plot.stored import SIDES, Stored, edge_middles
from meshes.arrays import Array, Ints

HALF = np.array([0.375, 0.75, -0.125])
"""N of a side's end, middle and other end at a quarter of an edge."""

INNER = np.array([-0.125, -0.125, 0.5, 0.5, 0.25])
"""N half-way between two middles: of the two vertices that are not between these edges, of the two
middles, and of the third."""


def finer(stored: Stored) -> tuple[Stored, list[tuple[Ints, Ints]], Ints]:
    """The result with further nodes, sides of the skin with their rows, and levels of nodes.

    An edge between two nodes is part of an edge of a cell if the sum of their levels is 0 or 1.
    Cells other than tetrahedra of degree 2 keep their skin.
    """
    if set(stored.cells) != {"tetrahedron10"}:
        return stored, stored.skin(), (~stored.vertices).astype(np.int64)
    sides, rows = _six_node_sides(stored)
    a, b, c, ab, bc, ca = sides.T
    # a side and its neighbour have the same nodes on the edge between them
    halves = ((a, ab, b), (b, ab, a), (b, bc, c), (c, bc, b), (c, ca, a), (a, ca, c))
    quarters, of_half = np.unique(np.hstack(halves).T, axis=0, return_inverse=True)
    inner = np.hstack(((b, c, ab, ca, bc), (c, a, bc, ab, ca), (a, b, ca, bc, ab))).T
    count = len(stored.points)
    a_ab, b_ab, b_bc, c_bc, c_ca, a_ca = count + of_half.reshape(6, -1)
    ab_ca, bc_ab, ca_bc = count + len(quarters) + np.arange(len(inner)).reshape(3, -1)
    four = (
        (a, ab, ca, a_ab, ab_ca, a_ca), (ab, b, bc, b_ab, b_bc, bc_ab),
        (ca, bc, c, ca_bc, c_bc, c_ca), (ab, bc, ca, bc_ab, ca_bc, ab_ca),
    )  # fmt: skip
    pieces = [
        piece
        for p, q, r, pq, qr, rp in four
        for piece in ((p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp))
    ]

    def at_all(values: Array) -> Array:
        """Values at the given and the new nodes; numbers stay within their range."""
        new = [
            np.einsum("k,nk...->n...", N, values[of])
            for N, of in ((HALF, quarters), (INNER, inner))
        ]
        every = np.concatenate([values, *new])
        finite = values[np.isfinite(values)]
        return (
            every
            if values.ndim > 1 or not len(finite)
            else np.clip(every, finite.min(), finite.max())
        )

    fields = {name: at_all(values) for name, values in stored.point_data.items()}
    result = replace(stored, points=at_all(stored.points), point_data=fields)
    skin = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    levels = np.repeat([0, 1, 2], [count, len(quarters), len(inner)])
    return result, [(skin, np.tile(rows, len(pieces)))], levels


def _six_node_sides(stored: Stored) -> tuple[Ints, Ints]:
    """Sides that only one cell has, (sides, 6), vertices first, and the row of their cells."""
    cells, rows = stored.cells["tetrahedron10"], stored.numbers["tetrahedron10"]
    table = SIDES["tetrahedron"]
    sides = np.concatenate(
        [cells[:, [*side, *edge_middles("tetrahedron", side)]] for side in table]
    )
    vertices = np.sort(sides[:, :3], axis=1)
    _, first, count = np.unique(vertices, axis=0, return_index=True, return_counts=True)
    once = first[count == 1]
    return sides[once], np.tile(rows, len(table))[once]
