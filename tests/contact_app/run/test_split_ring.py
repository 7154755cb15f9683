"""A split ring that two forces close around a shaft: all of its points slide, or all but one."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes

SHAFT, OUTER, SPLIT = 10.0, 16.0, 0.075
"""Radii of the shaft and of the ring; half the angle of the split."""


def split_ring(path: Path, cells: int, mu: float) -> scenes.Config:
    """A ring of quadrilaterals with that many cells along it; the split is at the right."""

    def bent(x: np.ndarray) -> np.ndarray:
        angle = SPLIT + 2.0 * (np.pi - SPLIT) * x[:, 1]
        radius = SHAFT + (OUTER - SHAFT) * x[:, 0]
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    between, height = "hypot(x, y) > 10.001 and hypot(x, y) < 15.999", OUTER * np.sin(SPLIT) + 1e-6
    sides = {
        "bore": "hypot(x, y) < 10.000001",
        "upper": f"x > 9 and y > 0 and y < {height} and {between}",
        "lower": f"x > 9 and y < 0 and y > -{height} and {between}",
    }
    return {
        "dimension": "plane_strain",
        "bodies": [meshfiles.part(path, "quadrilateral", (4, cells), bent, sides)],
        "conditions": [
            {"on": "ring.upper", "displacement": [0, None]},
            {"on": "ring.upper", "total_force": [0, -750]},
            {"on": "ring.lower", "total_force": [0, 750]},
        ],
        "contacts": [
            {
                "on": "ring.bore",
                "obstacle": {"sphere": {"center": [0, 0], "radius": SHAFT}},
                "friction": {"coulomb": mu},
            }
        ],
    }


@pytest.mark.ratchet
@pytest.mark.parametrize(("cells", "mu", "most"), [(24, 0.3, 75), (36, 0.1, 80)])
def test_a_split_ring_settles(cells: int, mu: float, most: int, tmp_path: Path) -> None:
    """Without springs of the slip both methods end without a certified answer.

    SMALBE-M and both methods find the same answer.
    """
    energies = []
    for method in ("active-set", "primal", "smalbe"):
        made = split_ring(tmp_path / "ring.vtu", cells, mu)
        summary = solve_scene(scenes.build({**made, "solver": {"method": method}})).summary
        assert summary["certificate"]["passed"]
        assert summary["solver"]["method"] == method
        assert method == "smalbe" or summary["solver"]["hessian_multiplications"] <= most
        energies.append(summary["solution"]["energy"])
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-5)
