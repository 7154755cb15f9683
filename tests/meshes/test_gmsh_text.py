"""Gmsh's text in binary: meshio reads the same mesh of both, and what is damaged itself."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from meshes.gmsh_text import in_binary, read_gmsh

SAMPLES = Path(__file__).parents[2] / "meshes" / "samples"


@pytest.mark.parametrize("name", ["bracket", "ball_in_grooves", "ring_quarter"])
def test_the_mesh_of_a_text_is_that_of_meshio(name: str) -> None:
    path = SAMPLES / f"{name}.msh"
    assert in_binary(path.read_bytes()) is not None
    mesh, expected = read_gmsh(path), meshio.read(path)
    np.testing.assert_array_equal(mesh.points, expected.points)
    assert [block.type for block in mesh.cells] == [block.type for block in expected.cells]
    for block, other in zip(mesh.cells, expected.cells, strict=True):
        np.testing.assert_array_equal(block.data, other.data)
    for key in ("gmsh:physical", "gmsh:geometrical"):
        for tags, others in zip(mesh.cell_data[key], expected.cell_data[key], strict=True):
            np.testing.assert_array_equal(tags, others)
    for group in mesh.field_data:
        assert list(mesh.field_data[group]) == list(expected.field_data[group])
        for rows, others in zip(mesh.cell_sets[group], expected.cell_sets[group], strict=True):
            np.testing.assert_array_equal(rows, others)


@pytest.mark.parametrize(
    "damage",
    [
        (b"$MeshFormat\n4.1 0 8", b"$MeshFormat\n2.2 0 8"),
        (b"\n$EndElements", b" 7\n$EndElements"),
        (b"\n$EndElements", b" x\n$EndElements"),
        (b"\n$EndNodes", b""),
        (b"$Elements\n", b"$NodeData\n1\n$EndNodeData\n$Elements\n"),
    ],
)
def test_other_texts_are_left_to_meshio(damage: tuple[bytes, bytes]) -> None:
    text = (SAMPLES / "ring_quarter.msh").read_bytes()
    assert damage[0] in text
    assert in_binary(text) is not None
    assert in_binary(text.replace(*damage)) is None
