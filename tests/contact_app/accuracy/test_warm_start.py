"""Each level of a run to an accuracy begins with the answer of the last."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Decomposition, Scene
from tests import scenes
from tests.rows import covering
from tests.scenes_on_ranks import summary_of

ROOT = Path(__file__).parents[3]


def built(path: str, *overrides: str, subdomains: Any = None) -> Scene:
    scene = scenes.read(ROOT / path, overrides)
    return replace(scene, decomposition=Decomposition(subdomains))


def cube(cells: int, *overrides: str, subdomains: Any = None) -> Scene:
    mesh = f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]"
    return built("configs/cube.yaml", mesh, *overrides, subdomains=subdomains)


def products(solved: SolvedScene) -> int:
    return int(solved.summary["solver"]["hessian_multiplications"])


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("cell", "subdomains"), covering(["hexahedron", "tetrahedron"], [1, (2, 2, 2), 7])
)
def test_a_level_begins_with_the_answer_of_the_last(cell: str, subdomains: Any) -> None:
    """The same answer for any decomposition; undecomposed bodies take half the products.

    Forces between subdomains begin at zero, so that decomposed bodies may take a few more. The
    foot is held: its nodes have no contact rows and tell nothing of the pressure beside it."""
    wanted = [f"bodies.0.mesh.box.cell={cell}", "solver.tolerance=1e-3"]
    start = LastLevel.of(solve_scene(cube(6, *wanted, subdomains=3)))
    fine = cube(10, *wanted, subdomains=subdomains)
    cold, warm = (solve_scene(fine, start=s) for s in (None, start))
    assert warm.solution.warm
    assert not cold.solution.warm
    energies = [s.summary["solution"]["energy"] for s in (warm, cold)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-4)
    most = 0.6 if subdomains == 1 else 1.3
    assert products(warm) <= most * products(cold)


@pytest.mark.ratchet
def test_all_levels_but_the_first_begin_with_the_last() -> None:
    """A disc that contact alone holds: fewer products, and each level says so."""
    scene = built("configs/hertz_disc.yaml", "accuracy=0.02", subdomains=1)
    warm = solve_to_accuracy(scene, solve_scene)
    cold = solve_to_accuracy(scene, lambda scene, *, start: solve_scene(scene))
    assert not warm.missed
    assert [level.warm for level in warm.levels] == [False, *[True] * (len(warm.levels) - 1)]
    assert not any(level.warm for level in cold.levels)
    spent = [sum(level.hessian_multiplications for level in r.levels) for r in (warm, cold)]
    assert spent[0] <= 0.8 * spent[1], spent
    assert "started from the last level" in str(warm.levels[1])
    assert "started from the last level" not in str(warm.levels[0])


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
