"""Tied interfaces of meshes that do not match: patch tests, cantilevers, edges and cross-points."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from tests import rings, scenes
from tests.comparison import solve
from tests.scenes_on_ranks import one_and_two

YOUNG, POISSON = 900.0, 0.25


def uniform(points: np.ndarray) -> np.ndarray:
    """A displacement whose gradient is the same everywhere, with shear and rotation."""
    d = points.shape[1]
    gradient = np.array([[0.01, 0.02, -0.01], [-0.005, -0.01, 0.015], [0.02, 0.01, 0.02]])[:d, :d]
    return points @ gradient.T


def stacked(lower: str, upper: str, n: tuple[int, int], degrees: tuple[int, int]) -> scenes.Config:
    """A block tied on a block of other cells; degree and material may differ."""
    up, down = scenes.up(lower), scenes.down(lower)
    bodies = [
        scenes.block(lower, n[0], "lower", young=YOUNG, poisson=POISSON),
        scenes.block(upper, n[1], "upper", (0, 0, 1), (1, 1, 2), YOUNG, POISSON),
    ]
    for body, degree in zip(bodies, degrees, strict=True):
        body["degree"] = degree
    contacts = [{"on": f"upper.{down}", "against": f"lower.{up}", "tied": True}]
    return scenes.config(lower, bodies, [], contacts)


def hold(made: scenes.Config, name: str, where: str, value: list[float]) -> None:
    """Hold a part of a body at a displacement."""
    body = next(b for b in made["bodies"] if b["name"] == name)
    boundary = f"p{len(made['conditions'])}"
    body.setdefault("boundaries", {})[boundary] = {"where": where}
    made["conditions"].append({"on": f"{name}.{boundary}", "displacement": value})


PATCHES = [
    ("quadrilateral", "triangle", (3, 5), (1, 1)),
    ("triangle", "quadrilateral", (4, 3), (2, 1)),
    ("quadrilateral", "quadrilateral", (7, 2), (2, 2)),
    ("hexahedron", "tetrahedron", (2, 3), (1, 1)),
    ("tetrahedron", "hexahedron", (3, 2), (1, 2)),
    ("hexahedron", "hexahedron", (3, 2), (2, 1)),
    ("tetrahedron", "tetrahedron", (2, 3), (2, 2)),
]


def strained(made: scenes.Config) -> list[scenes.Config]:
    """Conditions that hold the ends of a stack at a uniform strain, and sides loaded to suit."""
    d = 3 if made["dimension"] == 3 else 2
    lam = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    mu = YOUNG / (2 * (1 + POISSON))
    gradient = uniform(np.eye(d)).T
    strain = 0.5 * (gradient + gradient.T)
    stress = lam * np.trace(strain) * np.eye(d) + 2 * mu * strain
    conditions: list[scenes.Config] = []
    for name, end in (("lower", "-"), ("upper", "+")):
        for axis in range(d - 1):
            for side, sign in (("-", -1.0), ("+", 1.0)):
                traction = (sign * stress[:, axis]).tolist()
                conditions.append({"on": f"{name}.{'xyz'[axis]}{side}", "traction": traction})
        traction = (stress[:, d - 1] * (1.0 if end == "+" else -1.0)).tolist()
        if name == "upper":
            conditions.append({"on": f"{name}.{'xyz'[d - 1]}{end}", "traction": traction})
        else:
            conditions.append({"on": f"lower.{'xyz'[d - 1]}-", "traction": traction})
    return conditions


@pytest.mark.parametrize(("lower", "upper", "n", "degrees"), PATCHES)
@pytest.mark.parametrize("split", [1, 5])
def test_patch(
    lower: str, upper: str, n: tuple[int, int], degrees: tuple[int, int], split: int
) -> None:
    """Uniform stress under tractions, held at points: exact to round-off, with the tie's force."""
    made = stacked(lower, upper, n, degrees)
    d = scenes.dimension(lower)
    made["conditions"] = strained(made)
    for corner in (np.zeros(d), *np.eye(d)[: d - 1], *([np.array([0, 0, 1.0])] if d == 3 else [])):
        where = " and ".join(f"abs({a} - {v}) < 1e-9" for a, v in zip("xyz", corner, strict=False))
        hold(made, "lower", where, uniform(corner[None])[0].tolist())
    solution = solve(made, split, tolerance=1e-12)
    points, u = solution.nodes.points, solution.nodes.displacement
    exact = uniform(points[:, :d])
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    assert solution.summary["certificate"]["passed"]
    stress = solution.cells.stress
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0], stress.shape), atol=1e-6)
    assert solution.accuracy.discretisation < 1e-6
    (tie,) = solution.summary["contacts"]
    component = {2: [3, 1], 3: [5, 4, 2]}[d]
    # the traction of the lower block on the upper one is -σ n, on an area of one
    np.testing.assert_allclose(tie["force"][:d], -stress[0][component], rtol=1e-6)
    assert tie["area"] == pytest.approx(1.0)
    size = np.linalg.norm(stress[0][component])
    assert [tie["max_pressure"], tie["max_smoothed_pressure"]] == pytest.approx([size] * 2)
    assert tie["nodes"]["open"] == tie["nodes"]["slip"] == 0
    assert tie["nodes"]["stick"] > 0


