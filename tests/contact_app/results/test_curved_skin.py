"""Skins of curved second-order tetrahedra in pictures."""

from __future__ import annotations

import numpy as np
import pytest

from contact_app.results.plot.curved import finer
from contact_app.results.plot.space_picture import sharp_edges
from contact_app.results.plot.stored import EDGES, Stored


def two_tetrahedra() -> Stored:
    """Two cells with a common side; x + y + z and squares of it are fields, edges are bent."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    cells, points, middles = [], list(vertices), {}
    for corners in ([0, 1, 2, 3], [1, 2, 3, 4]):
        own = list(corners)
        for i, j in EDGES["tetrahedron"]:
            key = frozenset((corners[i], corners[j]))
            if key not in middles:
                middles[key] = len(points)
                points.append(0.5 * vertices[list(key)].sum(axis=0))
            own.append(middles[key])
        cells.append(own)
    x = np.array(points)
    data = {"linear": x.sum(axis=1), "square": x[:, 0] ** 2 + x[:, 1] * x[:, 2], "vector": x}
    kind = "tetrahedron10"
    return Stored(x, {kind: np.array(cells)}, {kind: np.arange(2)}, data, {"body": np.arange(2.0)})


def test_fields_of_second_order_are_exact_at_new_nodes() -> None:
    coarse = two_tetrahedra()
    fine = finer(coarse)
    x = fine.points
    assert len(x) > len(coarse.points)
    np.testing.assert_allclose(fine.point_data["linear"], x.sum(axis=1), atol=1e-14)
    np.testing.assert_allclose(
        fine.point_data["square"], x[:, 0] ** 2 + x[:, 1] * x[:, 2], atol=1e-14
    )
    np.testing.assert_allclose(fine.point_data["vector"], x)


def test_values_stay_between_those_of_nodes() -> None:
    coarse = two_tetrahedra()
    pressure = np.zeros(len(coarse.points))
    pressure[-1] = 1.0
    coarse.point_data["pressure"] = np.where(np.arange(len(pressure)) == 0, np.nan, pressure)
    values = finer(coarse).point_data["pressure"]
    assert np.isnan(values).sum() > 1
    assert (np.nanmin(values), np.nanmax(values)) == (0.0, 1.0)


def test_the_pieces_cover_the_skin_once_and_hang_together() -> None:
    coarse = two_tetrahedra()
    fine = finer(coarse)
    ((sides, rows),) = fine.skin()
    ((rough, _),) = coarse.skin()
    assert len(sides) == 4 * len(rough) == 16 * 6

    def area(of: Stored, corners: np.ndarray) -> float:
        a, b, c = (of.points[corners[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2

    assert area(fine, sides) == pytest.approx(area(coarse, rough), rel=1e-12)
    assert sorted(np.bincount(rows)) == [48, 48]
    # every edge has two neighbours: it is sharp only where sides of cells meet at an angle
    sharp = sharp_edges(fine.points, [sides])
    assert len(sharp) == 4 * len({frozenset(e) for e in sharp_edges_of_cells(coarse)})
    assert fine.drawn is not None
    # 12 pieces have edges of a side: twice as many edges as outer quarters, four a side's edge
    assert fine.drawn.sum() == 6 * 3 * 4


def sharp_edges_of_cells(stored: Stored) -> list[tuple[int, int]]:
    corners = np.concatenate(
        [stored.cells["tetrahedron10"][:, [0, 2, 1]], stored.cells["tetrahedron10"][:, [0, 1, 3]],
         stored.cells["tetrahedron10"][:, [1, 2, 3]], stored.cells["tetrahedron10"][:, [0, 3, 2]]]
    )  # fmt: skip
    _, first, count = np.unique(
        np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True
    )
    return [(int(i), int(j)) for i, j in sharp_edges(stored.points, [corners[first[count == 1]]])]


def test_other_cells_are_left_as_they_are() -> None:
    flat = two_tetrahedra()
    straight = Stored(
        flat.points, {"tetrahedron": flat.cells["tetrahedron10"][:, :4]},
        {"tetrahedron": np.arange(2)}, flat.point_data, flat.cell_data,
    )  # fmt: skip
    assert finer(straight) is straight
