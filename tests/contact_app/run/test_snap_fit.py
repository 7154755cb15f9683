"""With friction the loop begins anew where each set has other contact."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes
from tests.scenes import Config


def clipped(x: np.ndarray) -> np.ndarray:
    """Points of a strip with a hook below its end."""
    points = x * [40.0, 3.0, 8.0]
    points[:, 1] -= np.where(points[:, 0] > 34.5, 3.0 - points[:, 1], 0.0)
    return points


def snap_fit(path: Path, cells: tuple[int, int, int]) -> Config:
    """The hook is pressed one radius deep over a round edge with friction."""
    edge = {"cylinder": {"point": [38, -4, 4], "axis": [0, 0, 1], "radius": 2}}
    sides = {"root": "x < 1e-6", "hook": "x > 33.9 and y < -2.99"}
    soft = {"young": 2400, "poisson": 0.38}
    body = meshfiles.part(path, "tetrahedron", cells, clipped, sides, degree=2, material=soft)
    return {
        "dimension": 3,
        "bodies": [body],
        "conditions": [{"on": "clip.root", "displacement": [0, 0, 0]}],
        "contacts": [{"on": "clip.hook", "obstacle": edge, "friction": {"coulomb": 0.3}}],
        "solver": {"method": "active-set"},
    }


@pytest.mark.ratchet
def test_a_snap_fit_begins_anew_without_friction(tmp_path: Path) -> None:
    """Without this no answer is certified after 721 operator applications."""
    summary = solve_scene(scenes.build(snap_fit(tmp_path / "clip.vtu", (30, 2, 6)))).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 120
