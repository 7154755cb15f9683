"""Heat: a body that expands freely has no stress, and a constrained one has that of the theory."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed
from contact_app.errors import ConfigurationError
from contact_app.model.outline import partition_scene
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from tests import meshfiles, reference, rings, scenes
from tests.comparison import same_displacement, solve
from tests.scenes_on_ranks import one_and_two, same_solution

YOUNG, POISSON, ALPHA, RISE = 1000.0, 0.3, 1e-4, 50.0
STRAIN = ALPHA * RISE


ELEMENTS = [
    (cell, degree, False) for cell in (*scenes.CELLS_2D, *scenes.CELLS_3D) for degree in (1, 2)
] + [("quadrilateral", 1, True), ("hexahedron", 1, True)]


def heated(
    cell: str, degree: int, mean: bool, file: Path | None = None, poisson: float = POISSON
) -> scenes.Config:
    """A warm block held at its planes through the origin; from a file its cells are distorted."""
    block = scenes.block(cell, 3, poisson=poisson)
    block["degree"], block["material"]["expansion"] = degree, ALPHA
    if mean:
        block["mean_dilatation"] = True
    if file is not None:
        block["mesh"] = {"file": str(meshfiles.write(meshfiles.block(cell, 2, 0.2), file))}
    warm = {"in": "block", "temperature": RISE}
    return scenes.config(cell, [block], [*scenes.rollers(cell), warm], [])


@pytest.mark.parametrize(("cell", "degree", "mean"), ELEMENTS)
@pytest.mark.parametrize("split", [1, 3])
def test_free_expansion(cell: str, degree: int, mean: bool, split: int, tmp_path: Path) -> None:
    """Without stress; in plane strain with the one across the plane, -E α T, alone."""
    made = heated(cell, degree, mean, tmp_path / "block.msh")
    solved = solve(made, split, tolerance=1e-10)
    points, u = solved.nodes.points, solved.nodes.displacement
    d = scenes.dimension(cell)
    strain = STRAIN if d == 3 else (1.0 + POISSON) * STRAIN
    np.testing.assert_allclose(u, strain * points[:, :d], rtol=0, atol=1e-9 * strain)
    expected = np.zeros(6)
    if d == 2:
        expected[2] = -YOUNG * STRAIN
    off = np.abs(solved.cells.stress - expected)
    assert off.max() < 1e-7 * YOUNG * STRAIN
    assert solved.summary["certificate"]["passed"]
    said = " ".join(solved.summary["certificate"]["warnings"])
    assert ("no stress but that across the plane" in said) == (d == 2)
    for reaction in solved.summary["reactions"]:
        assert np.abs(reaction["force"]).max() < 1e-7 * YOUNG * STRAIN


@pytest.mark.parametrize(
    ("cell", "degree", "mean", "thin"),
    [*((*element, False) for element in ELEMENTS), *((c, 1, False, True) for c in scenes.CELLS_2D)],
)
def test_between_two_walls(cell: str, degree: int, mean: bool, thin: bool) -> None:
    """Sides are free: the walls take E α ΔT, and E α ΔT (1 + ν)/(1 - ν²) in plane strain.

    In plane stress, for a thin body, nothing presses across the plane either.
    """
    made = heated(cell, degree, mean) | ({"dimension": "plane_stress"} if thin else {})
    del made["conditions"][0]
    made["contacts"] = [
        {"on": "block.x-", "obstacle": scenes.plane(cell, (0, 0, 0), (1, 0, 0))},
        {"on": "block.x+", "obstacle": scenes.plane(cell, (1, 0, 0), (-1, 0, 0))},
    ]
    solved = solve(made, 3)
    expected = YOUNG * STRAIN
    strained = scenes.dimension(cell) == 2 and not thin
    if strained:
        expected /= 1.0 - POISSON
    for contact, sign in zip(solved.summary["contacts"], (1, -1), strict=True):
        assert contact["force"][0] == pytest.approx(sign * expected, rel=1e-7)
    pressure = solved.nodes.contact_pressure
    assert pressure[pressure > 0.0] == pytest.approx(expected, rel=1e-6)
    stress = solved.cells.stress
    assert stress[:, 0] == pytest.approx(-expected, rel=1e-6)
    assert np.abs(stress[:, 1]).max() < 1e-6 * expected
    # both in the plane and across it: ν σ_x - E α T
    across = -POISSON * expected - YOUNG * STRAIN if strained else 0.0
    assert stress[:, 2] == pytest.approx(across, rel=1e-6, abs=1e-6 * expected)
    assert np.abs(stress[:, 3:]).max() < 1e-6 * expected
    assert solved.summary["certificate"]["passed"]


def test_nearly_incompressible_between_walls() -> None:
    made = heated("quadrilateral", 1, True, poisson=0.4999)
    made["conditions"].append({"on": "block.x+", "displacement": [0.0, None]})
    solved = solve(made, 2, tolerance=1e-10)
    expected = -YOUNG * STRAIN / (1.0 - 0.4999)
    assert solved.cells.stress[:, 0] == pytest.approx(expected, rel=1e-6)
    assert np.abs(solved.cells.stress[:, 1]).max() < 1e-5 * abs(expected)


SLOPE = [30.0, -20.0, 40.0]


@pytest.mark.parametrize("cell", [*scenes.CELLS_2D, *scenes.CELLS_3D])
def test_a_linear_temperature_bends_without_stress(cell: str) -> None:
    """A displacement quadratic in the place: degree 2 has it exactly, also on distorted cells.

    u_i = α (T x_i - ½ g_i |x|²) of T = g·x: its strain is α T I.
    """
    d = scenes.dimension(cell)
    block = scenes.block(cell, 2, boundaries={"corner": "x < 1e-9 and y < 1e-9 and z < 1e-9"})
    if d == 2:
        block["boundaries"]["corner"]["where"] = "x < 1e-9 and y < 1e-9"
    block["degree"], block["material"]["expansion"] = 2, ALPHA
    slope = np.array(SLOPE[:d])
    text = " + ".join(f"({g}) * {x}" for g, x in zip(slope, "xyz", strict=False))
    # held at three corners without a reaction: the exact displacement there
    conditions = [{"in": "block", "temperature": text}]
    corners = [np.zeros(d), *np.eye(d)]
    factor = 1.0 if d == 3 else 1.0 + POISSON

    def exact(x: np.ndarray) -> np.ndarray:
        total = x @ slope
        return factor * ALPHA * (total[:, None] * x - 0.5 * slope * (x**2).sum(axis=1)[:, None])

    for k, corner in enumerate(corners):
        where = " and ".join(f"abs({a} - {v}) < 1e-9" for a, v in zip("xyz", corner, strict=False))
        block["boundaries"][f"p{k}"] = {"where": where}
        conditions.append({"on": f"block.p{k}", "displacement": exact(corner[None])[0].tolist()})
    del block["boundaries"]["corner"]
    solved = solve(scenes.config(cell, [block], conditions, []), 2, tolerance=1e-11)
    points, u = solved.nodes.points, solved.nodes.displacement
    expected = exact(points[:, :d])
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    in_plane = np.delete(solved.cells.stress, 2, axis=1) if d == 2 else solved.cells.stress
    assert np.abs(in_plane).max() < 1e-6 * YOUNG * ALPHA * 50.0


@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 2), ("tetrahedron", 1)])
def test_the_undecomposed_answer(cell: str, degree: int) -> None:
    """Two temperatures add up, beside a load and an obstacle; against dolfinx on the whole mesh."""
    made = scenes.wall(cell, 3)
    made["bodies"][0]["degree"], made["bodies"][0]["material"]["expansion"] = degree, ALPHA
    made["conditions"] += [
        {"in": "block", "temperature": "20 * exp(-x) + 5 * sin(3 * y)"},
        {"in": "block", "temperature": 15},
    ]
    known = reference.solve(scenes.build(made))
    solved = solve(made, 4)
    same_displacement(known, solved)
    assert solved.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-8)
    assert known.active > 0


@pytest.mark.parametrize("plane", ["plane_stress", "plane_strain"])
@pytest.mark.parametrize("scene", ["shrink_fit", "interference_fit"])
def test_a_solid_shaft_in_a_hub(scene: str, plane: str) -> None:
    """p = E δ/(2 R) (1 - R²/Rₒ²), in plane strain over 1 - ν².

    δ is the radial interference: what is given, or what the hub shrinks by if it is free, which in
    plane strain is 1 + ν times as much.
    """
    solved = solve_scene(scenes.read(scene, [f"dimension={plane}"]))
    (material,) = solved.model.scene.bodies[0].materials
    exact = material.young * 0.01 / 20.0 * (1.0 - 0.25)
    if plane == "plane_strain":
        exact /= 1.0 - material.poisson**2
        exact *= 1.0 + material.poisson if scene == "shrink_fit" else 1.0
    (contact,) = solved.summary["contacts"]
    assert contact["force"][0] / 10.0 == pytest.approx(exact, rel=2e-3)  # on a quarter, R = 10
    assert solved.nodes.contact_pressure.max() == pytest.approx(exact, rel=1e-2)
    assert solved.summary["certificate"]["passed"]


def test_bimetal_strip(tmp_path: Path) -> None:
    """Timoshenko (1925): halves of a strip of thickness h bend it by 3 Δα T/(2 h)."""
    mesh = meshfiles.block("quadrilateral", 8, 0.0)
    mesh.points[:, 0], mesh.points[:, 1] = (
        0.5 * (mesh.points[:, 0] - 0.5), 20.0 * mesh.points[:, 1],
    )  # fmt: skip
    file = str(meshfiles.write(mesh, tmp_path / "strip.msh"))
    metal = {"young": YOUNG, "poisson": 0.0}
    made = {
        "dimension": "plane_stress",
        "bodies": [{
            "name": "strip", "degree": 2, "mesh": {"file": file},
            "material": {"soft": {**metal, "expansion": 3e-5},
                         "hard": {**metal, "expansion": 1e-5}},
        }],
        "conditions": [{"on": "strip.y-", "displacement": [None, 0.0]},
                       {"on": "strip.foot", "displacement": [0.0, None]},
                       {"in": "strip", "temperature": 100.0}],
        "solver": {"tolerance": 1e-10},
    }  # fmt: skip
    made["bodies"][0]["boundaries"] = {"foot": {"where": "y < 1e-9 and abs(x) < 1e-9"}}
    solved = solve_scene(scenes.build(made, 3))
    points, u = solved.nodes.points, solved.nodes.displacement
    tip = np.argmin(np.hypot(points[:, 0], points[:, 1] - 20.0))
    curvature = 2.0 * u[tip, 0] / 20.0**2
    assert curvature == pytest.approx(3.0 * 2e-5 * 100.0 / (2.0 * 0.5), rel=1e-3)


def test_contact_that_heat_alone_closes() -> None:
    """A wall that is touched by free expansion alone."""
    made = heated("quadrilateral", 1, False)
    made["contacts"] = [
        {"on": "block.x+", "obstacle": scenes.plane("quadrilateral", (1.004, 0, 0), (-1, 0, 0))}
    ]
    solved = solve(made)
    free = (1.0 + POISSON) * STRAIN
    expected = YOUNG / (1.0 - POISSON**2) * (free - 0.004)
    assert solved.summary["contacts"][0]["force"][0] == pytest.approx(-expected, rel=1e-6)
    assert solved.summary["decomposition"]["contact"] == 4


def test_symmetry_needs_a_temperature_that_mirrors() -> None:
    made = heated("quadrilateral", 1, False)
    made["bodies"][0]["mesh"]["box"]["cells"] = [4, 4]
    made["conditions"] = [
        {"on": "block.y-", "displacement": [None, 0.0]},
        {"in": "block", "temperature": "100 * x * (1 - x)"},
    ]
    whole = solve(made)
    half = solve_scene(halved(scenes.build(made)).scene)
    assert [m.axis for m in half.model.scene.mirrors] == [0]
    energy = whole.summary["solution"]["energy"]
    assert half.summary["solution"]["energy"] == pytest.approx(energy, rel=1e-7)
    made["conditions"][-1]["temperature"] = "100 * x"
    uneven = halved(scenes.build(made))
    assert not uneven.scene.mirrors
    assert any("temperature of conditions[1] is not its mirror image" in n for n in uneven.notes)


REFUSED = [
    ({"temperature": "x >"}, "is no expression"),
    ({"temperature": "x > 1"}, "is a condition, not a number"),
    ({"temperature": "sqroot(x)"}, "uses `sqroot"),
    ({"temperature": "z"}, "uses the name 'z'; allowed: x, y, pi"),
    ({"temperature": [1.0]}, r"is \[1.0\]; allowed: a number, or an expression"),
    ({"temperature": 1.0, "force": [0.0, 0.0]}, "exactly one of"),
]


@pytest.mark.parametrize(("condition", "message"), REFUSED)
def test_located_errors(condition: scenes.Config, message: str) -> None:
    made = heated("quadrilateral", 1, False)
    made["conditions"][-1] = {"in": "block", **condition}
    with pytest.raises(ConfigurationError, match=rf"conditions\[2\].*{message}"):
        build_scene(from_mapping(made))


def test_a_temperature_acts_in_a_body_that_expands() -> None:
    made = heated("quadrilateral", 1, False)
    made["conditions"][-1] = {"on": "block.x+", "temperature": 5.0}
    with pytest.raises(ConfigurationError, match="a temperature acts `in` a body"):
        build_scene(from_mapping(made))
    made = heated("quadrilateral", 1, False)
    del made["bodies"][0]["material"]["expansion"]
    with pytest.raises(ConfigurationError, match="no material of block has an `expansion`"):
        build_scene(from_mapping(made))
    made = heated("quadrilateral", 1, False)
    made["conditions"][-1]["temperature"] = "log(x)"
    with pytest.raises(ConfigurationError, match=r"`log\(x\)` has no finite value at \(0, "):
        solve(made)
    made["conditions"][-1]["temperature"] = 0
    with pytest.raises(ConfigurationError, match="load nothing"):
        build_scene(from_mapping(made))


def test_no_guaranteed_bound() -> None:
    made = heated("quadrilateral", 1, False)
    made["certificate"] = {"guaranteed": True}
    scene = scenes.build(made)
    with pytest.raises(ConfigurationError, match=r"guaranteed.*conditions\[2\] heats a body"):
        refuse_unguaranteed(scene, partition_scene(scene, MPI.COMM_SELF))


@pytest.mark.mpi
def test_two_ranks(tmp_path: Path) -> None:
    made = rings.fit(tmp_path, "plane_strain")
    for body in made["bodies"]:
        body["material"]["expansion"] = ALPHA
    made["conditions"].append({"in": "shaft", "temperature": "x * x + 20"})
    one, two = one_and_two(made, tmp_path, 4)
    same_solution(one, two, 1e-7)
    total = one["accuracy"]["total"]
    assert two["accuracy"]["total"] == pytest.approx(total, rel=1e-6)
