"""Files of Gmsh's format 4.1 in text are read as meshio reads them, without it."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from meshes import gmsh_text
from meshes.gmsh_text import read_msh

SAMPLES = Path(__file__).parents[2] / "meshes" / "samples"


def by_meshio(path: Path) -> meshio.Mesh:
    raise AssertionError(f"meshio reads {path}")


def written(directory: Path, cell: str) -> Path:
    """A file with cells of a type of meshio, in text, with nodes in any order."""
    nodes = len(dict(gmsh_text.TYPES.values())[cell])
    rng = np.random.default_rng(nodes)
    points, cells = rng.random((3 * nodes, 3)), rng.permutation(3 * nodes).reshape(3, nodes)
    meshio.gmsh.write(directory / "a.msh", meshio.Mesh(points, {cell: cells}), "4.1", binary=False)
    return directory / "a.msh"


@pytest.mark.parametrize("cell", [name for name, _ in gmsh_text.TYPES.values()])
def test_nodes_of_cells_have_the_order_of_meshio(
    cell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, cell)
    given = meshio.read(path)
    monkeypatch.setattr(meshio, "read", by_meshio)
    read = read_msh(path)
    np.testing.assert_array_equal(read.points, given.points)
    assert [block.type for block in read.cells] == [cell]
    np.testing.assert_array_equal(read.cells[0].data, given.cells[0].data)


@pytest.mark.parametrize("name", ["hub_on_shaft", "bracket", "bushing", "disc_quarter"])
def test_groups_of_shipped_meshes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = SAMPLES / f"{name}.msh"
    given = meshio.read(path)
    monkeypatch.setattr(meshio, "read", by_meshio)
    read = read_msh(path)
    np.testing.assert_array_equal(read.points, given.points)
    for ours, theirs in zip(read.cells, given.cells, strict=True):
        assert ours.type == theirs.type
        np.testing.assert_array_equal(ours.data, theirs.data)
    groups = {key: rows for key, rows in given.cell_sets.items() if not key.startswith("gmsh:")}
    assert list(read.cell_sets) == list(groups)
    for key, blocks in groups.items():
        assert [len(rows) for rows in read.cell_sets[key]] == [len(rows) for rows in blocks]


def test_an_entity_in_two_groups_one_without_a_name(tmp_path: Path) -> None:
    text = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
1
2 7 "sheet"
$EndPhysicalNames
$Entities
0 0 1 0
4 0 0 0 1 1 0 2 7 -9 0
$EndEntities
$Nodes
1 3 2 8
2 4 0 3
8
2
5
0 0 0
1 0 0
0 1 0
$EndNodes
$Elements
1 1 1 1
2 4 2 1
1 8 2 5
$EndElements
"""
    path = tmp_path / "a.msh"
    path.write_text(text)
    read = read_msh(path)
    np.testing.assert_array_equal(read.cells[0].data, [[0, 1, 2]])
    assert {name: len(blocks[0]) for name, blocks in read.cell_sets.items()} == {"sheet": 1, "9": 1}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("$EndNodes", "$EndNode"),
        ("$Elements\n", "$Elements\nx "),
        ("$MeshFormat\n4.1", "$MeshFormat\n4.0"),
        ("$EndMeshFormat\n", "$EndMeshFormat\n$Comments\nnone\n$EndComments\n"),
    ],
)
def test_meshio_reads_files_that_are_not_as_expected(
    old: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, "tetra")
    path.write_text(path.read_text().replace(old, new, 1))
    monkeypatch.setattr(meshio, "read", by_meshio)
    with pytest.raises(AssertionError, match="meshio reads"):
        read_msh(path)
