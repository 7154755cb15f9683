"""The estimate of the discretisation error: its size, and its independence of the decomposition."""

import numpy as np
import pytest

from tests import scenes
from tests.comparison import solve
from tests.contact_app.model.test_two_bodies import stack
from tests.rows import covering

CELLS = scenes.CELLS_3D + scenes.CELLS_2D


@pytest.mark.parametrize(
    ("cell", "mean"), [*((c, False) for c in CELLS), ("quadrilateral", True), ("hexahedron", True)]
)
def test_zero_where_the_mesh_is_exact(cell: str, mean: bool) -> None:
    """The contact patch: a constant stress, with rollers, a loaded and a touching side."""
    made = scenes.column(cell, 3, scenes.on_top(cell, 0, 0, -30.0), mean_dilatation=mean)
    if mean:
        made["bodies"][0]["material"]["poisson"] = 0.49
    solved = solve(made, [2] * scenes.dimension(cell), tolerance=1e-12)
    assert solved.summary["solution"]["max_contact_pressure"] == pytest.approx(30.0)
    assert solved.accuracy.discretisation < 1e-9
    assert solved.accuracy.algebraic < 1e-6


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_zero_where_a_body_one_cell_thick_is_exact(cell: str, degree: int) -> None:
    """The same patch on one cell: stresses across it must not be halved."""
    made = scenes.column(cell, 3, scenes.on_top(cell, 0, 0, -30.0), degree=degree)
    made["bodies"][0]["mesh"]["box"]["cells"][0] = 1
    assert solve(made, tolerance=1e-10).accuracy.discretisation < 1e-8


@pytest.mark.parametrize("cell", CELLS)
def test_zero_where_degree_2_is_exact(cell: str) -> None:
    """A stress linear in height: a column under its own weight, on one and many subdomains."""
    made = scenes.column(cell, 2, scenes.weight(cell, 0, 0, -20.0), degree=2)
    for parts in (1, [2] * scenes.dimension(cell)):
        solved = solve(made, parts, tolerance=1e-12)
        assert solved.summary["solution"]["max_contact_pressure"] > 10.0
        assert solved.accuracy.discretisation < 1e-8


def test_zero_where_two_bodies_share_a_constant_stress() -> None:
    solved = solve(stack("hexahedron", "tetrahedron", (2, 3)), [2, 1, 2], tolerance=1e-12)
    assert solved.summary["solution"]["max_contact_pressure"] == pytest.approx(10.0)
    assert solved.accuracy.discretisation < 1e-9


@pytest.mark.parametrize("cell", CELLS)
def test_bodies_of_different_degree_have_one_estimate_in_any_unit_of_length(cell: str) -> None:
    """At vertices with few cells, a body of degree 1 has no quadratic part to fit."""
    estimates = []
    for unit in (1.0, 1024.0):
        made = stack(cell, cell, (2, 3))
        made["bodies"][1]["degree"] = 2
        made["conditions"][1] = {"in": "upper", "force": scenes.vector(cell, 0, 0, -20 / unit)}
        for body in made["bodies"]:
            box = body["mesh"]["box"]
            box["lower"], box["upper"] = ([unit * x for x in box[k]] for k in ("lower", "upper"))
        estimates.append(solve(made, tolerance=1e-11).accuracy.discretisation)
    assert estimates[0] > 0.01
    assert estimates[1] == pytest.approx(estimates[0], rel=1e-6)


def test_zero_where_nothing_is_strained() -> None:
    """A body that is only moved has no energy to refer to."""
    cell = "hexahedron"
    moved = {"on": "block.z-", "displacement": [0.1, 0.2, 0.3]}
    solved = solve(scenes.config(cell, [scenes.block(cell, 3)], [moved], []), [2, 1, 1])
    assert set(solved.accuracy.as_dict().values()) == {0.0}


QUADRATIC = [(cell, "quadratic wall") for cell in CELLS]


@pytest.mark.parametrize(("cell", "name"), [*covering(CELLS, ["wall", "sphere"]), *QUADRATIC])
def test_independent_of_the_decomposition(name: str, cell: str) -> None:
    quadratic = name == "quadratic wall"
    made = scenes.quadratic(scenes.wall(cell, 3)) if quadratic else scenes.ALL[name](cell, 4)
    whole = solve(made, 1, tolerance=1e-11).accuracy.discretisation
    assert 0.02 < whole < 1.0
    d = scenes.dimension(cell)
    for parts in ([2, 1, 2][:d], *([4] if quadratic else [[3] * d, 5])):
        found = solve(made, parts, tolerance=1e-11).accuracy.discretisation
        assert found == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize("cell", ["hexahedron", "triangle"])
def test_algebraic_error_bounds_the_distance_from_the_exact_answer(cell: str) -> None:
    """With a loose tolerance the total error grows at most by the bound."""
    made = scenes.ALL["wall"](cell, 6)
    fine, loose = (solve(made, 4, tolerance=t) for t in (1e-11, 3e-2))
    energy = [s.summary["solution"]["energy"] for s in (fine, loose)]
    assert 0.0 <= energy[1] - energy[0]
    norm = np.sqrt(2 * abs(energy[0]))
    assert np.sqrt(2 * (energy[1] - energy[0])) / norm <= loose.accuracy.algebraic * 1.01
    assert loose.accuracy.algebraic > 10 * fine.accuracy.algebraic
    assert loose.accuracy.total == pytest.approx(
        np.hypot(loose.accuracy.discretisation, loose.accuracy.algebraic)
    )
