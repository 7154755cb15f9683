"""With friction the loop begins anew where each set has other contact."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from tests import scenes
from tests.scenes import Config

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def clip(path: Path, cells: tuple[int, int, int]) -> None:
    """Write a strip of hexahedra with a hook below its end."""
    axes = [np.linspace(0.0, size, n + 1) for size, n in zip((40.0, 3.0, 8.0), cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points[:, 1] -= np.where(points[:, 0] > 34.5, 3.0 - points[:, 1], 0.0)
    nodes = np.arange(len(points)).reshape([n + 1 for n in cells])
    ends = [slice(0, -1), slice(1, None)]
    corners = [nodes[ends[i], ends[j], ends[k]].ravel() for i, j, k in CORNERS]
    meshio.Mesh(points, [("hexahedron", np.column_stack(corners))]).write(path)


def snap_fit(path: Path) -> Config:
    """The hook is pressed one radius deep over a round edge with friction."""
    edge = {"cylinder": {"point": [38, -4, 4], "axis": [0, 0, 1], "radius": 2}}
    boundaries = {"root": {"where": "x < 1e-6"}, "hook": {"where": "x > 33.9 and y < -2.99"}}
    body = {"name": "clip", "mesh": {"file": str(path)}, "boundaries": boundaries,
            "material": {"young": 2400, "poisson": 0.38}}  # fmt: skip
    return {
        "dimension": 3,
        "bodies": [body],
        "conditions": [{"on": "clip.root", "displacement": [0, 0, 0]}],
        "contacts": [{"on": "clip.hook", "obstacle": edge, "friction": {"coulomb": 0.3}}],
        "solver": {"method": "active-set"},
    }


@pytest.mark.ratchet
def test_a_snap_fit_begins_anew_without_friction(tmp_path: Path) -> None:
    """Without this it takes 162 operator applications; finer clips of degree 2 took thousands."""
    clip(tmp_path / "clip.vtu", (40, 3, 8))
    summary = solve_scene(scenes.build(snap_fit(tmp_path / "clip.vtu"))).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 120
