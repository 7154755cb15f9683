"""Bodies whose meshes come from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from meshes import CellMesh
from meshes.read import FileContent, read_file
from meshes.repair import load_mesh
from tests import meshfiles


def test_bodies_of_one_file_read_it_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meshfiles.write(meshfiles.block("tetrahedron", 2), tmp_path / "a.msh")
    asked: list[Path] = []

    def counting(path: Path, dimension: int) -> FileContent:
        asked.append(path)
        return read_file(path, dimension)

    monkeypatch.setattr("meshes.read.read_file", counting)
    steel = {"young": 1.0, "poisson": 0.3}
    made = {
        "dimension": 3,
        "bodies": [
            {"name": name, "material": steel, "mesh": {"file": str(tmp_path / "a.msh"), **more}}
            for name, more in (
                ("a", {"group": "soft"}), ("b", {"group": "hard"}),
                ("c", {"group": "hard", "translate": [5, 0, 0]}),
            )
        ],
        "conditions": [{"on": f"{name}.y-", "displacement": [0, 0, 0]} for name in "abc"]
        + [{"in": "a", "force": [1, 0, 0]}],
    }  # fmt: skip
    bodies = build_scene(Configuration.model_validate(made)).bodies
    assert asked == [tmp_path / "a.msh"]
    for body, group in zip(bodies, ("soft", "hard", "hard"), strict=True):
        alone = load_mesh(tmp_path / "a.msh", 3, groups=[group])
        assert isinstance(body.mesh, CellMesh)
        moved = [5.0, 0.0, 0.0] if body.name == "c" else [0.0, 0.0, 0.0]
        np.testing.assert_array_equal(body.mesh.points, alone.points + moved)
        np.testing.assert_array_equal(body.mesh.cells, alone.cells)
