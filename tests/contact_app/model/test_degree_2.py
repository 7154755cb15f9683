"""Degree 2: the undecomposed answer, patch tests, constant pressure, rates, any decomposition."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse.linalg import splu

from contact_app.errors import NoEquilibriumError
from contact_app.model.assembly import Element
from contact_app.run.solve import solve_scene
from contact_app.scene.material import Material
from contact_app.scene.yaml_reader import read
from meshes import BoxShape, decompose
from tests import meshfiles, reference, scenes
from tests.comparison import in_space, same_displacement, solve
from tests.contact_app.model.test_meshes_from_files import patch
from tests.contact_app.model.test_two_bodies import PAIRS, PRESSURE, patch_displacement, stack
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


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("subdomains", [1, 5])
def test_a_constant_pressure_is_constant(cell: str, subdomains: int) -> None:
    """Patch test: a block on a floor under a pressure q; σ = -q e⊗e, exact on any mesh."""
    q, E, nu, d = 100.0, 900.0, 0.25, scenes.dimension(cell)
    up = scenes.up(cell)
    made = scenes.quadratic(
        scenes.config(
            cell,
            [scenes.block(cell, 3, young=E, poisson=nu)],
            [*scenes.rollers(cell, axes="xy"[: d - 1]), {"on": f"block.{up}", "pressure": q}],
            [scenes.on_floor(cell)],
        )
    )
    solution = solve(made, subdomains)
    assert solution.summary["certificate"]["passed"]
    x, u = solution.nodes.points, solution.nodes.displacement
    down, across = -(1 - nu**2 if d == 2 else 1) * q / E, nu * (1 + nu if d == 2 else 1) * q / E
    exact = x[:, :d] * [*[across] * (d - 1), down]
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * abs(down))
    pressure = solution.nodes.contact_pressure
    on_floor = x[:, d - 1] < 1e-9
    np.testing.assert_allclose(pressure[on_floor], q, rtol=1e-7)
    assert not pressure[~on_floor].any()
    # Everywhere on the faces, also between corners where only those have rows.
    np.testing.assert_array_equal(np.isfinite(solution.nodes.gap), on_floor)
    assert solution.summary["solution"]["max_contact_pressure"] == pytest.approx(q, rel=1e-7)
    assert solution.summary["solution"]["contact_force"][d - 1] == pytest.approx(q, rel=1e-9)
    stress = solution.cells.stress[:, d - 1]
    np.testing.assert_allclose(stress, -q, rtol=1e-8)


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_a_pressure_that_varies_is_never_negative(cell: str) -> None:
    """A tilted load: the multiplier's field is linear on faces and has the load's moment."""
    made = scenes.quadratic(scenes.ALL["tilted_plane"](cell, 3))
    solution = solve(made, 3)
    assert solution.summary["certificate"]["passed"]
    assert solution.nodes.contact_pressure.min() >= 0.0
    assert solution.summary["solution"]["max_contact_pressure"] > 0.0


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


@pytest.mark.parametrize("cell", scenes.CELLS_2D)
def test_slender_beam(cell: str) -> None:
    """The guide's cantilever of cells four times as long as high, against Euler and Bernoulli."""
    path, exact = Path(__file__).parents[3] / "docs" / "guide" / "slender_cantilever.yaml", 0.1
    beam, _ = read(path)
    beam["bodies"][0]["mesh"]["box"]["cell"] = cell
    first = solve(beam, 1, tolerance=1e-6).summary
    second = solve(scenes.quadratic(beam), 1, tolerance=1e-6).summary
    assert first["solution"]["max_displacement"] < 0.15 * exact
    assert second["solution"]["max_displacement"] == pytest.approx(exact, rel=1e-3)
    assert second["certificate"]["passed"]
    assert any("use degree: 2" in w for w in first["certificate"]["warnings"])
    assert not any("degree: 2" in w for w in second["certificate"]["warnings"])


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


@pytest.mark.parametrize("cell", CELLS)
def test_meshes_from_files(cell: str, tmp_path: Path) -> None:
    """Distorted or cut anyhow: constant stress and constant pressure come out exactly."""
    file = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    d = scenes.dimension(cell)
    made = scenes.quadratic(patch(cell, file))
    for subdomains in (1, 6):
        solution = solve(made, subdomains)
        assert solution.summary["certificate"]["passed"]
        assert solution.summary["mesh"]["nodes"] == 9**d
        exact = solve(patch(cell, file), 1)
        assert solution.summary["solution"]["energy"] == pytest.approx(
            exact.summary["solution"]["energy"], rel=1e-9
        )
        pressure = solution.nodes.contact_pressure
        touching = pressure[pressure > 0.0]
        np.testing.assert_allclose(touching, touching[0], rtol=1e-6)
        assert len(touching) == 9 ** (d - 1)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "cell", ["tetrahedron", pytest.param("hexahedron", marks=pytest.mark.slow)]
)
def test_two_ranks(cell: str, tmp_path: Path) -> None:
    made = scenes.quadratic(scenes.wall(cell, 3))
    one, two = one_and_two(made, tmp_path, 5)
    assert two["decomposition"]["contact"] == one["decomposition"]["contact"]
    same_solution(one, two, 1e-8)


