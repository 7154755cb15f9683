"""Cells know their body and their material: fields of the file for ParaView."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import contact_app
from tests import meshfiles, scenes
from tests.contact_app.model.test_meshes_from_files import two_materials


def cell_field(directory: Path, name: str) -> np.ndarray:
    with h5py.File(directory / "solution.h5") as file:
        return np.asarray(file[f"cell/{name}"])


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_bodies_are_numbered_as_in_the_file(cell: str, tmp_path: Path) -> None:
    made = scenes.ALL["two_bodies"](cell, 4)
    made["decomposition"] = {"subdomains": 5}
    answer = contact_app.solve(made)
    answer.write(tmp_path)
    body = cell_field(tmp_path, "body")
    cells = [answer.solved.model.scene.bodies[k].mesh.total_cells for k in (0, 1)]
    assert [(body == k).sum() for k in (0, 1)] == cells
    assert (cell_field(tmp_path, "material") == 0.0).all()


def test_materials_are_numbered_as_in_the_file(tmp_path: Path) -> None:
    """The block is soft on one side of a plane and hard on the other."""
    file = meshfiles.write(meshfiles.block("hexahedron", 4, 0.0), tmp_path / "block.msh")
    answer = contact_app.solve(two_materials("hexahedron", file))
    answer.write(tmp_path / "out")
    material = cell_field(tmp_path / "out", "material")
    assert set(material) == {0.0, 1.0}
    nodes = np.concatenate(answer.solved.cells.cells)
    centres = answer.points[nodes].mean(axis=1)
    soft, hard = (centres[material == k] for k in (0.0, 1.0))
    apart = [soft[:, i].max() < hard[:, i].min() or hard[:, i].max() < soft[:, i].min()
             for i in range(3)]  # fmt: skip
    assert sum(apart) == 1
