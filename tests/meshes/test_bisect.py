"""Local refinement: meshes stay whole, groups and surfaces go on, shapes stay good."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from meshes.bisect import bisected
from meshes.graded import graded_box
from meshes.unstructured import CellMesh, Topology

CELLS = ["triangle", "tetrahedron"]


def box(cell: str) -> CellMesh:
    d = 2 if cell == "triangle" else 3
    mesh = graded_box(cell, [np.array([0.0, 0.3, 0.7, 1.0])] * d)
    shaken = np.random.default_rng(1).uniform(-0.05, 0.05, mesh.points.shape)
    inside = ((mesh.points > 0.1) & (mesh.points < 0.9)).all(axis=1)
    points = np.where(inside[:, None], mesh.points + shaken, mesh.points)
    left = np.flatnonzero(points[mesh.cells].mean(axis=1)[:, 0] < 0.5)
    tags = np.ones(len(mesh.cells), np.int32)
    tags[left] = 0
    return replace(mesh, points=points, groups={"left": left}, tags=tags)


def volumes(mesh: CellMesh) -> np.ndarray:
    x = mesh.points[mesh.cells]
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / (2 if mesh.dimension == 2 else 6)


def corner(mesh: CellMesh) -> np.ndarray:
    """Cells at the origin."""
    return np.flatnonzero((mesh.points[mesh.cells] == 0.0).all(axis=2).any(axis=1))


@pytest.mark.parametrize("cell", CELLS)
def test_refined_again_and_again_at_a_corner(cell: str) -> None:
    mesh = box(cell)
    quality = []
    for _ in range(8):
        before = mesh
        mesh = bisected(mesh, corner(mesh))
        size = volumes(mesh)
        assert np.all(size > 0)
        assert size.sum() == pytest.approx(1.0, rel=1e-12), "no cell is inside out"
        assert mesh.topology.crowded == 0
        # nothing hangs: inside, every facet has two cells, and the surface is that of the box
        for rows in (mesh.topology.facets,):
            x = mesh.points[rows]
            on_side = ((x == 0.0) | (x == 1.0)).all(axis=1).any(axis=1)
            assert on_side.all()
        x = mesh.points[mesh.cells]
        edges = [np.linalg.norm(x[:, i] - x[:, j], axis=1)
                 for i, j in combinations(range(x.shape[1]), 2)]  # fmt: skip
        quality.append(float((size / np.max(edges, axis=0) ** mesh.dimension).min()))
        assert len(mesh.cells) < 3 * len(before.cells)
    assert min(quality) > 0.2 * quality[0]
    smallest = np.linalg.norm(mesh.points[mesh.points.any(axis=1)], axis=1).min()
    assert smallest < 0.3 / 2**7


@pytest.mark.parametrize("cell", CELLS)
def test_groups_sides_and_materials_go_on(cell: str) -> None:
    mesh = box(cell)
    new = bisected(mesh, corner(mesh))
    assert set(new.sides) == set(mesh.sides)
    for name, rows in new.sides.items():
        axis, value = "xyz".index(name[0]), float(name[1] == "+")
        np.testing.assert_allclose(new.points[new.topology.facets[rows], axis], value)
    assert volumes(new)[new.groups["left"]].sum() == pytest.approx(
        volumes(mesh)[mesh.groups["left"]].sum()
    )
    assert np.all(new.tags[new.groups["left"]] == 0)
    assert (new.tags == 0).sum() == len(new.groups["left"])
    assert len(Topology.of(new.cells, cell).facets) == sum(map(len, new.sides.values()))


@pytest.mark.parametrize("cell", CELLS)
def test_all_cells_at_once_halve_every_edge(cell: str) -> None:
    mesh = box(cell)
    new = bisected(mesh, np.arange(mesh.total_cells))
    assert new.total_cells == mesh.total_cells * 2**mesh.dimension


def test_other_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="triangles and tetrahedra"):
        bisected(graded_box("quadrilateral", [np.linspace(0, 1, 3)] * 2), np.arange(1))
