"""Files of other programs, which meshio alone does not read, and what a refusal says."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from meshes.repair import load_mesh
from meshes.unstructured import MeshError
from tests import meshfiles


def test_bulk_data_without_its_first_line_is_read(tmp_path: Path) -> None:
    """Gmsh writes no BEGIN BULK."""
    given = meshfiles.block("tetrahedron", 2)
    path = meshfiles.write(meshio.Mesh(given.points, given.cells[:1]), tmp_path / "a.bdf", None)
    text = path.read_text()
    assert "BEGIN BULK\n" in text
    path.write_text(text[text.index("BEGIN BULK\n") + len("BEGIN BULK\n") :])
    assert load_mesh(path, 3).total_cells == 48


SQUARE = """*NODE
1, 0, 0
2, 2, 0
3, 2, 2
4, 0, 2
5, 1, 0
6, 2, 1
7, 1, 2
8, 0, 1
9, 1, 1
"""

ELEMENTS = {
    "CPE3": "1, 1, 2, 3\n2, 1, 3, 4\n",
    "CPS3": "1, 1, 2, 3\n2, 1, 3, 4\n",
    "cpe4r": "1, 1, 2, 3, 4\n",
    "CPE4": "1, 1, 2, 3, 4\n",
    "CPS6": "1, 1, 2, 3, 5, 6, 9\n2, 1, 3, 4, 9, 7, 8\n",
    "CPE6M": "1, 1, 2, 3, 5, 6, 9\n2, 1, 3, 4, 9, 7, 8\n",
    "CPS8": "1, 1, 2, 3, 4, 5, 6, 7, 8\n",
    "CPE8R": "1, 1, 2, 3, 4, 5, 6, 7, 8\n",
}


@pytest.mark.parametrize("name", ELEMENTS)
def test_plane_elements_of_abaqus_are_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / "plate.inp"
    path.write_text(f"{SQUARE}*ELEMENT, TYPE={name}, ELSET=plate\n{ELEMENTS[name]}")
    mesh = load_mesh(path, 2)
    assert mesh.total_cells == (2 if name[3] in "36" else 1)
    np.testing.assert_allclose(mesh.points.min(axis=0)[:2], 0.0)
    np.testing.assert_allclose(mesh.points.max(axis=0)[:2], 2.0)


def test_coordinates_beyond_all_measure_are_refused(tmp_path: Path) -> None:
    given = meshfiles.block("tetrahedron", 2)
    path = meshfiles.write(
        meshio.Mesh(1e200 * given.points, given.cells[:1]), tmp_path / "a.vtu", None
    )
    with pytest.raises(MeshError, match=r"a coordinate above 1e\+50"):
        load_mesh(path, 3)


def test_pieces_without_groups_are_reported(tmp_path: Path) -> None:
    given = meshfiles.block("tetrahedron", 2)
    cells = given.cells[0].data
    points = np.concatenate([given.points, given.points + [3.0, 0, 0]])
    both = meshio.Mesh(points, [("tetra", np.concatenate([cells, cells + len(given.points)]))])
    path = meshfiles.write(both, tmp_path / "a.vtu", None)
    with pytest.raises(MeshError, match="which the file lacks: give each piece a physical group"):
        load_mesh(path, 3)
