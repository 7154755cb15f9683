"""Two elastic bodies in contact: the contact patch test, and bodies held by other bodies alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import meshfiles, reference, scenes
from tests.comparison import same_displacement, solve
from tests.rows import covering

CONFIG = Path(__file__).parents[3] / "configs" / "roller_on_block.yaml"
YOUNG, POISSON, PRESSURE = 900.0, 0.25, 10.0


def stack(
    lower: str, upper: str, n: tuple[int, int], gap: float = 0.0, held: bool = True
) -> scenes.Config:
    """A block on a block, pressed from above; unless `held`, the upper one floats on the other."""
    d = scenes.dimension(lower)
    up, down = scenes.up(lower), scenes.down(lower)
    bodies = [
        scenes.block(lower, n[0], "lower", young=YOUNG, poisson=POISSON),
        scenes.block(
            upper, n[1], "upper", (0, 0, 1 + gap), (1, 1, 2 + gap), YOUNG, POISSON
        ),
    ]  # fmt: skip
    conditions: list[scenes.Config] = [
        {"on": f"lower.{down}", "displacement": scenes.vector(lower, None, None, 0.0)},
        {"on": f"upper.{up}", "pressure": PRESSURE},
    ]
    for body in ("lower", "upper")[: 1 + held]:
        for axis in range(d - 1):
            values = [0.0 if k == axis else None for k in range(d)]
            conditions.append({"on": f"{body}.{'xyz'[axis]}-", "displacement": values})
    contacts = [{"on": f"upper.{down}", "against": f"lower.{up}"}]
    return scenes.config(lower, bodies, conditions, contacts)


def patch_displacement(points: np.ndarray, d: int) -> np.ndarray:
    """Uniaxial stress along the last axis; plane strain in the plane."""
    side = POISSON * PRESSURE / YOUNG * (1.0 if d == 3 else 1.0 + POISSON)
    down = -PRESSURE / YOUNG * (1.0 if d == 3 else 1.0 - POISSON**2)
    return points[:, :d] * np.array([side] * (d - 1) + [down])


PAIRS = [
    ("quadrilateral", "triangle", (3, 5)),
    ("triangle", "triangle", (4, 3)),
    ("quadrilateral", "quadrilateral", (7, 2)),
    ("hexahedron", "tetrahedron", (2, 3)),
    ("tetrahedron", "hexahedron", (3, 2)),
    ("hexahedron", "hexahedron", (3, 4)),
    ("tetrahedron", "tetrahedron", (2, 3)),
]


@pytest.mark.parametrize(("lower", "upper", "n"), PAIRS)
@pytest.mark.parametrize(
    ("degrees", "split"), [((1, 1), 1), ((1, 1), 5), ((2, 2), 3), ((1, 2), 3), ((2, 1), 3)], ids=str
)
def test_contact_patch(
    lower: str, upper: str, n: tuple[int, int], degrees: tuple[int, int], split: int
) -> None:
    """Exact on meshes that do not match, whichever side has degree 2."""
    made = stack(lower, upper, n)
    made["bodies"] = [{**b, "degree": p} for b, p in zip(made["bodies"], degrees, strict=True)]
    solution = solve(made, split, tolerance=1e-12)
    points, u = solution.nodes.points, solution.nodes.displacement
    exact = patch_displacement(points, u.shape[1])
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    touching = np.isfinite(solution.nodes.gap)
    pressure = solution.nodes.contact_pressure[touching]
    np.testing.assert_allclose(pressure, PRESSURE, rtol=1e-8)
    assert touching.sum() == (degrees[1] * n[1] + 1) ** (u.shape[1] - 1)
    assert solution.summary["solution"]["contact_force"] == [0, 0, 0]
    (force,) = solution.summary["solution"]["pair_forces"].values()
    np.testing.assert_allclose(force[u.shape[1] - 1], PRESSURE, rtol=1e-9)


# The upper block, with cells of its own, reaches over the lower one or stands on part of it.
PLACES = {"larger": (-0.3, 1.35), "smaller": (0.33, 0.71), "overhanging": (0.33, 1.33)}


def placed(cell: str, n: tuple[int, int], place: str, swapped: bool, gap: float) -> scenes.Config:
    """A stack whose upper block has another width; `swapped`, its pressure lives below."""
    made = stack(cell, cell, n, gap=gap)
    box, d = made["bodies"][1]["mesh"]["box"], scenes.dimension(cell)
    for corner, value in zip(("lower", "upper"), PLACES[place], strict=True):
        box[corner] = [value] * (d - 1) + box[corner][d - 1 :]
    if swapped:
        (contact,) = made["contacts"]
        made["contacts"] = [{"on": contact["against"], "against": contact["on"]}]
    return made


CELLS_OF = {
    "quadrilateral": (3, 5), "triangle": (8, 5), "hexahedron": (2, 3), "tetrahedron": (3, 2),
}  # fmt: skip
"""Cells along an edge of the lower and of the upper block."""


@pytest.mark.parametrize(
    ("cell", "place", "swapped"), covering(CELLS_OF, PLACES, [False, True], together=2)
)
def test_against_the_reference(cell: str, place: str, swapped: bool) -> None:
    """The undecomposed problem with mortar rows of another making: energy, u, and pressure."""
    made = placed(cell, CELLS_OF[cell], place, swapped, gap=0.001)
    known = reference.solve(scenes.build(made))
    solution = solve(made, 3, tolerance=1e-10)
    assert solution.summary["certificate"]["passed"]
    assert solution.summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-8)
    same_displacement(known, solution)
    assert solution.summary["decomposition"]["contact"] == len(known.multiplier)
    force = solution.nodes.contact_pressure.sum()
    assert force > 0
    load = np.array(next(iter(solution.summary["solution"]["pair_forces"].values())))
    assert np.abs(load).sum() == pytest.approx(known.multiplier.sum(), rel=1e-7)


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_a_body_that_tips_over_the_edge_of_another(cell: str) -> None:
    made = stack(cell, cell, (3, 4), held=False)
    box, d = made["bodies"][1]["mesh"]["box"], scenes.dimension(cell)
    box["lower"], box["upper"] = [0.6] * (d - 1) + [1], [1.6] * (d - 1) + [2]
    with pytest.raises(NoEquilibriumError, match="nothing stops upper from leaving") as caught:
        solve(made)
    assert "a turn about" in str(caught.value)


def test_two_bodies_that_leave_together() -> None:
    """Pushed sideways, the upper block takes the lower one along, which slides on rollers."""
    made = stack("quadrilateral", "quadrilateral", (3, 4), held=False)
    made["conditions"] = [
        {"on": "lower.y-", "displacement": [None, 0.0]},
        {"on": "upper.y+", "pressure": PRESSURE},
    ]
    solution = solve(made)  # both slide freely, each is held once
    warnings = solution.summary["certificate"]["warnings"]
    (told,) = [w for w in warnings if "can move freely" in w]
    assert "lower can move freely" in told
    assert told.endswith("(and 1 more alike: upper)")
    made["conditions"].append({"on": "upper.x+", "traction": [1.0, 0.0]})
    with pytest.raises(NoEquilibriumError, match=r"upper from leaving along \+x"):
        solve(made)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"on": "upper.z-", "against": "lower.z-"}, "face the same way"),
    ({"on": "upper.x+", "against": "lower.z+"}, "never meet"),
    ({"on": "upper.z-", "against": "lower.spot"}, "against: no whole facet"),
    ({"on": "upper.spot", "against": "lower.z+"}, "on: no whole facet"),
]


@pytest.mark.parametrize(("contact", "message"), REFUSED)
def test_sides_that_cannot_touch(contact: dict[str, Any], message: str) -> None:
    made = stack("hexahedron", "hexahedron", (2, 3))
    for body in made["bodies"]:
        body["boundaries"] = {"spot": {"where": "abs(x) + abs(y) < 1e-9"}}
    made["contacts"] = [contact]
    with pytest.raises(ConfigurationError, match=r"contacts\[0\].*" + message):
        solve(made)


def test_a_pair_is_given_once() -> None:
    made = stack("hexahedron", "hexahedron", (2, 3))
    made["contacts"].append({"on": "lower.z+", "against": "upper.z-"})
    with pytest.raises(ConfigurationError, match=r"contacts\[1\] repeats contacts\[0\]"):
        solve(made)


def test_an_obstacle_has_one_law_of_friction() -> None:
    made = stack("hexahedron", "hexahedron", (2, 3))
    floor = {"on": "lower.z-", "obstacle": {"plane": {"point": [0, 0, -1], "normal": [0, 0, 1]}}}
    made["contacts"] += [floor, {**floor, "friction": {"coulomb": 0.3}}]
    message = r"contacts\[2\] repeats contacts\[1\] with other friction"
    with pytest.raises(ConfigurationError, match=message):
        solve(made)


def test_held_sides_of_both_bodies_that_overlap() -> None:
    made = stack("quadrilateral", "quadrilateral", (2, 3), gap=-0.01)
    made["conditions"] = [
        {"on": "lower.y+", "displacement": [0.0, 0.0]},
        {"on": "upper.y-", "displacement": [0.0, 0.0]},
    ]
    with pytest.raises(NoEquilibriumError, match="into the other body"):
        solve(made)


def test_many_bodies_in_a_tower() -> None:
    """Five floating slabs, each on the next, on a floor: every joint carries the same force."""
    bodies = [
        scenes.block("quadrilateral", n, f"slab{k}", (0, 0, k), (1, 1, k + 1))
        for k, n in enumerate((2, 3, 5, 4, 3))
    ]
    contacts: list[scenes.Config] = [
        {"on": f"slab{k + 1}.y-", "against": f"slab{k}.y+"} for k in range(4)
    ]
    contacts.append({"on": "slab0.y-", "obstacle": scenes.plane("quadrilateral", (0, 0, 0),
                                                                 (0, 0, 1))})  # fmt: skip
    load = {"on": "slab4.y+", "pressure": PRESSURE}
    solution = solve(scenes.config("quadrilateral", bodies, [load], contacts))
    touching = np.isfinite(solution.nodes.gap)
    np.testing.assert_allclose(solution.nodes.contact_pressure[touching], PRESSURE, rtol=1e-6)
    for force in solution.summary["solution"]["pair_forces"].values():
        np.testing.assert_allclose(force, [0, PRESSURE, 0], atol=1e-7)


def bulging(x: np.ndarray) -> np.ndarray:
    """Move the nodes of the unit block that are inside it: all inner edges are curved."""
    bubble = 0.8 * (x * (1 - x))[:, : 3 if np.ptp(x[:, 2]) > 0 else 2].prod(axis=1)
    return x + bubble[:, None] * np.cos(5 * np.roll(x, 1, axis=1)) * (np.ptp(x, axis=0) > 0)


@pytest.mark.parametrize(
    ("degrees", "cell"),
    covering([(1, 1), (2, 2), (1, 2), (2, 1), "curved"], (*scenes.CELLS_3D, *scenes.CELLS_2D)),
    ids=str,
)
def test_inclined_patch_of_distorted_meshes(
    cell: str, degrees: tuple[int, int] | str, tmp_path: Path
) -> None:
    """Two free blocks with inclined sides under pressure all round: the joint carries it, too.

    Facets of hexahedra are no parallelograms, and no mesh fits the other. `curved`: degree 2 on
    second-order meshes whose edges inside are curved.
    """
    d = scenes.dimension(cell)
    curved = degrees == "curved"
    orders = (2, 2) if isinstance(degrees, str) else degrees
    turn: scenes.Config = {"angle": 33.0}
    axis = np.array([2.0, 1.0, -1.0]) if d == 3 else np.array([0.0, 0.0, 1.0])
    if d == 3:
        turn["axis"] = axis.tolist()
    rotation = Rotation.from_rotvec(np.deg2rad(33) * axis / np.linalg.norm(axis))
    above = rotation.apply(np.eye(3)[d - 1])[:d]
    bodies, conditions = [], []
    for k, name in enumerate(("lower", "upper")):
        block = meshfiles.block(cell, 2 + 2 * k, seed=k)
        if curved:
            block = meshfiles.second_order(block, cell, meshfiles.SECOND[cell][0], bulging)
        file = meshfiles.write(block, tmp_path / f"{name}.msh")
        mesh = {"file": str(file), "rotate": turn, "translate": (k * above).tolist()}
        material = {"young": YOUNG, "poisson": POISSON}
        body = {"name": name, "mesh": mesh, "material": material, "degree": orders[k]}
        bodies.append(body)
        sides = [axis + end for axis in "xyz"[:d] for end in "-+"]
        sides.remove(scenes.down(cell) if k else scenes.up(cell))
        conditions += [{"on": f"{name}.{side}", "pressure": PRESSURE} for side in sides]
    contacts = [{"on": f"upper.{scenes.down(cell)}", "against": f"lower.{scenes.up(cell)}"}]
    made = scenes.config(cell, bodies, conditions, contacts)
    for split in (2, 7) if degrees == (1, 1) else (5,):
        solution = solve(made, split, tolerance=1e-12)
        some = [s.reference.curved for s in solution.model.partition.subdomains]
        assert any(some) == curved
        touching = np.isfinite(solution.nodes.gap)
        pressure = solution.nodes.contact_pressure[touching]
        np.testing.assert_allclose(pressure, PRESSURE, rtol=1e-9)
        force = next(iter(solution.summary["solution"]["pair_forces"].values()))
        np.testing.assert_allclose(force[:d], PRESSURE * above, atol=1e-9 * PRESSURE)
        assert np.abs(solution.cells.von_mises).max() < 1e-8 * PRESSURE or d == 2


@pytest.mark.parametrize(("shift", "warned"), [(0.1, False), (0.4, True)])
def test_sliding_over_more_than_a_facet_causes_a_warning(shift: float, warned: bool) -> None:
    """The upper block (facets of 1/3) is pushed along the lower one, which holds still."""
    made = stack("hexahedron", "hexahedron", (2, 3), held=False)
    made["conditions"] = [
        scenes.clamp("hexahedron", "lower.z-"),
        {"on": "upper.z+", "displacement": [shift, 0.0, -0.001]},
    ]
    warnings = solve(made, 5).summary["certificate"]["warnings"]
    assert any("slide along each other by up to 0.4" in w for w in warnings) == warned


@pytest.mark.parametrize(("y", "top"), [(0.0, 0.1), (0.2, 0.3)])
def test_bodies_clamped_at_a_common_edge_have_no_force_there(y: float, top: float) -> None:
    """Meshes that differ by 1e-4 leave a row at the clamp whose free part is its square."""

    def forces(stretch: float) -> tuple[float, float]:
        sides = (("lower", y, 1.0), ("upper", top, 1.0 + stretch))
        made = {
            "dimension": 2,
            "bodies": [
                scenes.box(name, [x, b + 0.1], [10, 2], [0.0, b]) for name, b, x in sides
            ],
            "conditions": [
                {"on": "lower.x-", "displacement": [0.0, 0.0]},
                {"on": "upper.x-", "displacement": [0.0, 0.0]},
                {"on": "upper.y+", "traction": [0.0, -1.0]},
            ],
            "contacts": [{"on": "upper.y-", "against": "lower.y+"}],
        }  # fmt: skip
        summary = solve_scene(scenes.build(made)).summary
        assert summary["certificate"]["passed"]
        contact = summary["contacts"][0]
        return contact["force"][1], contact["max_pressure"]

    np.testing.assert_allclose(forces(1e-4), forces(0.0), rtol=1e-3)


def test_a_fine_body_stands_on_a_coarse_one_that_is_held() -> None:
    """Rows of two nodes spread over hundreds of free nodes, each with a small coefficient."""
    made = {
        "dimension": 2,
        "bodies": [
            scenes.box("base", [1, 0], [1, 1], [0, -1]),
            scenes.box("body", [1, 0.02], [400, 4]),
        ],
        "conditions": [
            {"on": "base.y-", "displacement": [0, 0]},
            {"on": "base.y+", "displacement": [0, 0]},
            {"on": "body.x-", "displacement": [0, None]},
            {"on": "body.y+", "traction": [0, -1]},
        ],
        "contacts": [{"on": "base.y+", "against": "body.y-"}],
    }  # fmt: skip
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    assert summary["contacts"][0]["force"][1] == pytest.approx(-1.0)