@pytest.mark.parametrize("cell", scenes.CELLS_2D)
def test_degrees_may_differ_between_bodies(cell: str) -> None:
    """Two bodies side by side, one of each degree, come out as if alone."""
    made = scenes.wall(cell, 3)
    (body,) = made["bodies"]
    shifted = {"lower": [3.0, 0.0], "upper": [4.0, 1.0], "cells": [3, 3], "cell": cell}
    other = {**body, "name": "other", "degree": 2, "mesh": {"box": shifted}}
    made["bodies"].append(other)
    made["conditions"] += [
        {**c, "on": c["on"].replace("block", "other")} for c in made["conditions"]
    ]
    made["contacts"].append(
        {"on": "other.x+", "obstacle": scenes.plane(cell, (4, 0, 0), (-1, 0, 0))}
    )
    both = solve(made, [2, 2]).summary["solution"]["energy"]
    alone = scenes.wall(cell, 3)
    parts = [solve(m, 1).summary["solution"]["energy"] for m in (alone, scenes.quadratic(alone))]
    assert both == pytest.approx(sum(parts), rel=1e-8)


def smooth_energy(cell: str, degree: int, n: int) -> float:
    """a(u_h, u_h) of the field u = ∇(eˣ cos y), held to its values on the surface of a block.

    The potential is harmonic, so u is in equilibrium without forces and σ = 2 μ ∇u.
    """
    d = scenes.dimension(cell)
    shape = BoxShape((0.0,) * d, (1.0,) * d, (n,) * d, cell, degree)
    (subdomain,) = decompose([shape], (1,) * d, MPI.COMM_SELF).subdomains
    reference = subdomain.reference
    stiffness = Element(reference, d).stiffness((Material(1.0, 0.3),), "strain").tocsc()
    x, y = reference.points[:, 0], reference.points[:, 1]
    u = np.zeros((len(x), d))
    u[:, 0], u[:, 1] = np.exp(x) * np.cos(y), -np.exp(x) * np.sin(y)
    free = np.ones(len(x), bool)
    free[np.unique(reference.facets)] = False
    free = np.repeat(free, d)
    u = u.ravel()
    u[free] = splu(stiffness[free][:, free]).solve(-(stiffness[free][:, ~free] @ u[~free]))
    return float(u @ (stiffness @ u))


@pytest.mark.parametrize("cell", CELLS)
def test_a_smooth_field_converges(cell: str) -> None:
    """Energy errors fall like h⁴: O(h²) in energy norm."""
    exact = 2.0 / (2.0 * 1.3) * (np.exp(2.0) - 1.0)  # 2 μ ∫ |∇u|², |∇u|² = 2 exp(2x)
    meshes = (4, 8) if scenes.dimension(cell) == 2 else (2, 4)
    coarse, fine = (abs(smooth_energy(cell, 2, n) - exact) for n in meshes)
    assert coarse < 1e-3 * exact
    assert np.log2(coarse / fine) == pytest.approx(4, abs=0.4)


@pytest.mark.parametrize(("lower", "upper", "n"), PAIRS)
@pytest.mark.parametrize("degrees", [(2, 2), (1, 2), (2, 1)], ids=str)
def test_two_bodies_that_do_not_match(
    lower: str, upper: str, n: tuple[int, int], degrees: tuple[int, int]
) -> None:
    """The contact patch test on non-matching meshes, to 1e-9, whichever side has degree 2."""
    made = stack(lower, upper, n)
    made["bodies"] = [{**b, "degree": p} for b, p in zip(made["bodies"], degrees, strict=True)]
    solution = solve(made, 3, tolerance=1e-11)
    points, u = solution.nodes.points, solution.nodes.displacement
    exact = patch_displacement(points, u.shape[1])
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    pressure = solution.nodes.contact_pressure
    touching = pressure[pressure > 0.0]
    np.testing.assert_allclose(touching, PRESSURE, rtol=1e-8)
    per_edge = degrees[1] * n[1] + 1
    assert len(touching) == per_edge ** (u.shape[1] - 1)


def test_hertz_near_incompressible() -> None:
    """E* = E/(1 - ν²) = 279,963 at ν = 0.4999: p0 = √(F'E*/(πR)) = 7899; plain cells lock."""
    config = Path(__file__).parents[3] / "configs" / "hertz_disc.yaml"
    peaks = []
    for remedy in ("false", "true"):
        overrides = (
            "bodies.0.material.poisson=0.4999", f"bodies.0.mean_dilatation={remedy}",
            "solver.tolerance=1e-6",
        )  # fmt: skip
        solved = solve_scene(scenes.read(config, overrides))
        peaks.append(solved.summary["solution"]["max_contact_pressure"])
    assert peaks[0] > 1.5 * 7899
    assert peaks[1] == pytest.approx(7899, rel=5e-3)
