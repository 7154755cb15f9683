"""Ties, heat, interference and a rigid body in one scene: one answer by every method and
decomposition.

Two tied blocks whose meshes do not match stand on a foot; the upper one is warmer to the right and
meets a wall with interference, and a force presses a rigid plate on its top.
"""

from pathlib import Path

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from tests import scenes
from tests.scenes import Config
from tests.scenes_on_ranks import summary_of

CELLS = ["quadrilateral", "triangle", "hexahedron", "tetrahedron"]


def together(cell: str, degree: int, length: float = 1.0, pressure: float = 1.0) -> Config:
    """Lengths and pressures are multiplied by the factors: the same scene in other units."""
    d = scenes.dimension(cell)
    material = {"young": 200.0 * pressure, "poisson": 0.3, "expansion": 1e-3}

    def block(name: str, bottom: float, top: float, cells: list[int], own: int) -> Config:
        lower, upper = [0.0, 0.0, 0.0][-d:], [1.0, 1.0, 0.0][-d:]
        lower[-1], upper[-1], upper[0] = bottom, top, 1.0
        low, up = ([length * x for x in corner] for corner in (lower, upper))
        body = scenes.box(name, up, cells[-d:], low, cell, degree=own)
        return {**body, "material": dict(material)}

    plate = {"plane": {"point": scenes.vector(cell, 0.5 * length, 0.5 * length, 1.5 * length),
                       "normal": scenes.vector(cell, 0.0, 0.0, -1.0)}}  # fmt: skip
    wall = {"plane": {"point": scenes.vector(cell, length, 0.0, 0.0),
                      "normal": scenes.vector(cell, -1.0, 0.0, 0.0)}}  # fmt: skip
    down, up = scenes.down(cell), scenes.up(cell)
    force = scenes.vector(cell, 0.0, 0.0, -0.5 * pressure * length ** (d - 1))
    free = [0.0] * (d - 1) + [None]
    return {
        "dimension": d,
        "bodies": [
            block("foot", 0.0, 1.0, [2, 2, 2], degree),
            block("head", 1.0, 1.5, [3, 3, 2], degree),
            {"name": "plate", "rigid": plate},
        ],
        "conditions": [
            {"on": f"foot.{down}", "displacement": [0.0] * d},
            {"in": "head", "temperature": f"2 + x/{length!r}"},
            {"in": "plate", "displacement": free, "rotation": 0.0 if d == 2 else [0.0] * 3},
            {"in": "plate", "total_force": force},
        ],
        "contacts": [
            {"on": f"head.{down}", "against": f"foot.{up}", "tied": True},
            {"on": "head.x+", "obstacle": wall, "interference": 1e-3 * length},
            {"on": f"head.{up}", "against": "plate"},
        ],
        "solver": {"tolerance": 1e-9},
    }


def told(summary: Config) -> list[float]:
    """Energy, how far the plate sinks, and the forces of the tie and the wall."""
    assert summary["certificate"]["passed"]
    plate = summary["rigid_bodies"]["plate"]["displacement"]
    forces = [c["force"] for c in summary["contacts"]]
    return [summary["solution"]["energy"], plate[-1], *forces[0], *forces[1]]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_units_decompositions_and_methods(cell: str, degree: int) -> None:
    d = scenes.dimension(cell)
    one = told(solve_scene(scenes.build(together(cell, degree), 2)).summary)
    assert one[1 + d] == pytest.approx(0.5, rel=1e-6)  # the tie carries what the plate presses
    assert one[5] < 0.0  # the wall pushes
    length, pressure = 1e-3, 1e6
    force = pressure * length ** (d - 1)
    units = np.array([force * length, length, *[force] * (len(one) - 2)])
    other = solve_scene(scenes.build(together(cell, degree, length, pressure), 5)).summary
    size = np.abs(one[2:]).max()
    np.testing.assert_allclose(told(other) / units, one, rtol=1e-6, atol=1e-6 * size)
    undecomposed = together(cell, degree)
    undecomposed["solver"]["method"] = "primal"
    found = told(solve_scene(scenes.build(undecomposed)).summary)
    np.testing.assert_allclose(found, one, rtol=1e-6, atol=1e-6 * size)


@pytest.mark.mpi
@pytest.mark.parametrize("method", ["auto", "primal"])
def test_three_ranks(method: str, tmp_path: Path) -> None:
    made = together("hexahedron", 1)
    made["solver"]["method"] = method
    if method == "auto":
        made["decomposition"] = {"subdomains": 6}
    one = told(solve_scene(scenes.build(made)).summary)
    found = told(summary_of(made, tmp_path, 3))
    np.testing.assert_allclose(found, one, rtol=1e-6, atol=1e-6 * np.abs(one[2:]).max())
