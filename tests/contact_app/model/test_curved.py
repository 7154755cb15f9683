"""Second-order meshes at degree 2: patch tests, the undecomposed answer, rates beside Lamé's."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from tests import meshfiles, reference, scenes
from tests.comparison import same_displacement
from tests.contact_app.model.test_meshes_from_files import patch, two_materials
from tests.scenes_on_ranks import one_and_two, same_solution

NAMES = [(cell, name) for cell, names in meshfiles.SECOND.items() for name in names]


def written(
    cell: str, name: str, shape: Callable[[np.ndarray], np.ndarray], directory: Path
) -> Path:
    first = meshfiles.block(cell, 2, 0.1)
    mesh = meshfiles.second_order(first, cell, name, shape)
    return meshfiles.write(mesh, directory / "part.msh")


def wavy(x: np.ndarray) -> np.ndarray:
    """Move the nodes of the unit block inside it and within its faces: all edges are curved."""
    waves = 0.04 * np.sin(2 * np.pi * x)
    across = np.cos(2 * np.pi * np.roll(x, 1, axis=1) + 0.5)
    return x + waves * across


@pytest.mark.parametrize(("cell", "name"), NAMES)
@pytest.mark.parametrize("subdomains", [1, 3])
def test_contact_patch_on_curved_cells(
    cell: str, name: str, subdomains: int, tmp_path: Path
) -> None:
    """Uniform stress and pressure come out to round-off, whatever the edges inside."""
    made = scenes.quadratic(patch(cell, written(cell, name, wavy, tmp_path)))
    solved = solve_scene(scenes.build(made, subdomains))
    assert all(s.reference.curved for s in solved.model.partition.subdomains)
    points, u = solved.nodes.points, solved.nodes.displacement
    d = meshfiles.dimension(cell)
    slope = np.array([0.25, 0.25, -1.0]) * 100 / 900
    if d == 2:  # plane strain
        slope = np.array([0.25 * 1.25, -(1 - 0.25**2)]) * 100 / 900
    np.testing.assert_allclose(u, points[:, :d] * slope, rtol=0, atol=1e-9 * np.abs(slope).max())
    assert solved.summary["certificate"]["passed"]
    pressure = solved.nodes.contact_pressure
    assert pressure[pressure > 0.0] == pytest.approx(100.0, rel=1e-7)
    assert (pressure > 0.0).sum() == 5 ** (d - 1)
    np.testing.assert_allclose(solved.cells.stress[:, d - 1], -100.0, rtol=1e-8)


def bent_scene(cell: str, name: str, directory: Path) -> scenes.Config:
    """A bent block of two materials beside a round obstacle."""
    made = scenes.quadratic(two_materials(cell, written(cell, name, meshfiles.bend, directory)))
    d = meshfiles.dimension(cell)
    made["conditions"] = [
        scenes.clamp(cell, "block.y-"),
        {"on": "block.y+", "traction": [-40.0, -60.0, 5.0][:d]},
        {"on": "block.x+", "pressure": 30.0},
    ]
    angle = np.deg2rad(35.0)
    centre = [float(0.5 * np.cos(angle)), float(0.5 * np.sin(angle)), 0.5][:d]
    ball = {"sphere": {"center": centre, "radius": 0.501}}
    made["contacts"] = [{"on": "block.x-", "obstacle": ball}]
    return made


@pytest.mark.parametrize(("cell", "name"), NAMES)
@pytest.mark.parametrize("subdomains", [1, 4])
def test_the_undecomposed_answer(cell: str, name: str, subdomains: int, tmp_path: Path) -> None:
    """Against dolfinx on the whole mesh and an active set."""
    scene = scenes.build(bent_scene(cell, name, tmp_path), subdomains)
    known = reference.solve(scene)
    assert known.active > 0
    solved = solve_scene(scene)
    assert solved.summary["certificate"]["passed"]
    same_displacement(known, solved)
    assert solved.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-8)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "name"),
    [("quadrilateral", "quad8"), pytest.param("tetrahedron", "tetra10", marks=pytest.mark.slow)],
)
def test_two_ranks(cell: str, name: str, tmp_path: Path) -> None:
    """Vertices come first among a file's nodes: the second rank owns none of them."""
    made = bent_scene(cell, name, tmp_path)
    one, two = one_and_two(made, tmp_path, 3)
    same_solution(one, two, 1e-7)
    for key in ("discretisation", "total"):
        assert two["accuracy"][key] == pytest.approx(one["accuracy"][key], rel=1e-6)


