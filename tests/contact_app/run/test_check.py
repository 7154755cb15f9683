"""`check`: its report, its refusals, and its estimates compared with runs."""

import re
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from contact_app.errors import NoEquilibriumError
from contact_app.model.outline import outline_of_scene
from contact_app.run.check import describe, report
from contact_app.run.cost import estimate
from contact_app.run.model_report import modelled_lines
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from solver.contact.row_kinds import RowKind
from tests import scenes


def lines_of(made: dict[str, Any], subdomains: int | list[int] | None = None) -> str:
    scene = scenes.build(made, subdomains)
    return "\n".join(describe(scene, outline_of_scene(scene, MPI.COMM_SELF, needed="distinct")))


def test_unloaded_bodies_are_reported() -> None:
    made = scenes.wall("hexahedron", 2)
    made["bodies"].append(
        scenes.block("hexahedron", 2, name="idle", lower=(3, 0, 0), upper=(4, 1, 1))
    )
    made["conditions"].append(scenes.clamp("hexahedron", "idle.z-"))
    text = lines_of(made)
    assert (
        "idle: has no load, no prescribed displacement and no overlap; it does not deform" in text
    )
    assert "block: nothing loads" not in text
    made["conditions"][-1]["displacement"] = [0, 0, 0.1]
    assert "nothing loads" not in lines_of(made)


def test_the_log_of_a_run_has_the_lines_of_check(tmp_path: Path) -> None:
    scene = scenes.build(scenes.duplicate_obstacles("quadrilateral", 4), [2, 2])
    known = outline_of_scene(scene, MPI.COMM_SELF, needed="distinct")
    assert run(scene, tmp_path, MPI.COMM_SELF) == 0
    logged = (tmp_path / "run.log").read_text()
    lines = modelled_lines(scene, known)
    assert len(lines) > 12
    assert [line for line in lines if line and line not in logged] == []


@pytest.mark.parametrize(("place", "overlap"), [(1.0, False), (0.99, True)])
def test_an_overlap_is_reported(place: float, overlap: bool) -> None:
    """A roof that stands in the body may be meant, or be a mistake in the geometry."""
    made = scenes.wall("hexahedron", 2)
    roof = {"plane": {"point": [0, 0, place], "normal": [0, 0, -1]}}
    made["contacts"] = [{"on": "block.z+", "obstacle": roof}]
    assert ("smallest gap -0.01: an overlap, which presses as an" in lines_of(made)) == overlap


def test_the_model_is_reported() -> None:
    text = lines_of(scenes.two_bodies("hexahedron", 4))
    assert "152 nodes, 456 degrees of freedom" in text
    assert "body soft: box (0, 0, 0) to (1, 1, 1) of 4 x 4 x 4 cells (hexahedron)" in text
    assert "conditions[0]: soft.z- displaced by x = 0, y = 0, z = 0 (25 nodes)" in text
    assert "soft.z+ loaded by (0, 0, -50) per area (16 facets, area 1)" in text
    assert "plane through (1, 0, 0) with normal (-1, 0, 0) (20 candidate nodes" in text
    assert "smallest gap 0.01)" in text
    assert "total load (0, 0, -50)" in text
    assert "friction" in text
    assert "nothing was solved" in text


@pytest.mark.parametrize(
    ("name", "subdomains", "expected"),
    [
        ("nearly_repeated", 1, "contacts[1]: at 6 of 6 candidate nodes another contact is nearer"),
        ("duplicate_obstacles", 1, "contacts[1]: repeats contacts[0] and adds no rows"),
        ("duplicate_obstacles", 1, "6 candidate nodes and 3 that are held or belong to other"),
        ("no_contacts", 1, "no contacts: conjugate gradients solve the linear problem"),
        ("wall", 1, "held by its conditions and not decomposed: no gluing"),
        ("wall", [2, 2, 2], "its subdomains float (Total FETI)"),
        ("floating_in_corner", 1, "held by its contacts alone"),
        ("sliding", 1, "free in 3 rigid motions on which no load does work"),
    ],
)
def test_omissions_are_reported_with_reasons(name: str, subdomains: Any, expected: str) -> None:
    made = scenes.ALL.get(name, scenes.wall)("hexahedron", 2)
    if name == "nearly_repeated":
        turned = scenes.plane("hexahedron", (1.001, 0, 0.5), (-1, 0, 1e-3))
        made["contacts"].append({"on": "block.x+", "obstacle": turned})
    assert expected in lines_of(made, subdomains)


def test_middles_of_edges_count_as_no_candidates() -> None:
    """A degree-2 tetrahedron has a contact row for each vertex, and none for middles."""
    made = scenes.wall("tetrahedron", 2)
    made["bodies"][0]["degree"] = 2
    assert re.search(r"\(\d+ candidate nodes, smallest gap", lines_of(made))