def beam(cell: str, degree: int, parts: list[list[int]]) -> scenes.Config:
    """A cantilever of length 4 cut into parts of so many cells, tied one to the next."""
    d, bodies = scenes.dimension(cell), []
    for k, cells in enumerate(parts):
        ends = (4.0 * k / len(parts), 4.0 * (k + 1) / len(parts))
        low, up = ([end, *[side] * (d - 1)] for end, side in zip(ends, (0.0, 1.0), strict=True))
        bodies.append(scenes.box(f"b{k}", up, cells, low, cell, poisson=0.0, degree=degree))
    conditions = [
        {"on": "b0.x-", "displacement": [0.0] * d},
        {"on": f"b{len(parts) - 1}.x+", "traction": [0.0] * (d - 1) + [-1.0]},
    ]
    ties = [{"on": f"b{k + 1}.x-", "against": f"b{k}.x+", "tied": True}
            for k in range(len(parts) - 1)]  # fmt: skip
    return scenes.config(cell, bodies, conditions, ties)


def energy(made: scenes.Config, split: int | None = None) -> float:
    solution = solve(made, split)
    assert solution.summary["certificate"]["passed"]
    return float(solution.summary["solution"]["energy"])


@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 1), ("hexahedron", 1)])
def test_matching_meshes_are_one_mesh(cell: str, degree: int) -> None:
    """Also in subdomains; the middle part carries no load of its own."""
    n = [2] * (scenes.dimension(cell) - 1)
    whole = energy(beam(cell, degree, [[12, *n]]))
    for split in (None, 6):
        assert energy(beam(cell, degree, [[4, *n]] * 3), split) == pytest.approx(whole, rel=1e-8)


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("cell", "whole", "parts", "method"),
    [("quadrilateral", [64, 16], [[32, 16], [28, 14]], "auto"),
     ("hexahedron", [24, 6, 6], [[12, 6, 6], [10, 5, 5]], "auto"),
     ("tetrahedron", [24, 12, 12], [[12, 12, 12], [11, 11, 11]], "primal")],
)  # fmt: skip
def test_a_tie_costs_little(
    cell: str, whole: list[int], parts: list[list[int]], method: str
) -> None:
    """At most 1.3 times the operator applications on the conforming mesh, by both methods."""
    counts, d = [], scenes.dimension(cell)
    for some, pieces in (([whole], 8), (parts, 4)):
        made = beam(cell, 1, some)
        axis = "xyz"[d - 1]
        floor = {"plane": {"point": [0.0] * (d - 1) + [-0.05], "normal": [0.0] * (d - 1) + [1.0]}}
        name = made["bodies"][-1]["name"]
        made["contacts"] = [*made.get("contacts", []), {"on": f"{name}.{axis}-", "obstacle": floor}]
        split = None if method == "primal" else [pieces] + [1] * (d - 1)
        solved = solve(made, split, method=method).summary
        assert solved["solution"]["active_contacts"] > 0
        assert solved["certificate"]["passed"]
        assert (solved["solver"]["method"] == "primal") == (method == "primal")
        counts.append(solved["solver"]["hessian_multiplications"])
    assert counts[1] <= 1.3 * counts[0]


@pytest.mark.ratchet
def test_contact_that_reaches_the_tie_costs_little() -> None:
    """Rows of obstacles at tied nodes are weighed with the tied rows: half as many applications."""
    counts = []
    for parts, split in (([[12, 6, 6]], [4, 2, 2]), ([[6, 6, 6], [5, 5, 5]], [2, 2, 2])):
        made = beam("hexahedron", 1, parts)
        name = made["bodies"][-1]["name"]
        made["bodies"][-1]["boundaries"] = {
            side: {"where": f"abs(z - {z}) < 1e-9 and x > 2 - 1e-9"}
            for side, z in (("floor", 0.0), ("top", 1.0))
        }
        made["conditions"][1] = {"on": f"{name}.top", "traction": [0.0, 0.0, -20.0]}
        floor = {"plane": {"point": [0.0, 0.0, -0.005], "normal": [0.0, 0.0, 1.0]}}
        made["contacts"] = [*made.get("contacts", []), {"on": f"{name}.floor", "obstacle": floor}]
        solved = solve(made, split)
        assert solved.summary["certificate"]["passed"]
        counts.append(solved.summary["solver"]["hessian_multiplications"])
    assert counts[1] <= 1.3 * counts[0]


