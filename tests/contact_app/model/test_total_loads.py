"""Total forces and moments: their resultants, beam theory, decompositions, degrees, errors."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.errors import ConfigurationError
from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes
from tests.comparison import load_resultant
from tests.scenes import Config
from tests.scenes_on_ranks import one_and_two, same_solution

CELLS = ("quadrilateral", "triangle", "hexahedron", "tetrahedron")


def beam(cell: str, load: Config, n: int = 4, length: float = 4.0, degree: int = 1) -> Config:
    """Clamped at x-, loaded at x+; one high and, in space, one wide."""
    d = scenes.dimension(cell)
    upper, cells = [length, *[1.0] * (d - 1)], [2 * n, *[n] * (d - 1)]
    body = scenes.box("beam", upper, cells, cell=cell, poisson=0.0, degree=degree)
    clamp = {"on": "beam.x-", "displacement": [0.0] * d}
    return scenes.config(cell, [body], [clamp, {"on": "beam.x+", **load}], [])


def resultant(made: Config, subdomains: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about the origin of the nodal loads."""
    return load_resultant(scenes.build(made, subdomains))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_nodal_loads_add_up_to_force_and_moment_at_a_remote_point(cell: str, degree: int) -> None:
    d = scenes.dimension(cell)
    at = [7.0, -3.0, 2.0][:d]
    given = [1.0, 2.0, -3.0][:d]
    couple: Any = [0.5, -0.25, 4.0] if d == 3 else 4.0
    load = {"total_force": given, "total_moment": couple, "at": at}
    force, moment = resultant(beam(cell, load, 2, degree=degree), 3)
    full, point = np.zeros(3), np.zeros(3)
    full[:d], point[:d] = given, at
    expected = np.cross(point, full) + (np.array(couple) if d == 3 else [0.0, 0.0, couple])
    np.testing.assert_allclose(force, full, atol=1e-12)
    np.testing.assert_allclose(moment, expected, atol=1e-11)


def test_a_total_force_is_the_uniform_traction_that_adds_up_to_it() -> None:
    total = solve_scene(scenes.build(beam("hexahedron", {"total_force": [3.0, 1.0, -2.0]})))
    uniform = solve_scene(scenes.build(beam("hexahedron", {"traction": [3.0, 1.0, -2.0]})))
    energies = [s.summary["solution"]["energy"] for s in (total, uniform)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-10)
    assert total.accuracy.discretisation == pytest.approx(uniform.accuracy.discretisation, rel=1e-8)


@pytest.mark.parametrize(
    ("cell", "couple"), [("quadrilateral", 5.0), ("hexahedron", [0.0, 0.0, 5.0])]
)
def test_pure_bending_is_that_of_the_beam(cell: str, couple: Any) -> None:
    """Without Poisson's ratio the linear traction is exact: w = M x² / (2 E I), degree 2 has it."""
    made = beam(cell, {"total_moment": couple}, degree=2)
    solved = solve_scene(scenes.build(made, 1))
    tip = np.abs(solved.nodes.points[:, 0] - 4.0) < 1e-9
    deflection = 5.0 * 4.0**2 / (2.0 * 1000.0 / 12.0)
    np.testing.assert_allclose(solved.nodes.displacement[tip, 1], deflection, rtol=1e-6)
    assert solved.accuracy.discretisation < 1e-6  # the recovery knows the traction at the end


def test_torsion_turns_the_end_about_its_axis() -> None:
    made = beam("hexahedron", {"total_moment": [2.0, 0.0, 0.0]}, degree=2)
    nodes = solve_scene(scenes.build(made, 1)).nodes
    tip = np.abs(nodes.points[:, 0] - 4.0) < 1e-9
    arm, u = nodes.points[tip] - [4.0, 0.5, 0.5], nodes.displacement[tip]
    angle = np.einsum("ni,ni->", np.cross([1.0, 0, 0], arm), u) / (arm[:, 1:] ** 2).sum()
    assert angle == pytest.approx(2.0 * 4.0 / (500.0 * 0.1406), rel=0.05)  # St. Venant, G J


def test_the_total_is_the_same_on_every_mesh_of_a_where_boundary() -> None:
    for n in (4, 5, 8):
        made = beam("hexahedron", {"total_force": [0.0, 0.0, -7.0]}, n)
        made["bodies"][0]["boundaries"] = {"end": {"where": "x > 3.999 and z < 0.61"}}
        made["conditions"][1]["on"] = "beam.end"
        np.testing.assert_allclose(resultant(made)[0], [0.0, 0.0, -7.0], atol=1e-12)


def test_curved_cells_from_a_file(tmp_path: Path) -> None:
    mesh = meshfiles.second_order(meshfiles.block("quadrilateral", 3, 0.0), "quadrilateral",
                                  "quad8", meshfiles.ring(2.0, 3.0))  # fmt: skip
    file = meshfiles.write(mesh, tmp_path / "ring.msh")
    made = beam("quadrilateral", {"total_force": [1.0, 2.0], "total_moment": 3.0, "at": [0.5, 9.0]})
    made["bodies"][0]["mesh"] = {"file": str(file)}
    made["bodies"][0]["degree"] = 2
    force, moment = resultant(made)
    np.testing.assert_allclose(force, [1.0, 2.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(moment, [0, 0, 3.0 + 0.5 * 2.0 - 9.0 * 1.0], atol=1e-9)


@pytest.mark.mpi
def test_two_ranks(tmp_path: Path) -> None:
    load = {"total_force": [0.0, 0.0, -1.0], "total_moment": [1.0, 2.0, 3.0], "at": [4.0, 2.0, 0.0]}
    made = beam("hexahedron", load)
    one, two = one_and_two(made, tmp_path, 4)
    same_solution(one, two, 1e-7)


@pytest.mark.parametrize(
    ("cell", "load", "message"),
    [
        ("hexahedron", {"total_moment": 3.0}, "total_moment is one number; in 3D"),
        ("quadrilateral", {"total_moment": [3.0]}, "total_moment is a list; in 2D"),
        ("hexahedron", {"total_force": [1.0, 2.0]}, "total_force has 2 components"),
        ("hexahedron", {"traction": [1, 0, 0], "at": [0, 0, 0]}, "at belongs to a total_force"),
        ("hexahedron", {"traction": [1, 0, 0], "total_force": [1, 0, 0]}, "stand alone"),
        ("hexahedron", {"total_force": [0, 0, 0]}, "load nothing"),
    ],
)
def test_wrong_use_is_refused(cell: str, load: Config, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        scenes.build(beam(cell, load))
