"""Section forces against statics, on every cell, decomposition and half of a scene."""

import copy
from typing import Any

import numpy as np
import pytest

import contact_app
from contact_app.errors import ConfigurationError
from tests import scenes
from tests.rows import covering

CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
PULL, WEIGHT, LENGTH = np.array([1.5, 0.7, -1.0]), np.array([0.1, 0.2, 0.3]), 4.0


def plane(point: list[float], normal: list[float], body: str = "b") -> dict[str, Any]:
    return {"in": body, "plane": {"point": point, "normal": normal}}


def cantilever(cell: str, degree: int, at: dict[str, float]) -> scenes.Config:
    """Clamped at x = 0, pulled at its end, with a weight; sections across x by name."""
    d = scenes.dimension(cell)
    middle = [0.5] * (d - 1)
    upper, cells = [LENGTH, 1, 1][:d], [8, 2, 2][:d]
    return {
        "dimension": d,
        "bodies": [scenes.box("b", upper, cells, cell=cell, degree=degree)],
        "conditions": [
            {"on": "b.x-", "displacement": [0] * d},
            {"on": "b.x+", "traction": PULL[:d].tolist()},
            {"in": "b", "force": WEIGHT[:d].tolist()},
        ],
        "solver": {"tolerance": 1e-12},
        "output": {"sections": {
            name: plane([x, *middle], [2, *[0] * (d - 1)]) for name, x in at.items()
        }},
    }  # fmt: skip


def sections(made: scenes.Config, **changes: Any) -> dict[str, Any]:
    found: dict[str, Any] = contact_app.solve({**made, **changes}).summary["sections"]
    return found


@pytest.mark.parametrize(
    ("subdomains", "degree", "cell"), covering([1, 3], [1, 2], CELLS, together=2)
)
def test_a_cantilever(cell: str, degree: int, subdomains: int) -> None:
    """The part beyond the section pulls at it, with its weight."""
    made = cantilever(cell, degree, {"root": 0.5, "middle": 2.0})
    d = scenes.dimension(cell)
    for name, found in sections(made, decomposition={"subdomains": subdomains}).items():
        rest = LENGTH - {"root": 0.5, "middle": 2.0}[name]
        pull, weight = PULL.copy(), WEIGHT.copy()
        pull[d:] = weight[d:] = 0.0
        force = pull + rest * weight
        moment = np.cross([rest, 0, 0], pull) + np.cross([0.5 * rest, 0, 0], rest * weight)
        np.testing.assert_allclose(found["force"], force, atol=1e-8)
        np.testing.assert_allclose(found["moment"], moment[2] if d == 2 else moment, atol=1e-8)
        assert found["area"] == pytest.approx(1.0, abs=1e-12)
        point = [LENGTH - rest, 0.5, 0.5 if d == 3 else 0.0]
        np.testing.assert_allclose(found["point"], point, atol=1e-12)


def test_heat_has_no_resultant() -> None:
    """A warm cantilever, the plane through cells whose loads by heat are on both sides."""
    made = cantilever("hexahedron", 1, {"cut": 1.3})
    made["bodies"][0]["material"]["expansion"] = 1e-3
    made["conditions"] = [*made["conditions"][:2], {"in": "b", "temperature": "20*x + y"}]
    found = sections(made)["cut"]
    np.testing.assert_allclose(found["force"], PULL, atol=1e-8)
    np.testing.assert_allclose(found["moment"], np.cross([LENGTH - 1.3, 0, 0], PULL), atol=1e-8)


@pytest.mark.parametrize("cell", CELLS)
def test_a_plane_through_cells_that_carry_no_load(cell: str) -> None:
    """Oblique through distorted cells from a file: force and moment are those of the end load."""
    d = scenes.dimension(cell)
    made = cantilever(cell, 1, {})
    made["conditions"] = made["conditions"][:2]
    made["output"] = {"sections": {"cut": plane([1.3, 0.4, 0.6][:d], [1, 0.3, -0.2][:d])}}
    found = sections(made)["cut"]
    pull = np.array([*PULL[:d], *[0.0] * (3 - d)])
    arm = np.array([LENGTH, 0.5, 0.5 if d == 3 else 0.0]) - found["point"]
    moment = np.cross(arm, pull)
    np.testing.assert_allclose(found["force"], pull, atol=1e-8)
    np.testing.assert_allclose(found["moment"], moment[2] if d == 2 else moment, atol=1e-8)
    normal = np.array([1, 0.3, -0.2])[:d]
    assert found["area"] == pytest.approx(np.linalg.norm(normal), rel=1e-9)


