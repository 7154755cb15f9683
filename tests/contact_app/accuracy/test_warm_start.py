"""Each level of a run to an accuracy begins with the answer of the last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from contact_app.accuracy.estimate.point_values import PointValues
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Decomposition, Scene
from tests import scenes
from tests.rows import covering
from tests.scenes_on_ranks import summary_of

ROOT = Path(__file__).parents[3]


def built(path: str, *overrides: str, subdomains: Any = None) -> Scene:
    scene = build_scene(load(ROOT / path, overrides))
    return replace(scene, decomposition=Decomposition(subdomains))


def cube(cells: int, *overrides: str, subdomains: Any = None) -> Scene:
    mesh = f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]"
    return built("configs/cube.yaml", mesh, *overrides, subdomains=subdomains)


def hertz(cells: int, subdomains: int) -> Scene:
    wanted = [f"bodies.0.mesh.box.cells=[{cells},{cells}]", "bodies.0.degree=2"]
    return built("tests/data/hertz.yaml", *wanted, subdomains=subdomains)


def products(solved: SolvedScene) -> int:
    return int(solved.summary["solver"]["hessian_multiplications"])


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("cell", "subdomains"), covering(["hexahedron", "tetrahedron"], [1, (2, 2, 2), 7])
)
def test_a_level_begins_with_the_answer_of_the_last(cell: str, subdomains: Any) -> None:
    """Undecomposed and decomposed bodies: the same answer with fewer products, for any
    decomposition of the last level."""
    wanted = [f"bodies.0.mesh.box.cell={cell}", "solver.tolerance=1e-3"]
    start = LastLevel.of(solve_scene(cube(6, *wanted, subdomains=3)))
    fine = cube(10, *wanted, subdomains=subdomains)
    cold, warm = (solve_scene(fine, start=s) for s in (None, start))
    assert warm.solution.warm
    assert not cold.solution.warm
    energies = [s.summary["solution"]["energy"] for s in (warm, cold)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-4)
    # planes cut odd numbers of parts through cells, other ones in other releases of numpy
    most = 0.9 if subdomains != 7 else 1.1
    assert products(warm) <= most * products(cold)


def start_error(coarse: SolvedScene, fine: SolvedScene) -> float:
    """Error in energy norm of the multipliers a mesh begins with, over the norm of its answer."""
    problem, exact = fine.model.problem, fine.solution.multiplier
    start = LastLevel.of(coarse).on(fine.model).multiplier
    assert problem.coarse is not None
    missing, change = np.empty_like(problem.e), np.empty(problem.size)
    problem.coarse.restrict(start, missing)
    problem.coarse.solve(problem.e - missing, missing)
    problem.coarse.extend(missing, change)
    error, image = start + change - exact, np.empty(problem.size)
    problem.F.apply(error, image)
    strained = sum(
        np.vdot(u, cls.stiffness @ u)
        for cls, u in zip(problem.classes, fine.solution.displacements, strict=True)
    )
    return float(np.sqrt(error @ image / strained))


ROLLER = "configs/roller_on_block.yaml"


@pytest.mark.parametrize(
    ("coarse", "fine"),
    [
        (cube(6, subdomains=(2, 2, 2)), cube(12, subdomains=(3, 2, 2))),
        (
            cube(5, "bodies.0.mesh.box.cell=tetrahedron", subdomains=3),
            cube(8, "bodies.0.mesh.box.cell=tetrahedron", subdomains=5),
        ),
        (cube(4, "bodies.0.degree=1", subdomains=1), cube(4, "bodies.0.degree=2", subdomains=4)),
        (hertz(16, 4), hertz(28, 7)),
        (built(ROLLER, subdomains=4), built(ROLLER, subdomains=9)),
    ],
    ids=["hexahedra", "tetrahedra", "degree 2", "Hertz", "pair"],
)
def test_the_start_is_as_good_as_the_mesh_it_comes_from(coarse: Scene, fine: Scene) -> None:
    last, solved = solve_scene(coarse), solve_scene(fine)
    assert start_error(last, solved) <= 1.2 * last.accuracy.discretisation


@pytest.mark.ratchet
def test_all_levels_but_the_first_begin_with_the_last() -> None:
    """A disc that contact alone holds, in parts: half the products, and each level says so."""
    scene = built("configs/hertz_disc.yaml", "accuracy=0.02", subdomains=8)
    warm = solve_to_accuracy(scene, solve_scene)
    cold = solve_to_accuracy(scene, lambda scene, *, start: solve_scene(scene))
    assert not warm.missed
    assert [level.warm for level in warm.levels] == [False, *[True] * (len(warm.levels) - 1)]
    assert not any(level.warm for level in cold.levels)
    spent = [sum(level.hessian_multiplications for level in r.levels) for r in (warm, cold)]
    assert spent[0] <= 0.7 * spent[1]
    assert "started from the last level" in str(warm.levels[1])
    assert "started from the last level" not in str(warm.levels[0])


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_values_between_nodes(cell: str, degree: int) -> None:
    """Polynomials of the degree of the cells come out at any point of a body, and near it."""
    made = scenes.two_bodies(cell, 3)
    for body in made["bodies"]:
        body["degree"] = degree
    model = solve_scene(scenes.build(made, 5)).model
    d = model.scene.dimension

    def field(x: NDArray[np.float64], body: NDArray[np.int64]) -> NDArray[np.float64]:
        y = x[..., :d] @ np.arange(1.0, d + 1.0) + body
        return np.stack([y, y**degree], axis=-1)

    values = [
        np.zeros((cls.unknowns // d, cls.members, 2)) for cls in model.problem.classes
    ]  # fmt: skip
    points, bodies = [], []
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        values[cls][:, column] = field(s.points(), np.full(len(s.nodes), s.body))
        mine = s.points()[s.reference.cells[:, : d + 1]]
        shares = np.random.default_rng(3).dirichlet(np.ones(d + 1), len(mine))
        points.append(np.einsum("cn,cni->ci", shares, mine))
        bodies.append(np.full(len(mine), s.body))
    x, body = np.concatenate(points), np.concatenate(bodies)
    lookup = PointValues(model, values)
    np.testing.assert_allclose(lookup.at(x, body), field(x, body), atol=1e-9)
    assert lookup.at(np.zeros((0, 3)), np.zeros(0, np.int64)).shape == (0, 2)
    lower, size = x.min(axis=0), np.ptp(x, axis=0).max()
    outside = lower[None] - 1e-3 * size * np.eye(3)[:1]
    near = lookup.at(outside, body[[x[:, 0].argmin()]])
    assert np.abs(near).sum() > 0.0, "answered from the nearest cell"
    np.testing.assert_array_equal(lookup.at(lower[None] - 10.0 * size, body[:1]), 0.0)


@pytest.mark.mpi
def test_levels_on_ranks_begin_alike(tmp_path: Path) -> None:
    made = scenes.wall("triangle", 4)
    made |= {"accuracy": 0.1, "decomposition": {"subdomains": 6}}
    del made["solver"]
    one, two = (summary_of(made, tmp_path, ranks) for ranks in (1, 2))
    assert len(one["levels"]) >= 2
    assert [level["warm"] for level in one["levels"]] == [False, *[True] * (len(one["levels"]) - 1)]
    for a, b in zip(one["levels"], two["levels"], strict=True):
        assert b["warm"] == a["warm"]
        assert b["dofs"] == a["dofs"]
        assert b["hessian_multiplications"] == pytest.approx(a["hessian_multiplications"], abs=2)
    log = (tmp_path / "out2" / "run.log").read_text()
    assert log.count("started from the last level") == len(two["levels"]) - 1
