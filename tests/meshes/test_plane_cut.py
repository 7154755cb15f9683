"""Areas and centroids of cuts through cells, straight and curved."""

import numpy as np
import pytest

from meshes.plane_cut import cut, simplices
from meshes.quadratic import node_vertices
from tests.contact_app.results.test_xdmf import SHAPES

CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


def cell_nodes(cell: str, curved: bool) -> np.ndarray:
    x = np.array(SHAPES[cell], float)
    if curved:
        x = np.array([x[list(on)].mean(axis=0) for on in node_vertices(cell)])
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def volume(cell: str, curved: bool) -> float:
    x = cell_nodes(cell, curved)
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    corners = x[np.array(simplices(cell, curved))][..., :d]
    return np.linalg.det(corners[:, 1:] - corners[:, :1])


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("cell", CELLS)
def test_simplices_fill_the_cell(cell: str, curved: bool) -> None:
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    whole = {"triangle": 1 / 2, "tetrahedron": 1 / 6}.get(cell, 1.0)
    each = np.abs(volume(cell, curved)) / [2, 6][d - 2]
    assert (each > 1e-6).all()
    assert each.sum() == pytest.approx(whole)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize(
    ("cell", "area", "centre"),
    [
        ("triangle", 0.75, [0.25, 0.375, 0]),
        ("quadrilateral", 1.0, [0.25, 0.5, 0]),
        ("tetrahedron", 0.5 * 0.75**2, [0.25, 0.25, 0.25]),
        ("hexahedron", 1.0, [0.25, 0.5, 0.5]),
    ],
)
def test_across_x(cell: str, area: float, centre: list[float], curved: bool) -> None:
    x = cell_nodes(cell, curved)
    found, first = cut(x[None], simplices(cell, curved), x[None, :, 0] - 0.25)
    assert found == pytest.approx(area)
    np.testing.assert_allclose(first / found, centre, atol=1e-12)


def test_oblique_through_a_cube() -> None:
    """The regular hexagon across a diagonal: area 3 √3 / 4."""
    x = cell_nodes("hexahedron", False)
    heights = x.sum(axis=1) - 1.5
    found, first = cut(x[None], simplices("hexahedron", False), heights[None])
    assert found == pytest.approx(0.75 * np.sqrt(3.0))
    np.testing.assert_allclose(first / found, 0.5, atol=1e-12)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("cell", CELLS)
def test_along_a_face_the_cell_behind_counts_alone(cell: str, curved: bool) -> None:
    x = cell_nodes(cell, curved)
    pieces = simplices(cell, curved)
    in_front, _ = cut(x[None], pieces, x[None, :, 0])
    assert in_front == 0.0
    behind, _ = cut(x[None], pieces, -x[None, :, 0] + 0.0)
    face = {"triangle": 1.0, "quadrilateral": 1.0, "tetrahedron": 0.5, "hexahedron": 1.0}[cell]
    assert behind == pytest.approx(face)
