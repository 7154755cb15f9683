"""Subdivision of the skin of second-order tetrahedra into pieces that look round.

A side of six nodes is cut at the middles of its edges into four triangles and these once more, with
nodes where the side's own polynomial has them: x = Σ_k N_k x_k, and the same of every field. Values
of numbers stay between the smallest and the largest of the nodes, so that pressures are not
negative beside the edge of a contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from contact_app.results.plot.stored import SIDES, Stored, edge_middles, single

Integers = NDArray[np.int64]

HALF = np.array([0.375, 0.75, -0.125])
"""N of a side's end, middle and other end at a quarter of an edge."""

INNER = np.array([-0.125, -0.125, 0.5, 0.5, 0.25])
"""N half-way between two midpoints: for the two vertices that the edges do not share, the two
midpoints, and the third midpoint."""

_DRAWN = ((False, True, True), (True, False, True), (True, True, False), (False, False, False))
"""For the three quarters at the vertices and the one between the midpoints: whether the edge
opposite each corner is part of an edge of the side."""


def finer(stored: Stored) -> Stored:
    """A result with sixteen pieces per side of the skin; unchanged for other cells."""
    if set(stored.cells) != {"tetrahedron10"}:
        return stored
    faces, rows = _faces(stored)
    a, b, c, ab, bc, ca = faces.T
    weights = _Weights(len(stored.points))
    # a side and its neighbour have the same nodes on the edge between them
    halves = ((a, ab, b), (b, ab, a), (b, bc, c), (c, bc, b), (c, ca, a), (a, ca, c))
    amid = weights.add(np.concatenate([np.stack(half, axis=1) for half in halves]), HALF)
    inner = ((b, c, ab, ca, bc), (c, a, bc, ab, ca), (a, b, ca, bc, ab))
    amid_inner = weights.add(np.concatenate([np.stack(facet, axis=1) for facet in inner]), INNER)
    a_ab, b_ab, b_bc, c_bc, c_ca, a_ca = amid.reshape(6, -1)
    ab_ca, bc_ab, ca_bc = amid_inner.reshape(3, -1)
    quarters = (
        (a, ab, ca, a_ab, ab_ca, a_ca), (ab, b, bc, b_ab, b_bc, bc_ab),
        (ca, bc, c, ca_bc, c_bc, c_ca), (ab, bc, ca, bc_ab, ca_bc, ab_ca),
    )  # fmt: skip
    pieces, drawn = [], []
    for (p, q, r, pq, qr, rp), outer in zip(quarters, _DRAWN, strict=True):
        x, y, z = outer
        pieces += [(p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]
        drawn += [(False, y, z), (x, False, z), (x, y, False), (False,) * 3]
    sides = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    W = weights.matrix()
    data = {name: _with_new(W, values) for name, values in stored.point_data.items()}
    return replace(
        stored, points=np.concatenate([stored.points, W @ stored.points]), point_data=data,
        pieces=((sides, np.tile(rows, len(pieces))),), drawn=np.repeat(drawn, len(faces), axis=0),
    )  # fmt: skip


def _with_new(W: csr_array, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the given nodes and then at the new ones."""
    at_new = W @ values
    finite = values[np.isfinite(values)] if values.ndim == 1 else values[:0]
    if len(finite):
        at_new = np.clip(at_new, finite.min(), finite.max())
    return np.concatenate([values, at_new])


def _faces(stored: Stored) -> tuple[Integers, Integers]:
    """Sides that only one cell has, (sides, 6), vertices first, and the row of their cells."""
    cells, rows = stored.cells["tetrahedron10"], stored.numbers["tetrahedron10"]
    faces = np.concatenate(
        [cells[:, [*side, *edge_middles("tetrahedron", side)]] for side in SIDES["tetrahedron"]]
    )
    return single(faces, np.tile(rows, len(SIDES["tetrahedron"])), corners=3)


class _Weights:
    """New nodes as sums of given ones."""

    def __init__(self, given_nodes: int) -> None:
        self._given_nodes, self._count = given_nodes, 0
        self._rows: list[Integers] = []
        self._columns: list[Integers] = []
        self._values: list[NDArray[np.float64]] = []

    def add(self, nodes: Integers, weights: NDArray[np.float64]) -> Integers:
        """Numbers of new nodes, one per row of `nodes`; equal rows are one node."""
        unique, of_row = np.unique(nodes, axis=0, return_inverse=True)
        first = self._count
        self._count += len(unique)
        self._rows.append(np.repeat(np.arange(first, self._count), nodes.shape[1]))
        self._columns.append(unique.ravel())
        self._values.append(np.tile(weights, len(unique)))
        return self._given_nodes + first + of_row.reshape(-1)

    def matrix(self) -> csr_array:
        """Values at new nodes from those at given ones, (new, given)."""
        entries = np.concatenate(self._rows), np.concatenate(self._columns)
        return csr_array((np.concatenate(self._values), entries), (self._count, self._given_nodes))
