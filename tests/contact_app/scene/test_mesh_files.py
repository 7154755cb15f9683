"""Bodies whose meshes come from files."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration, load
from meshes import CellMesh
from meshes.read import FileContent, read_file
from meshes.repair import load_mesh
from tests import meshfiles
from tests.ranks import execute
from tests.scenes import CONFIGS

HUB, BALL = CONFIGS / "hub_on_shaft.yaml", CONFIGS / "ball_in_grooves.yaml"


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


def read_together() -> None:
    """Ranks that share bodies have the meshes of one rank, and all of them the error of one."""
    together, alone = (
        [body for scene in (HUB, BALL) for body in build_scene(load(scene), comm=comm).bodies]
        for comm in (MPI.COMM_WORLD, MPI.COMM_SELF)
    )
    for one, other in zip(together, alone, strict=True):
        assert isinstance(one.mesh, CellMesh)
        assert isinstance(other.mesh, CellMesh)
        for name in ("points", "cells", "middles", "tags"):
            np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))
        assert one.mesh.notes == other.mesh.notes
        assert one.boundaries.keys() == other.boundaries.keys()
    lost = load(HUB, ["bodies.1.mesh.file=/lost.msh"])
    with pytest.raises(ConfigurationError, match=r"bodies\[1\].mesh.file is /lost.msh, which does"):
        build_scene(lost, comm=MPI.COMM_WORLD)


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_share_bodies_or_their_checks(ranks: int) -> None:
    program = (
        "from tests.contact_app.scene.test_mesh_files import read_together as r; r(); print('ok')"
    )
    assert execute(program, ranks=ranks).count("ok") == ranks