def pressed_halves() -> scenes.Config:
    """Two blocks beside each other on a floor under a plate that loads both, alike about x = 2."""
    return {
        "dimension": 3,
        "bodies": [
            scenes.box("plate", [4, 1, 2], [8, 2, 2], [0, 0, 1]),
            scenes.box("left", [1, 1, 1], [2, 2, 2]),
            scenes.box("right", [4, 1, 1], [2, 2, 2], [3, 0, 0]),
        ],
        "conditions": [
            {"on": "plate.z+", "traction": [0, 0, -1]},
            {"in": "plate", "force": [0, 0, -0.2]},
            *({"on": f"{name}.z-", "displacement": [0, 0, 0]} for name in ("left", "right")),
        ],
        "contacts": [
            {"on": f"{name}.z+", "against": "plate.z-"} for name in ("left", "right")
        ],
        "solver": {"tolerance": 1e-11},
        "output": {"sections": {
            "left": plane([0, 0, 0.5], [0, 0, 1], "left"),
            "right": plane([3.5, 0.5, 0.5], [0.1, 0.05, 1], "right"),
            "quarter": plane([1.5, 0, 0], [1, 0, 0], "plate"),
            "middle": plane([2, 0, 0], [1, 0, 0], "plate"),
            "oblique": plane([2, 0.5, 1.5], [1, 0.4, 0.7], "plate"),
        }},
    }  # fmt: skip


def test_a_symmetric_half_has_the_section_forces_of_the_whole() -> None:
    """Also where the plane is that of the symmetry, oblique, or in a body that is left out."""
    made = pressed_halves()
    whole, part = (contact_app.solve({**made, "symmetry": s}) for s in ("none", "allow"))
    assert part.summary["symmetry"]["images"] == 4
    assert set(part.summary["sections"]) == set(whole.summary["sections"]) == {
        "left", "right", "quarter", "middle", "oblique"
    }  # fmt: skip
    for name, found in part.summary["sections"].items():
        known = whole.summary["sections"][name]
        for key in ("force", "moment", "point", "area"):
            np.testing.assert_allclose(found[key], known[key], atol=1e-7, err_msg=f"{name} {key}")
    assert whole.summary["sections"]["right"]["force"][2] == pytest.approx(-2.4, rel=1e-7)
    moment = whole.summary["sections"]["middle"]["moment"]
    assert abs(moment[1]) > 0.1  # the plate bends


def test_the_sides_push_each_other_alike_also_through_contact_and_support() -> None:
    """Up and down through a block on a floor, loaded above: nodes of the cut touch the floor."""
    made = copy.deepcopy(cantilever("hexahedron", 1, {}))
    made["conditions"] = [
        {"on": "b.x-", "displacement": [0, 0, 0]}, {"on": "b.z+", "pressure": 5.0}
    ]  # fmt: skip
    floor = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}
    made["contacts"] = [{"on": "b.z-", "obstacle": floor}]
    made["output"]["sections"] = {
        "forth": plane([2, 0, 0], [1, 0, 0]), "back": plane([2, 0, 0], [-1, 0, 0])
    }  # fmt: skip
    answer = contact_app.solve(made)
    forth, back = (answer.summary["sections"][name] for name in ("forth", "back"))
    np.testing.assert_allclose(forth["force"], -np.array(back["force"]), atol=1e-8)
    np.testing.assert_allclose(forth["moment"], -np.array(back["moment"]), atol=1e-8)
    # far from the clamp all is carried straight down
    assert forth["force"] == pytest.approx([0, 0, 0], abs=0.1)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (plane([5, 0, 0], [1, 0, 0]), r"sections\.s: .*all cells of b lie behind the plane"),
        (plane([-1, 0, 0], [1, 0, 0]), r"sections\.s: .*lie in front of the plane"),
        (plane([4, 0, 0], [1, 0, 0]), "at least half a cell from its end"),
        (plane([1, 0, 0], [1, 0, 0], "c"), r"sections\.s\.in is c; the bodies are b"),
        (plane([1, 0, 0], [0, 0, 0]), r"sections\.s\.plane\.normal is zero"),
        (plane([1, 0], [1, 0, 0]), r"sections\.s\.plane\.point has 2 components"),
        ({"plane": {"point": [1, 0, 0], "normal": [1, 0, 0]}}, r"sections\.s\.in"),
        ({"in": "b"}, r"sections\.s\.plane"),
        ({"on": "b.x-", "behind": [0, 0, 0]}, r"s\.on names .* 'x-' of b; it is on the surface"),
    ],
)
def test_wrong_sections_are_refused(section: dict[str, Any], message: str) -> None:
    made = cantilever("hexahedron", 1, {})
    made["output"] = {"sections": {"s": section}}
    with pytest.raises(ConfigurationError, match=message):
        contact_app.solve(made)
