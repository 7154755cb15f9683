"""Interference of a contact: an overlap along the normal beside that of the geometry."""

import pytest

from contact_app.errors import ConfigurationError
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from tests import reference, scenes
from tests.comparison import same_displacement, solve

DEPTH = 0.01


def squeezed(cell: str, overlap: float, interference: float, degree: int = 1) -> scenes.Config:
    """A block on a floor that its load presses on, beside a wall that overlaps it."""
    block = {**scenes.block(cell, 3), "degree": degree}
    wall = scenes.plane(cell, (1.0 - overlap, 0, 0), (-1, 0, 0))
    return scenes.config(
        cell,
        [block],
        [scenes.clamp(cell, "block.x-"), {"on": f"block.{scenes.up(cell)}", "pressure": 5.0}],
        [
            {"on": "block.x+", "obstacle": wall, "interference": interference},
            {
                "on": f"block.{scenes.down(cell)}",
                "obstacle": scenes.plane(cell, (0, 0, -0.002), (0, 0, 1)),
            },
        ],
    )


@pytest.mark.parametrize(
    ("cell", "degree"), [("quadrilateral", 1), ("hexahedron", 1), ("tetrahedron", 2)]
)
def test_a_wall_with_interference_is_a_wall_that_overlaps(cell: str, degree: int) -> None:
    """A clearance takes off an overlap what an interference adds to it."""
    moved = solve(squeezed(cell, DEPTH, 0.0, degree), 3)
    for overlap, interference in ((0.0, DEPTH), (2.0 * DEPTH, -DEPTH)):
        pressed = solve(squeezed(cell, overlap, interference, degree), 3)
        assert pressed.summary["certificate"]["passed"]
        expected, found = moved.summary, pressed.summary
        for key in ("energy", "max_contact_pressure", "active_contacts"):
            assert found["solution"][key] == pytest.approx(expected["solution"][key], rel=1e-7)
        for ours, theirs in zip(found["contacts"], expected["contacts"], strict=True):
            assert ours["force"] == pytest.approx(theirs["force"], rel=1e-6, abs=1e-6)
        assert expected["contacts"][0]["force"][0] < -1.0


def stacked(cell: str, gap: float, interference: float) -> scenes.Config:
    """A block under a block whose mesh does not match, between a floor and a held top."""
    up, down = scenes.up(cell), scenes.down(cell)
    upper = scenes.block(cell, 3, "upper", (0, 0, 1 + gap), (1, 1, 2 + gap))
    return scenes.config(
        cell,
        [scenes.block(cell, 4, "lower"), upper],
        [scenes.clamp(cell, f"lower.{down}"), scenes.clamp(cell, f"upper.{up}")],
        [{"on": f"upper.{down}", "against": f"lower.{up}", "interference": interference}],
    )


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_a_pair_with_interference_is_a_pair_that_overlaps(cell: str) -> None:
    """Also against the undecomposed reference."""
    moved, pressed = (solve(stacked(cell, *g), 3) for g in ((-DEPTH, 0.0), (0.001, DEPTH + 0.001)))
    for key in ("energy", "max_contact_pressure", "active_contacts"):
        expected = moved.summary["solution"][key]
        assert pressed.summary["solution"][key] == pytest.approx(expected, rel=1e-7)
    known = reference.solve(scenes.build(stacked(cell, 0.001, DEPTH + 0.001)))
    same_displacement(known, pressed)


def test_interference_alone_is_a_load() -> None:
    made = stacked("quadrilateral", 0.0, 0.0)
    with pytest.raises(ConfigurationError, match="load nothing: .* an interference"):
        build_scene(from_mapping(made))
    made["contacts"][0]["interference"] = DEPTH
    build_scene(from_mapping(made))


def test_interference_is_no_text() -> None:
    made = stacked("quadrilateral", 0.0, 0.0)
    made["contacts"][0]["interference"] = "tight"
    with pytest.raises(ConfigurationError, match=r"contacts\[0\].interference is 'tight'; a num"):
        build_scene(from_mapping(made))


def test_symmetry_keeps_interference() -> None:
    """Walls on either side mirror where their interferences do."""
    made = scenes.config(
        "quadrilateral",
        [scenes.block("quadrilateral", 4)],
        [{"on": "block.y-", "displacement": [None, 0.0]}],
        [
            {"on": f"block.{side}", "interference": DEPTH,
             "obstacle": scenes.plane("quadrilateral", (x, 0, 0), (n, 0, 0))}
            for side, x, n in (("x-", 0, 1), ("x+", 1, -1))
        ],
    )  # fmt: skip
    whole = solve(made)
    half = solve_scene(halved(scenes.build(made)).scene)
    assert half.model.scene.mirrors
    assert half.summary["solution"]["energy"] == pytest.approx(whole.summary["solution"]["energy"])
    made["contacts"][0]["interference"] = 0.5 * DEPTH
    assert not halved(scenes.build(made)).scene.mirrors
