"""Degree 2: the undecomposed answer, patch tests, constant pressure, rates, any decomposition."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.errors import NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import reference, scenes
from tests.comparison import in_space, same_displacement, solve
from tests.rows import covering
from tests.scenes_on_ranks import one_and_two, same_solution

CELLS = (*scenes.CELLS_2D, *scenes.CELLS_3D)


@pytest.mark.parametrize(("name", "cell"), covering(["wall", "floating_in_corner"], CELLS))
def test_the_undecomposed_answer(name: str, cell: str) -> None:
    made = scenes.quadratic(scenes.ALL[name](cell, 3))
    known = reference.solve(scenes.build(made))
    scale = max(abs(known.energy), 0.5 * abs(known.u.ravel() @ known.system.load))
    d = scenes.dimension(cell)
    for subdomains in (1, [2] * d, 4):
        solution = solve(made, subdomains)
        summary = solution.summary
        assert summary["certificate"]["passed"], summary["certificate"]
        assert summary["mesh"]["nodes"] == known.points.shape[0] == 7**d
        assert summary["solution"]["energy"] == pytest.approx(known.energy, rel=0, abs=1e-8 * scale)
        same_displacement(known, solution)
        np.testing.assert_allclose(
            summary["solution"]["contact_force"], in_space(known.contact_force),
            rtol=0, atol=1e-6 * np.abs(known.system.load).sum(),
        )  # fmt: skip


def press(cell: str, n: int, poisson: float, **options: object) -> scenes.Config:
    """A block between walls and above a floor, pushed down on the left half of its top."""
    d = scenes.dimension(cell)
    left = f"{'z' if d == 3 else 'y'} > 1 - 1e-9 and x < 0.5 + 1e-9"
    block = scenes.block(cell, n, young=1.0, poisson=poisson, boundaries={"left": left})
    held = scenes.rollers(cell, "-+", axes="xy"[: d - 1])
    push = {"on": "block.left", "pressure": 0.01}
    return scenes.config(cell, [{**block, **options}], [*held, push], [scenes.on_floor(cell)])


def sinking(made: scenes.Config) -> float:
    """Largest displacement downwards."""
    u = solve(made, 1).nodes.displacement
    return float(-u[:, -1].min())


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("remedy", [{}, {"degree": 2}, {"mean_dilatation": True}], ids=str)
def test_confined_column(cell: str, remedy: dict[str, object]) -> None:
    """Uniform confined strain: σ = M ε with M = 1667.1, which every element represents."""
    if "mean_dilatation" in remedy and cell in ("triangle", "tetrahedron"):
        pytest.skip("for quadrilaterals and hexahedra")
    nu, d = 0.4999, scenes.dimension(cell)
    modulus = (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    made = press(cell, 2, nu, **remedy)
    made["conditions"][-1]["on"] = f"block.{scenes.up(cell)}"
    solution = solve(made, [2] * d)
    assert solution.summary["certificate"]["passed"]
    x, u = solution.nodes.points, solution.nodes.displacement
    np.testing.assert_allclose(u[:, -1], -0.01 / modulus * x[:, d - 1], rtol=0, atol=1e-12)
    assert solution.summary["solution"]["max_contact_pressure"] == pytest.approx(0.01, rel=1e-6)
    warnings = " ".join(solution.summary["certificate"]["warnings"])
    assert ("use" in warnings and "degree: 2" in warnings) == (not remedy)


@pytest.mark.parametrize(
    "cell", ["quadrilateral", pytest.param("hexahedron", marks=pytest.mark.slow)]
)
def test_remedies_of_volumetric_locking(cell: str) -> None:
    """At ν = 0.4999 the same mesh sinks as far as a fine one, except plain first-order cells."""
    n = 4
    fine = sinking(press(cell, 2 * n, 0.4999, degree=2))
    assert sinking(press(cell, n, 0.4999)) < 0.75 * fine
    assert sinking(press(cell, n, 0.4999, mean_dilatation=True)) == pytest.approx(fine, rel=0.2)
    assert sinking(press(cell, n, 0.4999, degree=2)) == pytest.approx(fine, rel=0.1)


def test_the_corner_of_the_guides_block_sinks_by_a_thousandth() -> None:
    path = Path(__file__).parents[3] / "docs" / "guide" / "confined_block.yaml"
    found = solve_scene(scenes.read(path, ["bodies.0.degree=2"])).summary
    corner = found["probes"]["corner"]["displacement"]
    assert corner == pytest.approx([0.0, -0.001], rel=2e-3, abs=1e-9)


@pytest.mark.parametrize("cell", CELLS)
def test_a_repeated_obstacle_adds_no_rows(cell: str) -> None:
    """Only the tightest of parallel rows is used, at nodes or in the mean; no node is squeezed."""
    made = scenes.quadratic(scenes.wall(cell, 2))
    known = solve(made, 3).summary
    looser = {"on": "block.x+", "obstacle": scenes.plane(cell, (1.01, 0, 0), (-2, 0, 0))}
    for contacts in ([*made["contacts"], looser], [looser, *made["contacts"]]):
        found = solve({**made, "contacts": contacts}, 3).summary
        assert found["decomposition"]["contact"] == known["decomposition"]["contact"]
        energy = known["solution"]["energy"]
        assert found["solution"]["energy"] == pytest.approx(energy, rel=1e-8)


def test_two_obstacles_without_room() -> None:
    cell = "tetrahedron"
    made = scenes.quadratic(scenes.wall(cell, 2))
    behind = {"on": "block.x+", "obstacle": scenes.plane(cell, (1.1, 0, 0), (1, 0, 0))}
    with pytest.raises(NoEquilibriumError, match="overlap by 0.1 "):
        solve({**made, "contacts": [*made["contacts"], behind]}, 2)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "cell", ["tetrahedron", pytest.param("hexahedron", marks=pytest.mark.slow)]
)
def test_two_ranks(cell: str, tmp_path: Path) -> None:
    made = scenes.quadratic(scenes.wall(cell, 3))
    one, two = one_and_two(made, tmp_path, 5)
    assert two["decomposition"]["contact"] == one["decomposition"]["contact"]
    same_solution(one, two, 1e-8)
