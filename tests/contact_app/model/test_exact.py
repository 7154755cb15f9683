"""Contact problems whose answer is known exactly on any mesh.

Tolerance 1e-10 relative, as in the table "Exact on any mesh" of the project's verification list;
the solver's own tolerance is set below that.
"""

import copy
from typing import Any

import numpy as np
import pytest

from tests import reference, scenes
from tests.comparison import counts, in_order_of, solve

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


@pytest.mark.parametrize(
    "name", ["wall", "tilted_plane", "hollow_sphere", "floating_in_corner", "two_planes"]
)
def test_energy_identity(name: str) -> None:
    """a(u,u) = l(u) - λᵀg, with λ read off the balance K u - f of the undecomposed problem."""
    cell = "hexahedron"
    made = scenes.ALL[name](cell, 4)
    solution = solve(made, [2, 2, 2], tolerance=TIGHT)
    known = reference.solve(scenes.build(made))
    system = known.system
    u = in_order_of(known, solution).ravel()
    strain_energy, work = u @ (system.stiffness @ u), u @ system.load
    # Contact forces from the balance: least squares over the touching rows of free components.
    touching = known.multiplier > 0
    rows = system.contact[touching][:, ~system.held].toarray()
    missing = (system.load - system.stiffness @ u)[~system.held]
    multiplier, *_ = np.linalg.lstsq(rows.T, missing, rcond=None)
    identity = work - multiplier @ system.gap[touching]
    assert strain_energy == pytest.approx(identity, rel=1e-9)
    energy = solution.summary["solution"]["energy"]
    assert energy == pytest.approx(0.5 * strain_energy - work, rel=EXACT)
    assert energy == pytest.approx(known.energy, rel=EXACT)


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


def converted(made: scenes.Config, length: float, pressure: float) -> scenes.Config:
    """The same scene in other units: lengths and pressures are multiplied by the factors."""
    made = copy.deepcopy(made)

    def lengths(values: list[float | None]) -> list[float | None]:
        return [None if value is None else length * value for value in values]

    for body in made["bodies"]:
        box = body["mesh"]["box"]
        box["lower"], box["upper"] = lengths(box["lower"]), lengths(box["upper"])
        body["material"]["young"] *= pressure
    for item in made["conditions"]:
        if "displacement" in item:
            item["displacement"] = lengths(item["displacement"])
        if "traction" in item:
            item["traction"] = [pressure * value for value in item["traction"]]
        if "pressure" in item:
            item["pressure"] *= pressure
        if "force" in item:
            item["force"] = [pressure / length * value for value in item["force"]]
    for item in made["contacts"]:
        ((kind, obstacle),) = item["obstacle"].items()
        for key in {"plane": ["point"], "sphere": ["center"], "cylinder": ["point"]}[kind]:
            obstacle[key] = lengths(obstacle[key])
        if "radius" in obstacle:
            obstacle["radius"] *= length
    return made


@pytest.mark.parametrize("name", ["wall", "sphere", "floating_in_corner", "cylinder"])
@pytest.mark.parametrize(
    ("length", "pressure"), [(1e-3, 1e6), (1e3, 1e-3)], ids=["N-mm to N-m", "to km and kPa"]
)
def test_change_of_units(name: str, length: float, pressure: float) -> None:
    made = scenes.ALL[name]("hexahedron", 4)
    one = solve(made, [2, 2, 2])
    other = solve(converted(made, length, pressure), [2, 2, 2])
    points, u = one.nodes.points, one.nodes.displacement
    other_points, other_u = other.nodes.points, other.nodes.displacement
    np.testing.assert_allclose(other_points, length * points, rtol=0, atol=1e-12 * length)
    np.testing.assert_allclose(other_u, length * u, rtol=0, atol=EXACT * length * np.abs(u).max())
    energy = pressure * length**3
    assert other.summary["solution"]["energy"] == pytest.approx(
        energy * one.summary["solution"]["energy"], rel=EXACT
    )
    for key in (
        "max_penetration",
        "max_gluing_jump",
        "complementarity",
        "equilibrium",
        "duality_gap",
    ):
        ours, theirs = (s.summary["certificate"][key] for s in (one, other))
        assert ours == pytest.approx(theirs, rel=0.05, abs=1e-12), f"{key} is not relative"
    assert counts(one) == counts(other)
