"""Boxes on uneven grids are the boxes of equal cells where the grid is even."""

import math

import numpy as np
import pytest

from meshes.graded import graded_box

GRIDS = [np.array([0.0, 0.1, 0.4, 1.0]), np.array([-1.0, 0.5, 1.0]), np.array([2.0, 3.0])]
PER_CELL = {"quadrilateral": 1, "triangle": 2, "hexahedron": 1, "tetrahedron": 6}


def volumes(points: np.ndarray, cells: np.ndarray, cell: str) -> np.ndarray:
    """Volumes; of quadrilaterals and hexahedra from the edges at their first vertex."""
    ends = {"quadrilateral": (1, 3), "hexahedron": (1, 3, 4)}.get(cell)
    edges = points[cells[:, list(ends or range(1, points.shape[1] + 1))]] - points[cells[:, :1]]
    share = 1 if ends else math.factorial(points.shape[1])
    return np.abs(np.linalg.det(edges)) / share


@pytest.mark.parametrize("cell", PER_CELL)
def test_a_graded_box_fills_the_box(cell: str) -> None:
    grids = GRIDS[: 2 if cell in ("quadrilateral", "triangle") else 3]
    mesh = graded_box(cell, grids)
    counts = [len(g) - 1 for g in grids]
    assert len(mesh.cells) == PER_CELL[cell] * math.prod(counts)
    assert len(mesh.points) == math.prod(n + 1 for n in counts)
    found = volumes(mesh.points, mesh.cells, cell)
    assert (found > 0).all()
    assert found.sum() == pytest.approx(math.prod(g[-1] - g[0] for g in grids))
    assert mesh.topology.crowded == 0
    assert sum(len(rows) for rows in mesh.sides.values()) == len(mesh.topology.facets)
    for axis, name in enumerate("xyz"[: len(grids)]):
        for end, sign in ((0, "-"), (-1, "+")):
            nodes = mesh.topology.facets[mesh.sides[name + sign]]
            np.testing.assert_array_equal(mesh.points[nodes][..., axis], grids[axis][end])