@pytest.mark.parametrize("n", [(2, 2), (2, 3), (3, 2)])
@pytest.mark.parametrize("side", ["both", "on"])
def test_held_across_the_tie(n: tuple[int, int], side: str) -> None:
    """A side face that is held runs across the interface, on both bodies or on one of them."""
    cell = "hexahedron"
    made = stacked(cell, cell, n, (1, 1))
    held = ["upper", "lower"] if side == "both" else ["upper"]
    made["conditions"] = [{"on": f"{name}.x-", "displacement": [0.0, 0.0, 0.0]} for name in held]
    made["conditions"].append({"on": "upper.x+", "traction": [0.0, 1.0, -3.0]})
    found = solve(made, 4)
    assert found.summary["certificate"]["passed"]
    if side == "both" and n == (2, 2):
        block = scenes.block(cell, 2, upper=(1.0, 1.0, 2.0), young=YOUNG, poisson=POISSON)
        block["mesh"]["box"]["cells"] = [2, 2, 4]
        block["boundaries"] = {"loaded": {"where": "x > 1 - 1e-9 and z > 1 - 1e-9"}}
        one = scenes.config(cell, [block], [
            {"on": "block.x-", "displacement": [0.0, 0.0, 0.0]},
            {"on": "block.loaded", "traction": [0.0, 1.0, -3.0]},
        ], [])  # fmt: skip
        known = solve(one).summary["solution"]["energy"]
        assert found.summary["solution"]["energy"] == pytest.approx(known, rel=1e-8)
    # loads, reactions and nothing else are in balance
    reactions = np.sum([r["force"] for r in found.summary["reactions"]], axis=0)
    np.testing.assert_allclose(reactions, [0.0, -1.0, 3.0], atol=1e-6)


@pytest.mark.parametrize("cells", [(2, 2, 2, 2), (2, 3, 4, 5)])
def test_cross_point_of_four_blocks(cells: tuple[int, ...]) -> None:
    """Each tied to its neighbours: uniform strain is exact, also where meshes do not match."""
    cell = "quadrilateral"
    places = [(0, 0), (1, 0), (0, 1), (1, 1)]
    bodies = [
        scenes.block(cell, n, f"b{x}{z}", (x, 0, z), (x + 1, 1, z + 1), YOUNG, POISSON)
        for n, (x, z) in zip(cells, places, strict=True)
    ]
    ties = [("b00.x+", "b10.x-"), ("b00.y+", "b01.y-"), ("b10.y+", "b11.y-"), ("b01.x+", "b11.x-")]
    contacts = [{"on": a, "against": b, "tied": True} for a, b in ties]
    made = scenes.config(cell, bodies, [
        *({"on": f"{name}.x-", "displacement": [0.0, None]} for name in ("b00", "b01")),
        *({"on": f"{name}.y-", "displacement": [None, 0.0]} for name in ("b00", "b10")),
        {"on": "b01.y+", "pressure": 7.0}, {"on": "b11.y+", "pressure": 7.0},
    ], contacts)  # fmt: skip
    solution = solve(made, tolerance=1e-11)
    assert solution.summary["certificate"]["passed"]
    np.testing.assert_allclose(solution.cells.stress[:, 1], -7.0, rtol=1e-7)


