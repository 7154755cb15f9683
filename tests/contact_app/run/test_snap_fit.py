"""With friction the loop begins anew where each set has other contact."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from solver.contact.active_set_options import ActiveSetOptions, Turnover
from tests import scenes
from tests.scenes import Config

TETRAHEDRA = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
"""Corners of six tetrahedra that fill a hexahedron."""

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def clip(path: Path, cells: tuple[int, int, int]) -> None:
    """Write a strip of tetrahedra with a hook below its end."""
    axes = [np.linspace(0.0, size, n + 1) for size, n in zip((40.0, 3.0, 8.0), cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points[:, 1] -= np.where(points[:, 0] > 34.5, 3.0 - points[:, 1], 0.0)
    nodes = np.arange(len(points)).reshape([n + 1 for n in cells])
    ends = [slice(0, -1), slice(1, None)]
    corners = [nodes[ends[i], ends[j], ends[k]].ravel() for i, j, k in CORNERS]
    hexahedra = np.column_stack(corners)
    meshio.Mesh(points, [("tetra", hexahedra[:, TETRAHEDRA].reshape(-1, 4))]).write(path)


def snap_fit(path: Path) -> Config:
    """The hook is pressed one radius deep over a round edge with friction."""
    edge = {"cylinder": {"point": [38, -4, 4], "axis": [0, 0, 1], "radius": 2}}
    boundaries = {"root": {"where": "x < 1e-6"}, "hook": {"where": "x > 33.9 and y < -2.99"}}
    body = {"name": "clip", "mesh": {"file": str(path)}, "boundaries": boundaries, "degree": 2,
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
    """Without this no answer is certified after 721 operator applications."""
    clip(tmp_path / "clip.vtu", (30, 2, 6))
    summary = solve_scene(scenes.build(snap_fit(tmp_path / "clip.vtu"))).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 120


def test_contact_that_only_opens_is_not_unsettled() -> None:
    """The turnovers of `configs/rough_rod.yaml` and of the clip."""
    leaving = [(0, 124, 207), (0, 1, 83), (0, 2, 82), (0, 58, 80), (0, 20, 22), (1, 1, 2)]
    changing = [(4, 5, 10), (5, 7, 9), (26, 4, 4), (9, 22, 26), (1, 8, 14), (5, 4, 8)]
    options = ActiveSetOptions(settling=6)
    assert not options.is_unsettled([Turnover(*numbers) for numbers in leaving])
    assert options.is_unsettled([Turnover(*numbers) for numbers in changing])
    assert not options.is_unsettled([Turnover(*numbers) for numbers in changing[:5]])
