"""Warnings of obstacles and bodies that enter contact boundaries beside the contact rows."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.accuracy.contact_limits import entered_between
from contact_app.accuracy.entered_pairs import entered, near_each_other
from contact_app.run.solve import solve_scene
from meshes.contact_surface import Surface
from tests import meshfiles, scenes
from tests.comparison import solve


def lifted(cells: int, cell: str = "quadrilateral", degree: int = 1, **more: Any) -> scenes.Config:
    """A block that its own force lifts against a small disc above the middle of a facet."""
    disc = {"sphere": {"center": [0.51, 1.0 + 0.2 + 1e-3], "radius": 0.2}}
    return {
        "dimension": 2,
        "bodies": [scenes.box("b", [2, 1], [cells, cells], cell=cell, degree=degree)],
        "conditions": [{"on": "b.y-", "displacement": [0, 0]}, {"in": "b", "force": [0, 20.0]}],
        "contacts": [{"on": "b.y+", "obstacle": disc}],
        **more,
    }


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_contact_between_nodes_causes_a_warning(cell: str) -> None:
    coarse = solve(lifted(2, cell))
    moved = coarse.summary["solution"]["max_displacement"]
    assert coarse.summary["solution"]["active_contacts"] == 0
    depth = entered_between(coarse.model, coarse.solution, 0)
    assert 0.5 * moved < depth < moved, "the top rises by less than the whole, the disc stays"
    assert any("between the nodes of b" in w for w in coarse.solution.certificate.warnings)
    fine = solve(lifted(64, cell))
    assert fine.summary["solution"]["active_contacts"] > 0
    assert entered_between(fine.model, fine.solution, 0) < 0.1 * moved
    assert not any("between the nodes" in w for w in fine.solution.certificate.warnings)


def test_the_same_on_facets_of_second_order_and_in_parts() -> None:
    made = lifted(2, degree=2)
    made["contacts"][0]["obstacle"]["sphere"]["center"][0] = 0.26  # the nodes are at 0 and 0.5
    whole, parts = (solve(made, n) for n in (1, [2, 2]))
    depths = [entered_between(s.model, s.solution, 0) for s in (whole, parts)]
    assert depths[0] == pytest.approx(depths[1], rel=1e-5)
    assert depths[0] > 0.2 * whole.summary["solution"]["max_displacement"]


def test_interference_with_a_flat_side_causes_a_warning() -> None:
    """The disc stands in the side before anything moves, where no node is."""
    made = lifted(2)
    made["contacts"][0]["obstacle"]["sphere"]["center"][1] -= 0.002
    solved = solve(made)
    depth = entered_between(solved.model, solved.solution, 0)
    assert depth > solved.summary["solution"]["max_displacement"]


def test_a_round_surface_on_a_round_obstacle_is_no_obstacle_between_nodes() -> None:
    """The initial overlap is that of the polygon, which another warning covers."""
    config = Path(__file__).parents[3] / "configs" / "bushing.yaml"
    solved = solve_scene(scenes.read(config))
    depth = entered_between(solved.model, solved.solution, 0)
    assert depth < 0.01 * solved.summary["solution"]["max_displacement"]


def edge_first(path: Path, degree: int, angle: float = 45.0) -> scenes.Config:
    """A block of tetrahedra on one of its edges; one face at the edge is the contact boundary."""
    mesh = meshfiles.write(meshfiles.block("tetrahedron", 2, 0.0), path / "block.msh")
    turned = {"angle": angle, "axis": [0, 1, 0]}
    lift = 1.0 + float(np.sin(np.deg2rad(angle)))
    place = {"file": str(mesh), "rotate": turned, "translate": [0, 0, lift]}
    material = {"young": 1000.0, "poisson": 0.3}
    return {
        "dimension": 3,
        "bodies": [{"name": "b", "mesh": place, "material": material, "degree": degree}],
        "conditions": [{"on": "b.x-", "displacement": [0, 0, -0.01]}],
        "contacts": [
            {"on": "b.x+", "obstacle": {"plane": {"point": [0, 0, 1], "normal": [0, 0, 1]}}}
        ],
    }


def on_another_body(config: scenes.Config) -> scenes.Config:
    """The same on an elastic body in place of the plane."""
    box = {"lower": [-1, -1, 0], "upper": [2, 2, 1], "cells": [6, 6, 2]}
    floor = {"name": "floor", "mesh": {"box": box}, "material": config["bodies"][0]["material"]}
    config["bodies"].append(floor)
    config["conditions"].append({"on": "floor.z-", "displacement": [0, 0, 0]})
    config["contacts"] = [{"on": "b.x+", "against": "floor.z+"}]
    return config


@pytest.mark.parametrize("subdomains", [None, 3])
def test_edge_of_second_order_tetrahedra_presses_a_plane(
    tmp_path: Path, subdomains: int | None
) -> None:
    second, first = (solve(edge_first(tmp_path, degree), subdomains) for degree in (2, 1))
    assert entered_between(second.model, second.solution, 0) < 0.1 * 0.01
    force, stiffer = (s.summary["solution"]["contact_force"][2] for s in (second, first))
    assert 0.5 * stiffer < force < stiffer, "degree 2 is softer under a concentrated force"
    assert not any("enters" in w for w in second.solution.certificate.warnings)


def test_blunt_edge_of_second_order_tetrahedra_causes_a_warning(tmp_path: Path) -> None:
    solved = solve(edge_first(tmp_path, 2, 80.0))
    assert entered_between(solved.model, solved.solution, 0) == pytest.approx(0.01)
    warning = "between the vertices of b the obstacle enters by up to 0.01"
    assert any(warning in w for w in solved.solution.certificate.warnings)


def test_edge_of_second_order_tetrahedra_presses_another_body(tmp_path: Path) -> None:
    second, first = (solve(on_another_body(edge_first(tmp_path, degree))) for degree in (2, 1))
    force, stiffer = (s.summary["contacts"][0]["force"][2] for s in (second, first))
    assert 0.5 * stiffer < force < 1.2 * stiffer


def test_edge_in_the_facets_of_another_body_causes_a_warning(tmp_path: Path) -> None:
    made = on_another_body(edge_first(tmp_path, 2))
    made["contacts"] = [{"on": "floor.z+", "against": "b.x+"}]
    solved = solve(made)
    depth = entered(solved.model, solved.nodes, solved.model.scene.pairs[0])
    assert depth == pytest.approx(0.01)
    warnings = solved.solution.certificate.warnings
    assert any("enter each other by up to 0.01 at vertices" in w for w in warnings)


def test_face_on_another_body_causes_none(tmp_path: Path) -> None:
    made = on_another_body(edge_first(tmp_path, 2))
    made["bodies"][0]["mesh"] |= {
        "rotate": {"angle": 90, "axis": [0, 1, 0]},
        "translate": [0, 0, 2],
    }
    warnings = solve(made).solution.certificate.warnings
    assert not any("enter each other" in w for w in warnings)


def test_facets_that_a_vertex_reaches_stay() -> None:
    """Facets within the displacements of the other surface stay, and facets far from it do not."""
    normal = np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)
    slope = 3.0 * np.eye(3)
    tip = slope.mean(axis=0) + 9.0 * normal + np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]])
    box, tool = (
        Surface(3, first + np.arange(6).reshape(2, 3), np.stack(facets), np.tile(out, (2, 1)))
        for first, facets, out in ((0, (slope, slope - 30), normal), (6, (tip, tip + 30), -normal))
    )
    assert [len(side.nodes) for side in near_each_other(box, tool, 0.0)] == [0, 0]
    kept = near_each_other(box, tool, 5.2)  # components of displacements of 9 along the normal
    assert [side.nodes.tolist() for side in kept] == [[[0, 1, 2]], [[6, 7, 8]]]