@pytest.mark.parametrize("n", [(4, 4), (4, 6)])
@pytest.mark.parametrize("push", [7.0, -7.0])
def test_contact_next_to_a_tie(n: tuple[int, int], push: float) -> None:
    """The left half is tied, the right half may open; its edge node belongs to both."""
    cell = "quadrilateral"
    made = stacked(cell, cell, n, (1, 1))
    for body in made["bodies"]:
        height = "y > 1 - 1e-9" if body["name"] == "lower" else "y < 1 + 1e-9"
        body["boundaries"] = {"left": {"where": f"{height} and x < 0.5 + 1e-9"},
                              "right": {"where": f"{height} and x > 0.5 - 1e-9"}}  # fmt: skip
    made["contacts"] = [
        {"on": "upper.left", "against": "lower.left", "tied": True},
        {"on": "upper.right", "against": "lower.right"},
    ]
    made["conditions"] = [
        {"on": "lower.y-", "displacement": [None, 0.0]},
        {"on": "lower.x-", "displacement": [0, None]},
        {"on": "upper.y+", "pressure": push},
    ]  # fmt: skip
    solution = solve(made, 3)
    assert solution.summary["certificate"]["passed"]
    tie, contact = solution.summary["contacts"]
    assert tie["force"][1] + contact["force"][1] == pytest.approx(push, rel=1e-7)
    if push > 0.0:
        np.testing.assert_allclose(solution.cells.stress[:, 1], -push, rtol=1e-6)
    else:
        assert contact["force"][1] == 0.0
        assert contact["nodes"]["open"] > 0


def on_a_base(cells: tuple[int, ...], bodies: int) -> scenes.Config:
    """Blocks side by side, tied to one base that is as wide as they are and held below."""
    cell = "quadrilateral"
    base = scenes.box("base", [bodies, 0.0], [4 * bodies, 4], [0.0, -1.0], cell)
    blocks = [
        scenes.block(cell, n, f"b{k}", (k, 0, 0), (k + 1, 1, 1))
        for k, n in enumerate(cells[:bodies])
    ]
    ties = [{"on": f"b{k}.y-", "against": "base.y+", "tied": True} for k in range(bodies)]
    return scenes.config(cell, [base, *blocks], [scenes.clamp(cell, "base.y-")], ties)


@pytest.mark.parametrize("cells", [(4, 4), (5, 4), (4, 7)])
def test_interference_of_bodies_tied_at_a_corner(cells: tuple[int, int]) -> None:
    """Rows of several nodes decide the row at the corner; equal blocks mirror one beside a wall."""
    depth, whole = 0.01, on_a_base(cells, 2)
    whole["contacts"].append({"on": "b0.x+", "against": "b1.x-", "interference": depth})
    both = [solve(whole, method=method) for method in ("auto", "primal")]
    energies = [one.summary["solution"]["energy"] for one in both]
    assert all(one.summary["certificate"]["passed"] for one in both)
    assert energies[1] == pytest.approx(energies[0], rel=1e-7)
    if cells == (4, 4):
        half = on_a_base(cells, 1)
        half["conditions"].append({"on": "base.x+", "displacement": [0.0, None]})
        wall = scenes.plane("quadrilateral", (1, 0, 0), (-1, 0, 0))
        half["contacts"].append({"on": "b0.x+", "obstacle": wall, "interference": 0.5 * depth})
        alone = solve(half).summary
        assert alone["certificate"]["passed"]
        assert energies[0] == pytest.approx(2.0 * alone["solution"]["energy"], rel=1e-7)


def test_tied_rings_turn_freely(tmp_path: Path) -> None:
    """Facets of the two rings do not match, so there are gaps; no row sees a rotation of both."""
    made = rings.fit(tmp_path, "plane_stress")
    made["contacts"][0]["tied"] = True
    whole: dict[str, Any] = {**made, "bodies": [{
        **made["bodies"][0], "name": "ring",
        "mesh": {"file": rings.quarter(tmp_path / "whole.msh", rings.INNER, rings.OUTER, 16)},
    }], "contacts": []}  # fmt: skip
    whole["conditions"] = [
        {"on": "ring.y-", "displacement": [None, 0.0]},
        {"on": "ring.y+", "displacement": [0.0, None]},
        {"on": "ring.x-", "pressure": 10.0},
    ]
    made["conditions"].append({"on": "shaft.x-", "pressure": 10.0})
    assert energy(made, 4) == pytest.approx(energy(whole), rel=2e-3)
    # in quarters alone, turned about the middle of one, nothing stops the turn and nothing strains
    free = {**made, "conditions": [{"on": "shaft.p", "displacement": [0.0, 0.0]},
                                   {"on": "shaft.q", "displacement": [-1e-3, None]}]}  # fmt: skip
    free["bodies"][0]["boundaries"] = {
        "p": {"where": "y < 1e-6 and abs(x - 5) < 1e-6"},
        "q": {"where": "x < 1e-6 and abs(y - 5) < 1e-6"},
    }
    solution = solve(free, 3, tolerance=1e-10)
    points, u = solution.nodes.points, solution.nodes.displacement
    turn = 1e-3 / 5.0
    exact = np.stack([-turn * points[:, 1], turn * (points[:, 0] - 5.0)], axis=1)
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_a_gap_of_a_tie_is_reported_and_carries_moments() -> None:
    """Two blocks a gap apart, tied and pulled along: joined as by bars, in balance."""
    cell = "quadrilateral"
    made = stacked(cell, cell, (3, 4), (1, 1))
    box = made["bodies"][1]["mesh"]["box"]
    box["lower"], box["upper"] = [0, 1.1], [1, 2.1]
    made["conditions"] = [
        {"on": "lower.y-", "displacement": [0.0, 0.0]},
        {"on": "upper.y+", "traction": [1.0, 0.0]},
    ]
    solution = solve(made, 3)
    assert any("tied surfaces are up to 0.1 apart" in w
               for w in solution.summary["certificate"]["warnings"])  # fmt: skip
    (reaction,) = solution.summary["reactions"]
    assert reaction["force"][:2] == pytest.approx([-1.0, 0.0], abs=1e-6)
    assert reaction["moment"] == pytest.approx(2.1, rel=1e-6)


