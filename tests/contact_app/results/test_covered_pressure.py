"""Pressure of two bodies on facets that the other body covers in part.

A block on a wider plate has the pressure field on its own side or on that of the plate, whose
facets go on beyond the edge of the block. Forces, energies and largest pressures of both agree.
"""

import numpy as np
import pytest

from tests import scenes
from tests.comparison import solve

CELLS = {"quadrilateral": 8, "triangle": 8, "hexahedron": 7, "tetrahedron": 7}
"""Cells along an edge of the plate."""


def block_on_plate(
    cell: str, n: int, m: int, covered: float, on: str, degree: int = 1, **contact: object
) -> scenes.Config:
    """A block of width n - 5 + 2 · covered facets of the plate, with m cells along its edge."""
    d = scenes.dimension(cell)
    lower, upper = (3 - covered) / n, (n - 3 + covered) / n
    axis = "xyz"[d - 1]
    sides = {"on": f"plate.{axis}+", "against": f"block.{axis}-"}
    if on == "block":
        sides = {"on": sides["against"], "against": sides["on"]}
    across = [0.0] * (d - 1)
    boxes = {
        "plate": ([*across, 0.0], [*[1.0] * (d - 1), 0.3], [*[n] * (d - 1), 2]),
        "block": ([*[lower] * (d - 1), 0.3], [*[upper] * (d - 1), 0.6], [m] * d),
    }
    return {
        "dimension": d,
        "bodies": [
            scenes.box(name, up, cells, low, cell, young=2e5, degree=degree)
            for name, (low, up, cells) in boxes.items()
        ],
        "conditions": [
            {"on": f"plate.{axis}-", "displacement": [*across, 0.0]},
            {"on": f"block.{axis}+", "displacement": [*across, None]},
            {"on": f"block.{axis}+", "traction": [*across, -100.0]},
        ],
        "contacts": [{**sides, **contact}],
    }  # fmt: skip


@pytest.mark.parametrize(("cell", "degree"), [*((cell, 1) for cell in CELLS), ("triangle", 2)])
@pytest.mark.parametrize("covered", [0.24, 0.35, 0.8])
def test_sides_may_be_exchanged(cell: str, degree: int, covered: float) -> None:
    records, energies = [], []
    for on in ("plate", "block"):
        made = block_on_plate(cell, CELLS[cell], 4, covered, on, degree)
        solution = solve(made, tolerance=1e-8)
        assert solution.summary["certificate"]["passed"]
        records.append(solution.summary["contacts"][0])
        energies.append(solution.summary["solution"]["energy"])
    plate, block = records
    assert energies[0] == pytest.approx(energies[1], rel=1.5e-2)
    np.testing.assert_allclose(plate["force"], -np.array(block["force"]), rtol=0, atol=1e-4)
    assert plate["area"] == pytest.approx(block["area"], rel=1e-6)
    limit = 2.5 if degree == 2 else 1.4
    for key in ("max_pressure", "max_smoothed_pressure"):
        assert block[key] / 1.7 < plate[key] < limit * block[key]


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("covered", [0.24, 0.35])
def test_sides_may_be_exchanged_where_no_facet_of_degree_2_is_covered_completely(
    cell: str, covered: float
) -> None:
    """Integrals of the functions of corners over a narrow strip are negative."""
    m = 3 if cell == "tetrahedron" else 4
    plate, block = (
        solve(block_on_plate(cell, 6, m, covered, on, 2)).summary["contacts"][0]
        for on in ("plate", "block")
    )
    for key in ("max_pressure", "max_smoothed_pressure"):
        assert block[key] / 2.0 < plate[key] < 1.3 * block[key]


@pytest.mark.parametrize(
    ("cell", "n", "lower", "size"),
    [
        ("tetrahedron", 7, (2.4, 2.4), (2.2, 2.2)),  # weak nodes with weak neighbours alone
        ("tetrahedron", 5, (3.11, 2.72), (1.24, 1.6)),  # the edge of the plate is near
        ("hexahedron", 5, (0.62, 1.22), (1.06, 1.44)),
    ],
)
def test_corners_of_a_block_amid_facets_of_degree_2(
    cell: str, n: int, lower: tuple[float, float], size: tuple[float, float]
) -> None:
    records = []
    for on in ("plate", "block"):
        made = block_on_plate(cell, n, 4, 0.5, on, 2)
        box = made["bodies"][1]["mesh"]["box"]
        for axis in (0, 1):
            box["lower"][axis] = lower[axis] / n
            box["upper"][axis] = (lower[axis] + size[axis]) / n
        records.append(solve(made).summary["contacts"][0])
    plate, block = records
    for key in ("max_pressure", "max_smoothed_pressure"):
        assert block[key] / 1.6 < plate[key] < 1.3 * block[key]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_aligned_meshes_have_one_pressure_on_both_sides(cell: str, degree: int) -> None:
    """The edges of the block lie on those of facets; the plate has nodes beyond them."""
    plate, block = (
        solve(block_on_plate(cell, 7, 3, 1.0, on, degree), tolerance=1e-8).summary["contacts"][0]
        for on in ("plate", "block")
    )
    for key in ("max_pressure", "max_smoothed_pressure", "area"):
        assert plate[key] == pytest.approx(block[key], rel=1e-5)


@pytest.mark.parametrize(
    ("cell", "m", "covered"),
    [
        ("triangle", 4, 0.24),
        ("hexahedron", 4, 0.35),
        # facets of the block are longer: over narrow strips tractions were up to 19 times too large
        ("triangle", 2, 0.15),
        ("quadrilateral", 2, 0.2),
        ("hexahedron", 2, 0.2),
        ("tetrahedron", 2, 0.2),
    ],
)
def test_sides_of_a_tie_may_be_exchanged(cell: str, m: int, covered: float) -> None:
    plate, block = (
        solve(block_on_plate(cell, CELLS[cell], m, covered, on, tied=True), tolerance=1e-8)
        for on in ("plate", "block")
    )
    records = [s.summary["contacts"][0] for s in (plate, block)]
    energies = [s.summary["solution"]["energy"] for s in (plate, block)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-2 if m == 4 else 5e-2)
    for key in ("max_pressure", "max_smoothed_pressure"):
        assert 0.55 < records[0][key] / records[1][key] < 2.0


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_means_have_the_force_of_the_contact(cell: str) -> None:
    """Nodes next to the edge divide the forces of rows; friction keeps its limit."""
    n, mu = CELLS[cell], 0.3
    made = block_on_plate(cell, n, 4, 0.6, "plate", friction={"coulomb": mu})
    made["conditions"] = [c for c in made["conditions"] if None not in c.get("displacement", [])]
    (load,) = (c for c in made["conditions"] if "traction" in c)
    load["traction"][0] = 20.0
    nodes = solve(made, tolerance=1e-8).nodes.contacts[0]
    closed = nodes.closed
    limit = mu * nodes.pressure
    assert (np.linalg.norm(nodes.traction, axis=1) <= limit * (1 + 1e-6) + 1e-9).all()
    assert (nodes.pressure[closed] > 0.0).all()
    assert not nodes.pressure[~closed].any()
    extrapolated = np.linalg.norm(nodes.forces[closed], axis=1) / nodes.areas[closed]
    assert nodes.pressure.max() < 0.8 * extrapolated.max()
