"""Largest pressures at sharp edges: where they are infinite in theory, and where they are not."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.sharp_edges import sharp_edge, sharp_peak, skin_near
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping, load
from tests import meshfiles
from tests.scenes import CONFIGS

SIDES = ((0, "y+"), (1, "y-"))

STEEL = {"young": 1000.0, "poisson": 0.3}


def blocks(times: int, base: tuple[float, float] = (-8.0, 8.0), young: float = 1000.0) -> Any:
    """A block 4 wide on another one, half as fine."""
    wide = base[1] - base[0]
    boxes = {
        "base": {"lower": [base[0], -8], "upper": [base[1], 0],
                 "cells": [round(2 * wide) * times, 16 * times], "cell": "quadrilateral"},
        "punch": {"lower": [-2, 0], "upper": [2, 6], "cells": [10 * times, 15 * times],
                  "cell": "quadrilateral"},
    }  # fmt: skip
    bodies: list[dict[str, Any]] = [
        {"name": name, "mesh": {"box": box}, "material": dict(STEEL)} for name, box in boxes.items()
    ]
    bodies[1]["material"]["young"] = young
    bodies[1]["hold"] = ["x"]
    return {
        "title": "a block on another one", "dimension": "plane_strain", "bodies": bodies,
        "conditions": [
            {"on": "base.y-", "displacement": [0, 0]}, {"on": "punch.y+", "pressure": 10},
        ],
        "contacts": [{"on": "punch.y-", "against": "base.y+"}],
    }  # fmt: skip


def peak(made: Any) -> tuple[float, list[str]]:
    """The largest pressure, and the warnings of sharp edges."""
    solved = solve_scene(build_scene(from_mapping(made)), MPI.COMM_SELF)
    warnings = solved.summary["certificate"]["warnings"]
    (contact,) = solved.summary["contacts"]
    return contact["max_pressure"], [w for w in warnings if "grows without limit" in w]


def test_an_edge_on_a_wider_block_causes_a_warning_and_its_pressure_grows_as_in_theory() -> None:
    """Dundurs and Lee: r^(λ - 1) with λ = 0.7735 for a right angle and equal materials."""
    found = [peak(blocks(times)) for times in (1, 2, 4)]
    for pressure, warnings in found:
        assert f"the largest pressure, {pressure:.3g} at (" in warnings[0]
        assert "at a sharp edge of punch" in warnings[0]
    rates = np.diff(np.log2([pressure for pressure, _ in found]))
    assert rates == pytest.approx(1.0 - 0.7735, abs=0.006)


def test_the_edge_causes_a_warning_from_the_other_side_of_the_contact() -> None:
    made = blocks(1)
    made["contacts"] = [{"on": "base.y+", "against": "punch.y-"}]
    assert "at a sharp edge of punch" in peak(made)[1][0]


def test_an_end_of_the_other_body_a_coarse_facet_away_is_no_common_end() -> None:
    """The base ends one facet beyond the edge of the punch; the peak lies between the two."""
    made = blocks(1, base=(-4.0, 4.0))
    made["bodies"][0]["mesh"]["box"]["cells"] = [4, 8]
    made["contacts"] = [{"on": "base.y+", "against": "punch.y-"}]
    solved = solve_scene(build_scene(from_mapping(made)), MPI.COMM_SELF)
    sides = [
        skin_near(solved.model, body, name, np.array([3.0, 0, 0]), 9.0) for body, name in SIDES
    ]
    assert sharp_edge(np.array([2.5, 0.0, 0.0]), sides, "").startswith("at a sharp edge of punch")


def test_the_edge_at_the_node_counts_though_the_other_body_ends_a_facet_away() -> None:
    warnings = peak(blocks(1, base=(-2.4, 2.4)))[1]
    assert "at a sharp edge of punch: it grows" in warnings[0]


def test_an_edge_at_a_clamped_side_causes_a_warning_and_one_at_a_plane_of_symmetry_does_not() -> (
    None
):
    for values, warned in (([0, -0.01], True), ([0, None], False)):
        made = blocks(1)
        del made["bodies"][1]["hold"]
        made["bodies"][1]["mesh"]["box"]["lower"] = [0, 0]
        made["conditions"][1] = {"on": "punch.x-", "displacement": values}
        made["conditions"] += [] if warned else [{"in": "punch", "force": [0, -1]}]
        solved = solve_scene(build_scene(from_mapping(made)), MPI.COMM_SELF)
        nodes = solved.nodes
        assert nodes.points[np.argmax(nodes.contact_pressure)] == pytest.approx([0, 0, 0])
        warnings = solved.summary["certificate"]["warnings"]
        assert any("at a sharp edge of punch" in w for w in warnings) == warned


def test_blocks_that_end_together_and_soft_blocks_have_no_infinite_pressure() -> None:
    assert peak(blocks(1, base=(-2.0, 2.0)))[1] == []
    assert peak(blocks(1, young=50.0))[1] == []


def test_a_peak_one_facet_from_the_common_end_of_two_blocks_is_at_no_edge() -> None:
    for base, expected in (((-2.0, 2.0), ""), ((-8.0, 8.0), "at a sharp edge of punch")):
        solved = solve_scene(build_scene(from_mapping(blocks(1, base=base))), MPI.COMM_SELF)
        point = np.array([1.6, 0.0, 0.0])
        sides = [skin_near(solved.model, body, name, point, 2.0) for body, name in SIDES]
        assert sharp_edge(point, sides[::-1], "") == ""
        edge = sharp_edge(point, sides, "")
        assert edge == expected + " (the side of punch as `on` resolves it better)" * bool(expected)


@pytest.mark.parametrize(("slope", "warned"), [(1.0, True), (0.0, False)])
def test_an_edge_on_an_obstacle_causes_a_warning_if_its_angle_is_larger_than_a_right_angle(
    slope: float, warned: bool, tmp_path: Path
) -> None:
    """A foot from -1 to 1, pressed on its right, whose sides lean outwards or are upright."""

    def leaning(x: np.ndarray) -> np.ndarray:
        return np.column_stack([(2.0 * x[:, 0] - 1.0) * (1.0 + slope * x[:, 1]), x[:, 1]])

    sides = {"heel": "y > 1 - 1e-9 and x > 0.3", "sole": "y < 1e-9"}
    file = tmp_path / "foot.vtu"
    body = meshfiles.part(file, "quadrilateral", (12, 6), leaning, sides, material=STEEL)
    made = {
        "title": "a foot", "dimension": "plane_strain", "bodies": [body],
        "conditions": [{"on": "foot.heel", "displacement": [0, -0.01]}],
        "contacts": [
            {"on": "foot.sole", "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}}
        ],
    }  # fmt: skip
    solved = solve_scene(build_scene(from_mapping(made)), MPI.COMM_SELF)
    nodes = solved.nodes
    assert nodes.points[np.argmax(nodes.contact_pressure)] == pytest.approx([1, 0, 0], abs=1e-9)
    warnings = [w for w in solved.summary["certificate"]["warnings"] if "without limit" in w]
    assert [("at a sharp edge of foot" in w) for w in warnings] == [True] * warned


def test_a_smoothed_peak_at_an_edge_causes_a_warning_where_the_largest_node_is_elsewhere() -> None:
    """Single nodes press most inside, the means over facets at the edge."""
    points, shares = np.array([[0.0, 0.0, 0.0], [1.0, 1e-17, 0.0]]), np.ones(2)
    inside, outside = np.array([3.0, 2.0]), np.array([1.5, 2.5])

    def edge_at(point: np.ndarray, reach: float) -> str:
        return "at a sharp edge of hub" if point[0] == 1.0 and reach > 0.0 else ""

    def warning(pressure: np.ndarray, smoothed: np.ndarray) -> str:
        return sharp_peak(MPI.COMM_SELF, 2, (pressure, smoothed), (points, shares), edge_at)

    assert warning(inside, outside).startswith("the largest smoothed pressure, 2.5 at (1, 0), is a")
    assert warning(outside, inside).startswith("the largest pressure, 2.5 at (1, 0), is at a sharp")
    assert warning(inside, inside) == ""


def test_a_punch_ends_in_the_middle_of_a_surface() -> None:
    made = load(CONFIGS / "flat_punch.yaml", ["bodies.0.mesh.box.cells=[32,32]"])
    solved = solve_scene(build_scene(made), MPI.COMM_SELF)
    assert any("at (1, 0), is at the end of punched" in w
               for w in solved.summary["certificate"]["warnings"])  # fmt: skip


@pytest.mark.parametrize("name", ["roller_on_block", "hertz_disc", "rigid_ball", "shrink_fit"])
def test_round_contacts_through_planes_of_symmetry_cause_no_warning(name: str) -> None:
    made = load(CONFIGS / f"{name}.yaml")
    solved = solve_scene(build_scene(made), MPI.COMM_SELF)
    assert not any("without limit" in w for w in solved.summary["certificate"]["warnings"])


@pytest.mark.parametrize("sides", [("upper.z-", "lower.z+"), ("lower.z+", "upper.z-")])
def test_edges_that_cross_cause_a_warning_and_those_that_end_together_do_not(
    sides: tuple[str, str],
) -> None:
    """A bar across another one of the same width, and along it."""
    for along, across in ((1, 3), (3, 1)):
        boxes = {
            "lower": {"lower": [-3, -1, -2], "upper": [3, 1, 0], "cells": [12, 4, 4]},
            "upper": {"lower": [-along, -across, 0], "upper": [along, across, 2],
                      "cells": [4 * along, 4 * across, 4]},
        }  # fmt: skip
        made = {
            "dimension": 3,
            "bodies": [
                {"name": n, "mesh": {"box": b}, "material": dict(STEEL)} for n, b in boxes.items()
            ],
            "conditions": [
                {"on": "lower.z-", "displacement": [0, 0, 0]},
                {"on": "upper.z+", "displacement": [0, 0, -0.01]},
            ],
            "contacts": [{"on": sides[0], "against": sides[1]}],
        }
        assert bool(peak(made)[1]) == (across == 3)
