"""XDMF written, read back by other programs' readers, equals what was handed over."""

from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from contact_app.results.xdmf import CELL_TYPES, XDMFError, XDMFWriter
from meshes.quadratic import node_vertices

SHAPES = {
    "triangle": [[0, 0], [1, 0], [0, 1]],
    "quadrilateral": [[0, 0], [1, 0], [1, 1], [0, 1]],
    "tetrahedron": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "hexahedron": [
        [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0],
        [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1],
    ],
}  # fmt: skip
for _cell in list(SHAPES):
    _corners = np.array(SHAPES[_cell], dtype=float)
    _nodes = [_corners[list(on)].mean(axis=0) for on in node_vertices(_cell)]
    SHAPES[f"{_cell}{len(_nodes)}"] = np.array(_nodes)
MESHIO = {
    "quadrilateral": "quad", "quadrilateral9": "quad9",
    "tetrahedron": "tetra", "tetrahedron10": "tetra10",
}  # fmt: skip


def separate_cells(kind: str, count: int, rng: np.random.Generator) -> tuple:
    """Points and cells of `count` cells that share no node, in a random numbering."""
    shape = np.array(SHAPES[kind], dtype=float)
    points = np.concatenate([shape + 2.0 * i for i in range(count)])
    order = rng.permutation(len(points))
    shuffled = np.empty_like(points)
    shuffled[order] = points
    return shuffled, order.reshape(count, len(shape))


def read(path: Path) -> tuple:
    """Points, cells by type, point data and cell data of the only step."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        assert reader.num_steps == 1
        _, point_data, cell_data = reader.read_data(0)
    return points, cells, point_data, cell_data


@pytest.mark.parametrize("kind", list(CELL_TYPES))
@pytest.mark.parametrize("slab", [2, 100])
def test_read_back_equals_the_written_values(kind: str, slab: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    points, cells = separate_cells(kind, 5, rng)
    displacement = rng.normal(size=points.shape)
    gap = rng.normal(size=len(points))
    gap[::3] = np.nan
    stress = rng.normal(size=(5, 6))
    von_mises = rng.random(5)
    path = tmp_path / "solution.xdmf"
    at_nodes, in_cells = {"displacement": 3, "gap": 1}, {"stress": 9, "von_mises": 1}
    with XDMFWriter(path, [(kind, len(cells))], len(points), at_nodes, in_cells) as file:
        for at in range(0, len(points), slab):
            rows = slice(at, at + slab)
            file.points(at, points[rows])
            file.point_data("displacement", at, displacement[rows])
            file.point_data("gap", at, gap[rows])
        for at in range(0, 5, slab):
            rows = slice(at, at + slab)
            file.cells(at, cells[rows])
            file.cell_data("stress", at, stress[rows])
            file.cell_data("von_mises", at, von_mises[rows])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["solution.h5", "solution.xdmf"]

    dimension = points.shape[1]
    read_points, read_cells, point_data, cell_data = read(path)
    np.testing.assert_array_equal(read_points[:, :dimension], points)
    assert not read_points[:, dimension:].any()
    assert [block.type for block in read_cells] == [MESHIO.get(kind, kind)]
    np.testing.assert_array_equal(read_cells[0].data, cells)
    np.testing.assert_array_equal(point_data["displacement"][:, :dimension], displacement)
    assert point_data["displacement"].shape == (len(points), 3)
    np.testing.assert_array_equal(point_data["gap"].ravel(), gap)
    np.testing.assert_array_equal(np.ravel(cell_data["von_mises"]), von_mises)
    tensor = np.reshape(cell_data["stress"], (5, 3, 3))
    np.testing.assert_array_equal(tensor, np.swapaxes(tensor, 1, 2))
    for column, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]):
        np.testing.assert_array_equal(tensor[:, i, j], stress[:, column])


def test_bodies_of_different_cells_are_one_grid(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    first, hexahedra = separate_cells("hexahedron", 3, rng)
    second, tetrahedra = separate_cells("tetrahedron", 2, rng)
    tetrahedra = tetrahedra + len(first)
    points = np.concatenate([first, second])
    path = tmp_path / "solution.xdmf"
    runs = [("hexahedron", 3), ("tetrahedron", 2)]
    with XDMFWriter(path, runs, len(points), {}, {"von_mises": 1}) as file:
        file.points(0, points)
        file.cells(3, tetrahedra)
        file.cells(1, hexahedra[1:])
        file.cells(0, hexahedra[:1])
        file.cell_data("von_mises", 0, np.arange(5.0))
    read_points, read_cells, _, cell_data = read(path)
    np.testing.assert_array_equal(read_points, points)
    assert [block.type for block in read_cells] == ["hexahedron", "tetra"]
    np.testing.assert_array_equal(read_cells[0].data, hexahedra)
    np.testing.assert_array_equal(read_cells[1].data, tetrahedra)
    flat = np.concatenate([np.ravel(part) for part in cell_data["von_mises"]])
    np.testing.assert_array_equal(flat, np.arange(5.0))
    with (
        pytest.raises(XDMFError, match="within one run"),
        XDMFWriter(path, runs, 32, {}, {}) as file,
    ):
        file.cells(2, np.zeros((2, 8), dtype=int))


def test_one_temporal_collection_of_one_grid_with_relative_names(tmp_path: Path) -> None:
    path = write_one_triangle(tmp_path / "a folder")
    text = path.read_text()
    assert text.count("<Grid") == 2
    assert text.count('GridType="Uniform"') == text.count("<Topology") == 1
    assert str(tmp_path) not in text
    moved = tmp_path / "moved"
    path.parent.rename(moved)
    points, *_ = read(moved / "solution.xdmf")
    assert len(points) == 3


def test_numbers_not_written_read_as_nan(tmp_path: Path) -> None:
    path = write_one_triangle(tmp_path)
    with h5py.File(path.with_suffix(".h5")) as file:
        np.testing.assert_array_equal(file["node/gap"][:], [np.nan, 0.5, np.nan])


def write_one_triangle(directory: Path) -> Path:
    path = directory / "solution.xdmf"
    with XDMFWriter(path, [("triangle", 1)], 3, {"gap": 1}, {}) as file:
        file.points(0, SHAPES["triangle"])
        file.cells(0, [[0, 1, 2]])
        file.point_data("gap", 1, [0.5])
    return path


def test_an_interrupted_writing_leaves_the_older_result_whole(tmp_path: Path) -> None:
    path = write_one_triangle(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    runs = [("quadrilateral", 1)]
    with pytest.raises(KeyboardInterrupt), XDMFWriter(path, runs, 4, {}, {}) as file:
        file.points(0, SHAPES["quadrilateral"])
        raise KeyboardInterrupt
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        ([(0, 2)], [(0, 1)], "1 points were never written"),
        ([(0, 3)], [], "1 cells were never written"),
        ([(0, 3), (2, 3)], [(0, 1)], "1 points were written twice"),
        ([(0, 4)], [(0, 1)], "rows 0 to 4 of points are outside"),
    ],
)
def test_an_incomplete_grid_is_refused(
    points: list, cells: list, message: str, tmp_path: Path
) -> None:
    coordinates = np.zeros((4, 3))
    with (
        pytest.raises(XDMFError, match=message),
        XDMFWriter(tmp_path / "solution.xdmf", [("triangle", 1)], 3, {}, {}) as file,
    ):
        for first, last in points:
            file.points(first, coordinates[first:last])
        for first, last in cells:
            file.cells(first, [[0, 1, 2]] * (last - first))
    assert list(tmp_path.iterdir()) == []
