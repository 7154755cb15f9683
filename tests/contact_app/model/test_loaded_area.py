"""The area of a load, and what facets that straddle its boundary's edge leave out."""

import pytest
from mpi4py import MPI

from contact_app.model.loaded_area import loaded_facets, straddled_area
from contact_app.model.outline import outline_of_scene, partition_scene
from contact_app.run.check import describe
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.scenes import Config


def half_loaded(cell: str, where: str, n: int = 4, kind: str = "traction") -> Config:
    """The part of the top in which an expression holds is loaded."""
    made = scenes.wall(cell, n)
    top = "z" if scenes.dimension(cell) == 3 else "y"
    made["bodies"][0]["boundaries"] = {"part": {"where": f"{top} > 0.999 and {where}"}}
    load = scenes.vector(cell, 0, 0, -50) if kind == "traction" else 50.0
    made["conditions"][1] = {"on": "block.part", kind: load}
    return made


@pytest.mark.parametrize("kind", ["traction", "pressure"])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_an_edge_on_grid_lines_leaves_nothing_out(cell: str, kind: str) -> None:
    scene = scenes.build(half_loaded(cell, "x < 0.5001", kind=kind), 2)
    partition = partition_scene(scene, MPI.COMM_SELF)
    (load,) = (*scene.tractions, *scene.pressures)
    assert loaded_facets(scene.bodies, partition, load)[1] == pytest.approx(0.5)
    assert straddled_area(scene.bodies, partition, load) == 0.0
    warnings = solve_scene(scene).summary["certificate"]["warnings"]
    assert not any("straddle" in text for text in warnings)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron", "tetrahedron"])
def test_facets_that_straddle_the_edge_cause_a_warning(cell: str) -> None:
    scene = scenes.build(half_loaded(cell, "x < 0.625"), 2)
    partition = partition_scene(scene, MPI.COMM_SELF)
    assert loaded_facets(scene.bodies, partition, scene.tractions[0])[1] == pytest.approx(0.5)
    assert straddled_area(scene.bodies, partition, scene.tractions[0]) == pytest.approx(
        0.125, rel=0.15
    )
    warnings = solve_scene(scene).summary["certificate"]["warnings"]
    (told,) = [text for text in warnings if "straddle" in text]
    assert "conditions[1]: facets that straddle the edge of part carry no load" in told
    assert "acts on an area of 0.5, but the expression holds on about 0.6" in told


def test_check_reports_the_area() -> None:
    scene = scenes.build(half_loaded("hexahedron", "x < 0.5001"))
    lines = describe(scene, outline_of_scene(scene, MPI.COMM_SELF))
    assert any("per area (8 facets, area 0.5)" in line for line in lines)


def test_boundaries_of_the_mesh_are_not_sampled() -> None:
    scene = scenes.build(scenes.wall("hexahedron", 3))
    partition = partition_scene(scene, MPI.COMM_SELF)
    assert straddled_area(scene.bodies, partition, scene.tractions[0]) == 0.0
    assert loaded_facets(scene.bodies, partition, scene.tractions[0])[1] == pytest.approx(1.0)
