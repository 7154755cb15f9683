"""Hertz's largest pressure on facets that are too coarse to show it."""

from typing import Any

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from contact_app.studies.peak_draws import KINDS, POISSON, YOUNG, half_scene, hertz_scene
from tests import scenes


def peaks_of_theory(made: dict[str, Any]) -> list[float]:
    """`max_smoothed_pressure` of contacts whose warning takes it from Hertz's theory."""
    found = solve_scene(scenes.build(made)).summary
    warnings = " ".join(found["certificate"]["warnings"])
    assert "facets" in warnings
    if "Hertz's theory gives max_smoothed_pressure" not in warnings:
        return []
    return [contact["max_smoothed_pressure"] for contact in found["contacts"]]


@pytest.mark.parametrize("facets", [1.0, 2.0])
@pytest.mark.parametrize("name", ["triangle 1", "quadrilateral 2", "hexahedron 1", "tetrahedron 1"])
def test_balls_and_rollers_have_the_peak_of_the_theory(name: str, facets: float) -> None:
    """Between nodes, and at the planes of symmetry of a half or quarter model."""
    kind = KINDS[name]
    place = [0.3 / kind.cells, -0.7 / kind.cells][: kind.dimension - 1]
    made, right = hertz_scene(kind, facets, place)
    assert peaks_of_theory(made) == pytest.approx([right], rel=0.01)
    made, right = half_scene(kind, facets)
    assert peaks_of_theory(made) == pytest.approx([right], rel=0.01)


@pytest.mark.parametrize(("tilt", "off"), [(0.0, 0.02), (0.3, 0.03)])
def test_a_roller_in_space_has_its_force_per_length(tilt: float, off: float) -> None:
    """p0² = q E*/(π R) for a roller along or across the lines of the mesh."""
    kind, radius, force = KINDS["hexahedron 1"], 2.0, 6.0
    made, _ = hertz_scene(kind, 1.0, [0.0, 0.0])
    axis = [float(np.cos(tilt)), float(np.sin(tilt)), 0.0]
    made["bodies"][1]["rigid"] = {
        "cylinder": {"point": [0, 0.02, radius], "axis": axis, "radius": radius}
    }
    made["conditions"][2]["total_force"] = [0, 0, -force]
    length = 2.0 / np.cos(tilt)
    right = np.sqrt(force / length * YOUNG / (1.0 - POISSON**2) / (np.pi * radius))
    assert peaks_of_theory(made) == pytest.approx([right], rel=off)


def test_a_flat_punch_has_no_peak_of_the_theory() -> None:
    """The gap of a plane has no curvature."""
    made, _ = hertz_scene(KINDS["hexahedron 1"], 1.0, [0.0, 0.0])
    made["bodies"][0]["boundaries"] = {
        "patch": {"where": "abs(x) < 0.1 and abs(y) < 0.1 and z > -1e-9"}
    }
    made["bodies"][1]["rigid"] = {"plane": {"point": [0, 0, 0], "normal": [0, 0, -1]}}
    made["contacts"][0]["on"] = "block.patch"
    assert peaks_of_theory(made) == []
