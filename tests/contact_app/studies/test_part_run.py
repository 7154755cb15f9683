"""A linear solve, this application and PETSc's contact solvers on a part have one answer."""

import json
from pathlib import Path

import pytest

from contact_app.studies import part_run, parts, peers
from contact_app.studies.undecomposed import UnsuitableError
from tests import meshfiles, scenes
from tests.comparison import solve
from tests.contact_app.model.test_meshes_from_files import two_materials
from tests.scenes import CONFIGS

COARSE = ["bodies.0.degree=1"]
"""The pillow block: several loads on different boundaries, total forces among them."""


@pytest.fixture(scope="module")
def rows() -> dict[str, dict]:
    path = CONFIGS / "pillow_block.yaml"
    found = {"primal": part_run.application(path, COARSE, "primal", 1e-8)}
    for method in ("tao-bnls", "linear-gamg", "linear-boomeramg"):
        found[method] = part_run.peer(path, COARSE, method, 1e-8)
    return found


def test_peers_take_several_loads_and_agree(rows: dict[str, dict]) -> None:
    assert all(row["converged"] for row in rows.values())
    energy = rows["primal"]["energy"]
    assert rows["tao-bnls"]["energy"] == pytest.approx(energy, rel=1e-8)
    assert rows["linear-gamg"]["energy"] > energy * (1.0 - 1e-12)  # glued, it is held more
    assert rows["linear-boomeramg"]["energy"] == pytest.approx(
        rows["linear-gamg"]["energy"], rel=1e-9
    )
    assert len({row["unknowns"] for row in rows.values()}) == 1


def test_the_table_compares_all_methods_with_the_linear_solve(rows: dict[str, dict]) -> None:
    row = {"part": "block", "method": "primal", "note": "", "memory": 1.0, **rows["primal"]}
    linear = {**row, "seconds": row["seconds"] / 3.0, "cpu": row["cpu"] / 2.0}
    cells = [cell.strip() for cell in parts.line(row, linear).split("|")]
    assert len(cells) == len(parts.HEADING.splitlines()[0].split("|"))
    assert (cells[8], cells[10]) == ("3.00", "2.00")
    failed = parts.line({"part": "block", "method": "snes-vi", "note": "not done"}, linear)
    assert failed.count("|") == len(cells) - 1


REMOTE = {"on": "block.x+", "total_force": [1, 2, -3], "total_moment": [5, 7, -4], "at": [2, 1, 3]}


@pytest.mark.parametrize(
    "more", [[], [REMOTE]], ids=["two materials", "a moment at a remote point"]
)
def test_peers_take(more: list[scenes.Config], tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block("tetrahedron", 2), tmp_path / "block.msh")
    made = two_materials("tetrahedron", file)
    made["conditions"] += more
    row, _, _ = peers.solve(scenes.build(made), "tao-bnls", 1e-10)
    assert row["energy"] == pytest.approx(solve(made).summary["solution"]["energy"], rel=1e-8)


def test_two_bodies_are_compared_with_one_mesh_through_both(tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block("tetrahedron", 2), tmp_path / "block.msh")
    (tmp_path / "fused").mkdir()
    (tmp_path / "fused" / "block.msh").write_bytes(file.read_bytes())
    one = two_materials("tetrahedron", file)
    one["contacts"] = []
    between = {"between": {"where": "abs(x - 0.5) < 1e-9"}}
    pair = {
        **one,
        "bodies": [
            {"name": name, "mesh": {"file": file.name, "group": name}, "boundaries": between,
             "material": one["bodies"][0]["material"][name]}
            for name in ("soft", "hard")
        ],
        "conditions": [{"on": "soft.x-", "displacement": [0, 0, 0]},
                       {"on": "hard.x+", "total_force": [3, 1, -60]}],
        "contacts": [{"on": "soft.between", "against": "hard.between"}],
    }  # fmt: skip
    scene = tmp_path / "pair.yaml"
    scene.write_text(json.dumps(pair))
    row = part_run.peer(scene, [], "linear-gamg", 1e-10)
    one["conditions"] = [{"on": "block.x-", "displacement": [0, 0, 0]},
                         {"on": "block.x+", "total_force": [3, 1, -60]}]  # fmt: skip
    assert row["used"] == "linear-gamg, fused"
    assert row["energy"] == pytest.approx(solve(one).summary["solution"]["energy"], rel=1e-8)
    (tmp_path / "fused" / "block.msh").unlink()
    with pytest.raises(UnsuitableError, match="no mesh through its bodies"):
        part_run.peer(scene, [], "linear-gamg", 1e-10)
    with pytest.raises(UnsuitableError, match="2 bodies"):
        part_run.peer(scene, [], "tao-bnls", 1e-10)