def test_plane_scenes() -> None:
    text = lines_of(scenes.wall("triangle", 4))
    assert "2D, plane strain" in text
    assert "per unit of thickness" in text
    assert "plane through (1, 0) with normal (-1, 0)" in text
    assert "circle about (0.45, 2.01)" in lines_of(scenes.sphere("triangle", 4))


@pytest.mark.parametrize("change", ["none", "tied", "heat"])
def test_a_body_without_a_load_of_its_own(change: str) -> None:
    """A tied body or heat may deform an unloaded body."""
    made = scenes.wall("hexahedron", 2)
    made["bodies"].append(
        {
            **made["bodies"][0],
            "name": "idle",
            "mesh": {"box": {"lower": [0, 0, 1], "upper": [1, 1, 2], "cells": [3, 3, 3]}},
        }
    )
    if change == "none":
        made["conditions"].append({"on": "idle.z+", "displacement": [0, 0, 0]})
    elif change == "tied":
        made["contacts"].append({"on": "block.z+", "against": "idle.z-", "tied": True})
    else:
        made["bodies"][1]["material"] = {**made["bodies"][1]["material"], "expansion": 1e-5}
        made["conditions"].append({"on": "idle.z+", "displacement": [0, 0, 0]})
        made["conditions"].append({"in": "idle", "temperature": 10})
    assert ("idle: has no load" in lines_of(made)) == (change == "none")


def test_shared_nodes_are_counted_once() -> None:
    made = scenes.wall("hexahedron", 4)
    whole, split = lines_of(made, 1), lines_of(made, [2, 2, 2])
    for counted in ("(25 nodes)", "(16 facets, area 1)", "(20 candidate nodes"):
        assert counted in whole
        assert counted in split


def test_an_obstacle_in_other_units_is_found_out() -> None:
    """A wall in millimetres beside a block in metres: told by `check`, and where it holds none."""
    made = scenes.wall("hexahedron", 2)
    assert "unit of length" not in lines_of(made)
    made["contacts"][0]["obstacle"]["plane"]["point"] = [1000, 0, 0]
    assert "which is 1.73 long in all: are both in the same unit of length?" in lines_of(made)
    assert "from (0, 0, 0) to (1, 1, 1)" in lines_of(made)
    held = scenes.floating_in_corner("hexahedron", 2)
    held["contacts"][0]["obstacle"]["plane"]["point"] = [-1000, -1000, -1000]
    held["contacts"] = held["contacts"][:1]
    with pytest.raises(NoEquilibriumError, match=r"contacts\[0\]: the obstacle is .* away from"):
        report(scenes.build(held), MPI.COMM_SELF)


@pytest.mark.parametrize("subdomains", [None, 1, [2, 2, 2], 4])
def test_the_report_is_printed(subdomains: Any, capsys: pytest.CaptureFixture[str]) -> None:
    report(scenes.build(scenes.wall("tetrahedron", 3), subdomains), MPI.COMM_SELF)
    out = capsys.readouterr().out
    assert "memory: about" in out
    assert "time: about" in out


def test_gluing_rows_equal_those_of_the_run() -> None:
    scene = scenes.build(scenes.floating_in_corner("hexahedron", 4), [2, 2, 2])
    text = "\n".join(describe(scene, outline_of_scene(scene, MPI.COMM_SELF)))
    run = solve_scene(scene, MPI.COMM_SELF)
    assert f"{run.model.problem.count(RowKind.GLUING):,} rows glue them" in text


# Peak memory (GB) and seconds without start-up of `contact-app run` on this cube, on two cores.
MEASURED = [
    (20, None, 0.19, 0.15),
    (40, None, 0.29, 0.57),
    (60, None, 0.48, 1.3),
    (100, None, 1.2, 5.6),
    (120, None, 1.8, 8.5),
    (20, 1, 0.41, 1.04),
    (30, 1, 1.26, 5.7),
    (20, 20, 0.20, 0.26),
]


@pytest.mark.parametrize(("cells", "subdomains", "gigabytes", "seconds"), MEASURED)
def test_estimates_are_within_a_factor_of_two(
    cells: int, subdomains: int | None, gigabytes: float, seconds: float
) -> None:
    made = scenes.wall("hexahedron", cells)
    made["solver"] = {"tolerance": 1e-6}
    scene = scenes.build(made, subdomains, memory=float("inf"))
    outline = outline_of_scene(scene, MPI.COMM_SELF)
    cost = estimate(outline, scene.decomposition, scene.solver.tolerance)
    assert 0.5 * gigabytes <= cost.memory / 1e9 <= 2.0 * gigabytes
    assert 0.5 * seconds <= cost.seconds <= 2.0 * seconds
