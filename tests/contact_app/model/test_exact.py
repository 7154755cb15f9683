"""Contact problems whose answer is known exactly on any mesh.

Tolerance 1e-10 relative, as in the table "Exact on any mesh" of the project's verification list;
the solver's own tolerance is set below that.
"""

from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.comparison import counts, solve

TIGHT = 1e-12
EXACT = 1e-10


def at(solution: Any, *point: float) -> np.ndarray:
    """Displacement at the node at a point."""
    points, u = solution.nodes.points, solution.nodes.displacement
    distance = np.linalg.norm(points[:, : len(point)] - np.array(point), axis=1)
    assert distance.min() < 1e-9
    return np.asarray(u)[np.argmin(distance)]


def half(cell: str) -> list[int]:
    return [2] * scenes.dimension(cell)


@pytest.mark.parametrize("cell", scenes.CELLS_3D + scenes.CELLS_2D)
@pytest.mark.parametrize("split", [False, True], ids=["whole", "split"])
def test_bar_against_a_wall(cell: str, split: bool) -> None:
    solution = solve(scenes.bar(cell, 4), half(cell) if split else 1, tolerance=TIGHT)
    found = solution.summary["solution"]
    assert at(solution, 1, 0)[0] == pytest.approx(0.4, rel=EXACT)
    assert found["contact_force"][0] == pytest.approx(-0.6, rel=EXACT)
    np.testing.assert_allclose(found["contact_force"][1:], 0, atol=EXACT)
    assert found["energy"] == pytest.approx(-0.32, rel=EXACT)
    assert found["max_contact_pressure"] == pytest.approx(0.6, rel=1e-8)


@pytest.mark.parametrize("cell", scenes.CELLS_3D)
@pytest.mark.parametrize("subdomains", [1, [2, 2, 2], 5], ids=str)
def test_patch_in_space(cell: str, subdomains: int | list[int]) -> None:
    solution = solve(scenes.patch(cell, 4), subdomains, tolerance=TIGHT)
    np.testing.assert_allclose(at(solution, 1, 1, 1), [1 / 36, 1 / 36, -1 / 9], rtol=EXACT)
    points, u = solution.nodes.points, solution.nodes.displacement
    np.testing.assert_allclose(u, points * [1 / 36, 1 / 36, -1 / 9], atol=EXACT / 9)
    found = solution.summary["solution"]
    assert found["contact_force"][2] == pytest.approx(100, rel=EXACT)
    if cell == "hexahedron":
        assert found["max_contact_pressure"] == pytest.approx(100, rel=1e-8)


@pytest.mark.parametrize("subdomains", [1, 2])
def test_a_body_whose_nodes_are_all_held(subdomains: int) -> None:
    scene = {
        "dimension": 2,
        "bodies": [scenes.box("block", [1, 1], [1, 2], young=1.0e5)],
        "conditions": [
            {"on": "block.x-", "displacement": [0, 0]},
            {"on": "block.x+", "displacement": [0, 0.01]},
            {"in": "block", "force": [0, -1]},
        ],
    }
    solution = solve(scene, subdomains, tolerance=TIGHT)
    points, u = solution.nodes.points, solution.nodes.displacement
    np.testing.assert_allclose(u, np.outer(points[:, 0], [0, 0.01]), atol=EXACT * 0.01)
    assert solution.summary["certificate"]["passed"]


@pytest.mark.parametrize("cell", scenes.CELLS_2D)
@pytest.mark.parametrize("assumption", ["strain", "stress"])
@pytest.mark.parametrize("subdomains", [1, [2, 2], 3], ids=str)
def test_patch_in_the_plane(cell: str, assumption: str, subdomains: int | list[int]) -> None:
    E, nu, q = 2.1e5, 0.3, 100.0
    solution = solve(scenes.patch(cell, 4, assumption), subdomains, tolerance=TIGHT)
    down, side = (-(1 - nu**2), nu * (1 + nu)) if assumption == "strain" else (-1.0, nu)
    points, u = solution.nodes.points, solution.nodes.displacement
    expected = points[:, :2] * np.array([side, down]) * q / E
    np.testing.assert_allclose(u, expected, atol=EXACT * q / E)
    if assumption == "strain":
        assert at(solution, 1, 1)[1] == pytest.approx(-4.3333e-4, rel=1e-5)
    found = solution.summary["solution"]
    assert found["contact_force"][1] == pytest.approx(q, rel=EXACT)
    assert found["max_contact_pressure"] == pytest.approx(q, rel=1e-8)


@pytest.mark.parametrize("factor", [4.0, 1000.0, 1e-6])
@pytest.mark.parametrize("name", ["wall", "duplicate_obstacles", "rollers_and_floor"])
def test_homogeneity(name: str, factor: float) -> None:
    """All gaps are zero: u(t f) = t u(f), the same active set, the same counts."""
    made = scenes.ALL[name]("hexahedron", 4)
    made["contacts"] = made["contacts"][:2]  # the third plane of the duplicates is turned
    one = solve(made, [2, 2, 2])
    many = solve(scenes.scaled(made, factor), [2, 2, 2])
    u_one, u_many = one.nodes.displacement, many.nodes.displacement
    np.testing.assert_allclose(u_many, factor * u_one, rtol=0, atol=EXACT * np.abs(u_many).max())
    active = [s.summary["solution"]["active_contacts"] for s in (one, many)]
    assert active[0] == active[1]
    assert counts(one) == counts(many)
