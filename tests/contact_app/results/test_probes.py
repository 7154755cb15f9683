"""Displacements at points: linear fields are exact anywhere, nodes have theirs, errors are told."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.errors import ConfigurationError
from contact_app.model.geometry import Geometry
from contact_app.model.outline import partition_scene
from contact_app.model.probes import locate_probes
from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes
from tests.scenes import Config

CELLS = ["quadrilateral", "triangle", "hexahedron", "tetrahedron"]


def stretched(cell: str, degree: int = 1) -> Config:
    """A block pulled by 0.01 along its last axis, without Poisson's ratio: u = 0.01 z."""
    made = scenes.wall(cell, 3)
    made["contacts"] = []
    d = scenes.dimension(cell)
    made["bodies"][0] |= {"degree": degree, "material": {"young": 1.0, "poisson": 0.0}}
    last = [None] * (d - 1)
    made["conditions"] = [
        {"on": f"block.{scenes.down(cell)}", "displacement": [0.0] * d},
        {"on": f"block.{scenes.up(cell)}", "displacement": [*last, 0.01]},
    ]
    return made


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_a_linear_field_is_exact_anywhere(cell: str, degree: int) -> None:
    made, d = stretched(cell, degree), scenes.dimension(cell)
    rng = np.random.default_rng(3)
    points = {f"p{i}": [float(v) for v in rng.uniform(0, 1, d)] for i in range(5)}
    points |= {"corner": [1.0] * d, "edge": [0.0, *[1 / 3] * (d - 1)]}
    made["output"] = {"probes": points}
    found = solve_scene(scenes.build(made, 2)).summary["probes"]
    assert list(found) == list(points)
    for name, point in points.items():
        expected = np.zeros(d)
        expected[-1] = 0.01 * point[-1]
        np.testing.assert_allclose(found[name]["displacement"], expected, atol=1e-9)


def test_the_mirror_image_has_probes() -> None:
    made = scenes.wall("quadrilateral", 4)
    made["contacts"] = []
    made["output"] = {"probes": {"left": [0.1, 0.9], "right": [0.9, 0.9]}}
    whole = contact_app.solve(made).summary["probes"]
    half = contact_app.solve(made | {"symmetry": "allow"}).summary["probes"]
    for name, record in whole.items():
        np.testing.assert_allclose(half[name]["displacement"], record["displacement"], atol=1e-9)
    assert whole["left"]["displacement"][0] == pytest.approx(-whole["right"]["displacement"][0])


def pressed_ring(cell: str, name: str, directory: Path) -> scenes.Config:
    """A quarter of a ring with curved cells of degree 2 under a pressure inside."""
    block, ring = meshfiles.block(cell, 2, 0.0), meshfiles.ring(1.0, 2.0)
    made, mesh = stretched(cell, 2), meshfiles.second_order(block, cell, name, ring)
    made["bodies"][0]["mesh"] = {"file": str(meshfiles.write(mesh, directory / "ring.msh"))}
    made["conditions"] = [
        {"on": "block.y-", "displacement": [0.0, 0.0]},
        {"on": "block.x-", "pressure": 0.01},
    ]
    return made


def test_curved_cells(tmp_path: Path) -> None:
    made = pressed_ring("quadrilateral", "quad8", tmp_path)
    angle = 0.3
    place = [1.999 * np.cos(angle), 1.999 * np.sin(angle)]  # beyond the chord of the outer edge
    made["output"] = {"probes": {"rim": place}}
    answer = contact_app.solve(made)
    found = answer.summary["probes"]["rim"]["displacement"]
    near = np.linalg.norm(answer.points[:, :2] - place, axis=1).argsort()[:3]
    assert np.abs(found - answer.displacement[near].mean(axis=0)).max() < np.abs(found).max()


def test_every_place_of_a_curved_body_is_found(tmp_path: Path) -> None:
    """Curved cells lie in the convex hulls of their neighbours, too: the right one is taken."""
    made = pressed_ring("triangle", "triangle6", tmp_path)
    rng = np.random.default_rng(5)
    radius, angle = rng.uniform(1.02, 1.98, 200), rng.uniform(0.02, 1.55, 200)
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    made["output"] = {"probes": {f"p{i}": list(map(float, x)) for i, x in enumerate(places)}}
    scene = scenes.build(made)
    partition = partition_scene(scene, MPI.COMM_SELF)
    probes = locate_probes(Geometry.of(scene, partition), scene.output.probes)
    for probe, place in zip(probes, places, strict=True):
        assert probe.subdomain is not None
        points = partition.subdomains[probe.subdomain].points()[probe.nodes]
        np.testing.assert_allclose(probe.shares @ points[:, :2], place, atol=1e-7)


def test_wrong_points_are_refused() -> None:
    made = scenes.wall("hexahedron", 2)
    made["output"] = {"probes": {"tip": [2.0, 0.5, 0.5]}}
    with pytest.raises(ConfigurationError, match=r"probes.tip: the point \(2, 0.5, 0.5\) lies in"):
        contact_app.solve(made)
    made["output"] = {"probes": {"tip": [0.5, 0.5]}}
    with pytest.raises(ConfigurationError, match="probes.tip has 2 components"):
        contact_app.solve(made)


@pytest.mark.parametrize("tied", [False, True])
def test_a_probe_where_bodies_meet_is_in_the_first_with_a_warning(tied: bool) -> None:
    """Tied bodies move as one there."""
    cell = "quadrilateral"
    upper = scenes.block(cell, 3, "upper", (0.0, 0.0, 1.0), (1.0, 1.0, 2.0))
    joint = {"tied": True} if tied else {"friction": {"coulomb": 0.3}}
    made = scenes.config(
        cell,
        [scenes.block(cell, 3), upper],
        [scenes.clamp(cell, "block.y-"), {"on": "upper.y+", "displacement": [0.01, -0.02]}],
        [{"on": "upper.y-", "against": "block.y+", **joint}],
    )
    made["output"] = {"probes": {"seam": [1.0, 1.0], "below": [1.0, 0.99]}}
    summary = contact_app.solve(made).summary
    moved = [summary["probes"][name]["displacement"] for name in ("seam", "below")]
    np.testing.assert_allclose(*moved, atol=0.02 * 0.02)
    told = [w for w in summary["certificate"]["warnings"] if "probes.seam: block and upper" in w]
    assert len(told) == (not tied)