def test_a_tied_body_that_nothing_holds_leaves() -> None:
    made = stacked("quadrilateral", "triangle", (2, 3), (1, 1))
    made["conditions"] = [{"on": "lower.y-", "displacement": [None, 0.0]},
                          {"on": "upper.y+", "traction": [1.0, 0.0]}]  # fmt: skip
    with pytest.raises(NoEquilibriumError, match="nothing stops lower .* and upper from leaving"):
        solve(made)


def test_held_apart() -> None:
    made = stacked("quadrilateral", "quadrilateral", (3, 3), (1, 1))
    made["conditions"] = [{"on": "lower.y+", "displacement": [0.0, 0.0]},
                          {"on": "upper.y-", "displacement": [0.0, 0.1]}]  # fmt: skip
    with pytest.raises(NoEquilibriumError, match=r"contacts\[0\], which is tied, 0.1 apart"):
        solve(made)


FLOOR = {"plane": {"point": [0, 0], "normal": [0, 1]}}
REFUSED: list[tuple[scenes.Config, str]] = [
    ({"obstacle": FLOOR, "tied": True}, "is for two bodies"),
    ({"against": "lower.y+", "tied": True, "interference": 0.1}, "has no meaning in a tied"),
    ({"against": "lower.y+", "tied": "yes"}, "true or false is allowed"),
]


@pytest.mark.parametrize(("contact", "message"), REFUSED)
def test_located_errors(contact: scenes.Config, message: str) -> None:
    made = stacked("quadrilateral", "quadrilateral", (2, 2), (1, 1))
    made["contacts"] = [{"on": "upper.y-", **contact}]
    with pytest.raises(ConfigurationError, match=rf"contacts\[0\].*{message}"):
        build_scene(from_mapping(made))


def test_each_surface_is_made_once() -> None:
    """Rows of a tie and its tractions need both sides, the smoothed pressure that of a contact."""
    made = stacked("quadrilateral", "triangle", (3, 5), (1, 1))
    made["conditions"] = [{"on": "upper.y+", "traction": [0.1, -1.0]},
                          {"on": "lower.x-", "displacement": [0.0, None]}]  # fmt: skip
    floor = {"plane": {"point": [0, 0], "normal": [0, 1]}}
    made["contacts"].append({"on": "lower.y-", "obstacle": floor})
    answer = solve(made)
    assert answer.solution.certificate.passed
    made_once: Any = answer.model.geometry.boundary_surface
    assert made_once.cache_info().misses == 3
    assert made_once.cache_info().hits >= 2


@pytest.mark.mpi
def test_two_ranks(tmp_path: Path) -> None:
    made = stacked("hexahedron", "tetrahedron", (3, 2), (1, 2))
    made["conditions"] = [{"on": "lower.x-", "displacement": [0.0, 0.0, 0.0]},
                          {"on": "upper.x+", "traction": [0.0, 1.0, -3.0]}]  # fmt: skip
    one, two = one_and_two(made, tmp_path, 5)
    for key in ("energy", "max_displacement", "mean_displacement"):
        assert two["solution"][key] == pytest.approx(one["solution"][key], rel=1e-8), key
    assert two["contacts"][0]["force"] == pytest.approx(one["contacts"][0]["force"], rel=1e-6)
    smoothed = (found["contacts"][0]["max_smoothed_pressure"] for found in (two, one))
    assert next(smoothed) == pytest.approx(next(smoothed), rel=1e-6)
    assert two["contacts"][0]["moment"] == pytest.approx(one["contacts"][0]["moment"], rel=1e-6)