quarter = meshfiles.ring(10.0, 20.0, 2.0)
"""Bend the unit block into a quarter of a ring, two high."""


def ring(cell: str, name: str | None, n: int, directory: Path) -> SolvedScene:
    """Lamé's ring in a rigid bore; straight edges without the name of a second-order cell."""
    d = meshfiles.dimension(cell)
    mesh = meshfiles.block(cell, n, 0.0)
    if name:
        mesh = meshfiles.second_order(mesh, cell, name, quarter)
    else:
        mesh.points = quarter(mesh.points)
    file = meshfiles.write(mesh, directory / "ring.msh")
    flat = [("y-", 1), ("y+", 0), *([("z-", 2), ("z+", 2)] if d == 3 else [])]
    made = scenes.config(
        cell,
        [{"name": "ring", "degree": 2, "mesh": {"file": str(file)},
          "material": {"young": 2.1e5, "poisson": 0.3}}],
        [*({"on": f"ring.{side}", "displacement": [0 if i == k else None for i in range(d)]}
           for side, k in flat), {"on": "ring.x-", "pressure": 100.0}],
        [{"on": "ring.x+", "obstacle": bore(d)}],
    )  # fmt: skip
    made["solver"]["tolerance"] = 1e-9
    solved = solve_scene(scenes.build(made, 1))
    assert solved.summary["certificate"]["passed"]
    return solved


def bore(d: int) -> dict[str, object]:
    if d == 2:
        return {"sphere": {"center": [0, 0], "radius": 19.99, "hollow": True}}
    return {"cylinder": {"point": [0, 0, 0], "axis": [0, 0, 1], "radius": 19.99, "hollow": True}}


@pytest.mark.parametrize("cell", list(meshfiles.SECOND))
def test_a_polygon_causes_a_warning(cell: str, tmp_path: Path) -> None:
    """Straight edges on a round boundary: the certificate names the sagitta h²/8R."""
    n = 4
    straight = ring(cell, None, n, tmp_path).summary["certificate"]["warnings"]
    (told,) = [w for w in straight if "answer is that of the polygon" in w]
    assert "the boundary of ring is round and the edges of its mesh are straight" in told
    found = float(told.split("lies up to ")[1].split()[0])
    exact = 20.0 * (1.0 - np.cos(np.pi / (4 * n)))
    assert found == pytest.approx(exact, rel=0.4 if cell == "tetrahedron" else 0.1)
    name = meshfiles.SECOND[cell][-1]
    curved = ring(cell, name, n, tmp_path).summary["certificate"]["warnings"]
    assert not any("polygon" in w for w in curved)


def test_a_refined_polygon_causes_a_warning() -> None:
    """Halved edges of degree 1 have nodes inside the pin of a bore, which its corners clear."""
    path = Path(__file__).parents[3] / "configs" / "bushing.yaml"
    told = {}
    for key in ("bodies.0.mesh.refine=0", "bodies.0.mesh.refine=1", "accuracy=0.2"):
        scene = scenes.read(path, [key])
        if scene.accuracy is None:
            solved = solve_scene(scene)
        else:
            solved = solve_to_accuracy(scene, lambda level, start: solve_scene(level)).solved
        warnings = solved.summary["certificate"]["warnings"]
        told[key] = [w for w in warnings if "answer is that of the polygon" in w]
    sagitta = 5.0 * (1.0 - np.cos(np.pi / 40))  # 40 corners on a circle of radius 5
    for key, said in told.items():
        assert len(said) == (key != "bodies.0.mesh.refine=0"), key
        for text in said:
            found = float(text.split("lies up to ")[1].split()[0])
            assert found == pytest.approx(sagitta, rel=0.1)
            assert "use degree: 2 and a mesh file of second order" in text
