"""A wedge that friction locks: more friction lowers the forces that cause it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from meshes.samples.make_trials import write
from tests import meshfiles, scenes

MU, LOAD = 0.5, 400.0


def wedge(path: Path, slope: float) -> scenes.Config:
    """A wedge of triangles between two rigid flanks, pressed by its own upper edge."""

    def tapered(x: np.ndarray) -> np.ndarray:
        return np.column_stack([(2 * x[:, 0] - 1) * (4 + 10 * slope * x[:, 1]), 10 * x[:, 1]])

    edge = f"3.99 + {slope} * y"
    sides = {"right": f"x > {edge}", "left": f"-x > {edge}", "top": "y > 9.99"}
    contacts = [
        {
            "on": f"wedge.{name}",
            "obstacle": {"plane": {"point": [4 * side, 0], "normal": [-side, slope]}},
            "friction": {"coulomb": MU},
        }
        for name, side in (("right", 1), ("left", -1))
    ]
    material = {"young": 2e4, "poisson": 0.3}
    body = meshfiles.part(path, "triangle", (8, 10), tapered, sides, material=material)
    return {
        "dimension": "plane_strain",
        "bodies": [body],
        "conditions": [{"on": "wedge.top", "traction": [0, -LOAD / (8 + 20 * slope)]}],
        "contacts": contacts,
    }


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("method", "slope"), [("active-set", 0.1), ("primal", 0.1), ("primal", 0.03)]
)
def test_limits_that_push_a_wedge_out_are_relaxed(
    method: str, slope: float, tmp_path: Path
) -> None:
    """Limits of one set change those of the next by -μ over the slope, -5 and -17 here.

    Without relaxation all contact opens in the third set, and no answer is certified. Without
    springs along the slip multigrid takes 380 operator applications at the smaller slope. The wedge
    slides everywhere, so the normal force is P / 2 (sin α + μ cos α) on each flank.
    """
    made = {**wedge(tmp_path / "wedge.vtu", slope), "solver": {"method": method}}
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == method
    assert summary["solver"]["hessian_multiplications"] <= 60
    cosine, sine = np.array([1.0, slope]) / np.hypot(1.0, slope)
    normal = LOAD / 2 / (sine + MU * cosine)
    forces = np.array([contact["force"][:2] for contact in summary["contacts"]])
    across = normal * (cosine - MU * sine)
    assert forces == pytest.approx(np.array([[-across, LOAD / 2], [across, LOAD / 2]]), rel=1e-5)


def pushed_wedge(path: Path, mu: float, slope: float = 0.18) -> scenes.Config:
    """A wedge pushed in between a floor and a jaw by all nodes of its back."""
    soft = {"young": 1000, "poisson": 0.3}

    def body(name: str, cells: tuple[int, int], place: Any, sides: dict[str, str]) -> Any:
        def shape(x: np.ndarray) -> np.ndarray:
            return np.column_stack(place(x[:, 0], x[:, 1]))

        return meshfiles.part(path / name, "triangle", cells, shape, sides, material=soft)

    def skin(x: np.ndarray) -> np.ndarray:
        return 0.2 + slope * (x + 1)

    edge = f"{0.2 + slope} + {slope} * x"
    sides = {"up": f"y > {edge} - 1e-6", "lo": f"-y > {edge} - 1e-6", "back": "x > 0.999"}
    wedge = body(
        "wedge.vtu", (17, 5), lambda x, y: (2 * x - 1, (2 * y - 1) * skin(2 * x - 1)), sides
    )
    jaw = body(
        "jaw.vtu", (11, 7),
        lambda x, y: (1.4 * x - 0.8, (1 - y) * skin(1.4 * x - 0.8) + 1.2 * y),
        {"skin": f"y < {edge} + 1e-6", "top": "y > 1.199"},
    )  # fmt: skip
    floor = {"plane": {"point": [-1, -0.2], "normal": [slope, 1]}}
    return {
        "dimension": 2,
        "bodies": [wedge, jaw],
        "conditions": [
            {"on": "jaw.top", "displacement": [0, 0]},
            {"on": "wedge.back", "displacement": [-0.02, None]},
        ],
        "contacts": [
            {"on": "jaw.skin", "against": "wedge.up", "friction": {"coulomb": mu}},
            {"on": "wedge.lo", "obstacle": floor, "friction": {"coulomb": mu}},
        ],
        "solver": {"method": "active-set", "tolerance": 1e-8},
    }


@pytest.mark.ratchet
@pytest.mark.parametrize("mu", [0.05, 0.3])
def test_a_held_node_that_its_contact_leaves_no_room_cannot_stick(
    mu: float, tmp_path: Path
) -> None:
    """A corner is moved along x while the floor is inclined: normal and tangent leave it no room.

    If it may stick, its set has no solution: 390 to 2,227 operator applications, the last of them
    by multigrid. The force that drives the wedge is 2 N (sin α + μ cos α).
    """
    summary = solve_scene(scenes.build(pushed_wedge(tmp_path, mu), 2)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "active-set"
    assert summary["solver"]["hessian_multiplications"] <= 80
    pushed, up = -summary["reactions"][1]["force"][0], summary["contacts"][0]["force"][1]
    slope = 0.18
    assert pushed / up == pytest.approx(2 * (slope + mu) / (1 - mu * slope), rel=1e-5)


@pytest.mark.ratchet
def test_points_open_where_others_stick(tmp_path: Path) -> None:
    """A beam on rollers is no wedge: with points kept closed it took 118 operator applications."""
    path = write("beam_on_rollers", 2.6, tmp_path, friction=0.15)
    summary = solve_scene(build_scene(load(path, ["solver.method=primal"]))).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 90
