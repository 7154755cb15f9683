"""Forces at nodes of several contacts: uniform pressures stay uniform across seams."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.boundary_integrals import integral, pressure_of
from tests.comparison import same_contacts, solve
from tests.rows import covering
from tests.scenes_on_ranks import one_and_two

PRESSURE = 10.0
CELLS = [(cell, degree) for cell in (*scenes.CELLS_2D, *scenes.CELLS_3D) for degree in (1, 2)]


def halves(cell: str, level: float = 0.0) -> dict[str, str]:
    """Expressions of the two halves of a level face, which share the nodes at x = 0.5."""
    up = "y" if scenes.dimension(cell) == 2 else "z"
    face = f"abs({up} - {level}) < 1e-9"
    return {"left": f"{face} and x < 0.5 + 1e-9", "right": f"{face} and x > 0.5 - 1e-9"}


def rollers(cell: str, body: str) -> list[scenes.Config]:
    """Conditions that leave a body its own width."""
    return scenes.rollers(cell, body=body, axes="xy"[: scenes.dimension(cell) - 1])


def on_floors(cell: str, degree: int, n: int = 4) -> scenes.Config:
    """A block pressed from above onto two level floors side by side, given in different ways."""
    if cell in scenes.CELLS_3D and degree == 2:
        n = 2
    body = {**scenes.block(cell, n, boundaries=halves(cell)), "degree": degree}
    return scenes.config(
        cell,
        [body],
        [{"on": f"block.{scenes.up(cell)}", "pressure": PRESSURE}, *rollers(cell, "block")],
        [{"on": "block.left", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1))},
         {"on": "block.right", "obstacle": scenes.plane(cell, (3, 1, 0), (0, 0, 2))}],
    )  # fmt: skip


def are_uniform(solved: Any, forces: list[float]) -> None:
    """Each contact of `solved` has the pressure of the load where it is closed, and its force."""
    up = solved.model.scene.dimension - 1
    for number, (record, force) in enumerate(zip(solved.summary["contacts"], forces, strict=True)):
        assert record["force"][up] == pytest.approx(force, rel=1e-6)
        contact = solved.nodes.contacts[number]
        pressed = contact.pressure[contact.closed]
        assert len(pressed)
        np.testing.assert_allclose(pressed, PRESSURE, rtol=1e-5)
    assert solved.summary["solution"]["max_contact_pressure"] == pytest.approx(PRESSURE, rel=1e-5)
    assert solved.summary["certificate"]["passed"]


@pytest.mark.parametrize(
    ("subdomains", "cell", "degree"),
    covering([1, 3], scenes.CELLS_2D + scenes.CELLS_3D, (1, 2), together=2),
)
def test_floors_side_by_side(cell: str, degree: int, subdomains: int) -> None:
    """A node of the seam belongs to both by their areas: neither doubled nor missing."""
    solved = solve(on_floors(cell, degree), subdomains, tolerance=1e-10)
    are_uniform(solved, [5.0, 5.0])
    d = solved.model.scene.dimension
    for number, sign in enumerate((1.0, -1.0)):

        def where(points: np.ndarray, sign: float = sign) -> np.ndarray:
            return (np.abs(points[..., d - 1]) < 1e-9) & (sign * (points[..., 0] - 0.5) < 1e-9)

        pressure = pressure_of(solved, number)
        assert (pressure[np.abs(solved.nodes.points[:, d - 1]) < 1e-9] > 0).any()
        assert integral(solved, where, pressure) == pytest.approx(5.0, rel=1e-6)
        assert solved.summary["contacts"][number]["nodes"]["open"] == 0
        assert solved.summary["contacts"][number]["area"] == pytest.approx(0.5)


def test_floors_that_are_nearly_level() -> None:
    """One is tilted by 1e-3 about the seam; a held body has one row for both there."""
    made = on_floors("quadrilateral", 1)
    made["contacts"][1]["obstacle"] = scenes.plane(
        "quadrilateral", (0.5, 0, 0), (1e-5, 0, 1)
    )  # fmt: skip
    made["conditions"].append({"on": "block.y+", "displacement": [None, -0.05]})
    solved = solve(made, 1)
    assert len(solved.model.left_out.nodes) == 1
    left, right = solved.nodes.contacts
    seam = [np.abs(solved.nodes.points[c.nodes, 0] - 0.5) < 1e-9 for c in (left, right)]
    pressures = left.pressure[seam[0]], right.pressure[seam[1]]
    assert pressures[0] == pytest.approx(pressures[1])
    assert left.pressure.max() < 1.05 * left.pressure.min()
    total = sum(c["force"][1] for c in solved.summary["contacts"])
    assert solved.summary["solution"]["contact_force"][1] == pytest.approx(total)


def test_a_floor_that_lies_deeper_takes_no_force() -> None:
    made = on_floors("quadrilateral", 1)
    made["contacts"][1]["obstacle"] = scenes.plane("quadrilateral", (0, 0, -1e-4), (0, 0, 1))
    solved = solve(made, 1)
    left, right = solved.nodes.contacts
    assert right.pressure[np.abs(solved.nodes.points[right.nodes, 0] - 0.5) < 1e-9] == 0.0
    assert solved.summary["contacts"][1]["nodes"] == {"open": 1, "stick": 0, "slip": 2}
    shares = np.array([0.125, 0.25, 0.125])
    assert shares @ np.sort(left.pressure) == pytest.approx(
        solved.summary["contacts"][0]["force"][1], rel=0.3
    )


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_boundary_given_twice(cell: str, degree: int) -> None:
    """The first one takes the force; it is not halved, nor counted twice."""
    made = on_floors(cell, degree)
    down = scenes.down(cell)
    for contact in made["contacts"]:
        contact["on"] = f"block.{down}"
    solved = solve(made, 2, tolerance=1e-10)
    first, second = solved.summary["contacts"]
    assert first["max_pressure"] == pytest.approx(PRESSURE, rel=1e-6)
    assert first["force"][-1 if cell == "tetrahedron" else 1] == pytest.approx(10, rel=1e-6)
    assert second["force"] == [0, 0, 0]
    assert second["nodes"]["slip"] == 0
    assert second["nodes"]["open"] == first["nodes"]["slip"]


def test_a_part_given_again_by_another_name() -> None:
    """A facet on both boundaries counts for the first, also at the end of the part."""
    for order in (1, -1):
        made = on_floors("quadrilateral", 1)
        made["contacts"][0]["on"] = "block.y-"
        made["contacts"] = made["contacts"][::order]
        solved = solve(made, 1, tolerance=1e-10)
        forces = [c["force"][1] for c in solved.summary["contacts"]]
        assert forces == pytest.approx([10, 0] if order == 1 else [5, 5], abs=1e-6)
        largest = solved.summary["solution"]["max_contact_pressure"]
        assert largest == pytest.approx(PRESSURE, rel=1e-6)


def on_bodies(cell: str, degree: int, n: tuple[int, int], what: str) -> scenes.Config:
    """A block on one below it or on two, the contact cut in two at x = 0.5 in several ways."""
    d, up, down = scenes.dimension(cell), scenes.up(cell), scenes.down(cell)
    upper = scenes.block(cell, n[1], "upper", lower=(0, 0, 1), upper=(1, 1, 2),
                         boundaries=halves(cell, 1.0))  # fmt: skip
    if what == "two bodies":
        below = [scenes.block(cell, n[0], "a", upper=(0.5, 1, 1)),
                 scenes.block(cell, n[0], "b", lower=(0.5, 0, 0))]  # fmt: skip
        contacts = [(f"upper.{down}", f"a.{up}"), (f"upper.{down}", f"b.{up}")]
    else:
        below = [scenes.block(cell, n[0], "a", boundaries=halves(cell, 1.0))]
        contacts = {
            "both": [("upper.left", "a.left"), ("upper.right", "a.right")],
            "on": [("upper.left", f"a.{up}"), ("upper.right", f"a.{up}")],
            "against": [(f"upper.{down}", "a.left"), (f"upper.{down}", "a.right")],
        }[what]
    conditions = [{"on": f"upper.{up}", "pressure": PRESSURE}, *rollers(cell, "upper")]
    for body in below:
        floor = {"on": f"{body['name']}.{down}", "displacement": [None] * (d - 1) + [0]}
        conditions += [floor, *rollers(cell, body["name"])]
    for body in (*below, upper):
        body["degree"] = degree
    return scenes.config(
        cell, [*below, upper], conditions, [{"on": a, "against": b} for a, b in contacts]
    )


@pytest.mark.parametrize(
    ("what", "n", "cell", "degree"),
    covering(
        ["both", "on", "against", "two bodies"],
        [(4, 4), (2, 4)],
        scenes.CELLS_2D + scenes.CELLS_3D,
        (1, 2),
        together=2,
    ),
)
def test_pairs_side_by_side(cell: str, degree: int, n: tuple[int, int], what: str) -> None:
    """Rows of both pairs at the nodes of the seam, equal or too many for their multipliers."""
    solved = solve(on_bodies(cell, degree, n, what), 1, tolerance=1e-10)
    are_uniform(solved, [5.0, 5.0])


@pytest.mark.mpi
@pytest.mark.parametrize("what", ["floors", "pairs"])
def test_two_ranks(what: str, tmp_path: Path) -> None:
    """The seam crosses subdomains of both ranks."""
    if what == "floors":
        made = on_floors("tetrahedron", 1)
    else:
        made = on_bodies("hexahedron", 1, (2, 4), "on")
    one, two = one_and_two(made, tmp_path, 5)
    same_contacts(two, one, 1e-6)
    for contact in two["contacts"]:
        assert contact["max_pressure"] == pytest.approx(PRESSURE, rel=1e-5)
        assert contact["nodes"] == {"open": 0, "stick": 0, "slip": 15}


def test_a_held_body_on_a_floor() -> None:
    """A floor and a body whose top is held level with it: their rows at the seam are equal."""
    cell = "quadrilateral"
    low = scenes.block(cell, 2, "low", lower=(0.5, 0, -1), upper=(1, 1, 0))
    upper = scenes.block(cell, 4, "upper", boundaries=halves(cell))
    made = scenes.config(
        cell,
        [low, upper],
        [{"on": "upper.y+", "pressure": PRESSURE}, *rollers(cell, "upper"),
         scenes.clamp(cell, "low.y-"), scenes.clamp(cell, "low.y+")],
        [{"on": "upper.left", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1))},
         {"on": "upper.right", "against": "low.y+"}],
    )  # fmt: skip
    are_uniform(solve(made, 1, tolerance=1e-10), [5.0, 5.0])


def test_forces_that_are_unique_stay() -> None:
    """A soft and a stiff body below: a jump of the pressure at the seam is no error to smooth."""
    made = on_bodies("quadrilateral", 1, (4, 6), "two bodies")
    made["bodies"][1]["material"]["young"] = 10.0
    solved = solve(made, 1, tolerance=1e-11)
    soft, stiff = solved.summary["contacts"][1], solved.summary["contacts"][0]
    assert stiff["force"][1] > 3 * soft["force"][1] > 0.0
    contact = solved.model.problem.contact
    given = solved.solution.multiplier[solved.model.problem.inequality] * contact.spread
    for number, record in enumerate(solved.summary["contacts"]):
        assert record["force"][1] == pytest.approx(given[contact.sources == number].sum())
        found = solved.nodes.contacts[number]
        at = np.searchsorted(found.nodes, contact.nodes[contact.sources == number])
        np.testing.assert_allclose(
            found.forces[at, 1], given[contact.sources == number], rtol=1e-6, atol=1e-9
        )
