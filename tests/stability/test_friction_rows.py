"""Frictional scenes on which methods fail: certified, or refused where nothing holds the body."""

from typing import Any

import pytest

import contact_app
from contact_app.errors import NoEquilibriumError
from tests import scenes

SQUARE = "quadrilateral"
PRESS, TOP = 10.0, 2.0


def floor(cell: str = SQUARE, **law: float) -> scenes.Config:
    plane = scenes.plane(cell, (0, 0, 0), (0, 0, 1))
    return {"on": f"block.{scenes.down(cell)}", "obstacle": plane, "friction": law}


def floating(push: float, mu: float) -> scenes.Config:
    """A block that friction alone holds: pressed and pushed, statics ask for push < μ PRESS."""
    load = {"on": "block.y+", "traction": [push, -PRESS]}
    block = scenes.block(SQUARE, 4, upper=(TOP, 1, 0.2))
    return scenes.config(SQUARE, [block], [load], [floor(coulomb=mu)])


def held(mu: float, push: float = 30.0) -> scenes.Config:
    """A block held at one side, on a floor."""
    conditions = [scenes.clamp(SQUARE, "block.x-"), {"on": "block.y+", "traction": [push, -60.0]}]
    return scenes.config(SQUARE, [scenes.block(SQUARE, 4)], conditions, [floor(coulomb=mu)])


def cornered(cell: str, n: int = 3) -> scenes.Config:
    """Nodes of an edge in two frictional planes."""
    wall = scenes.plane(cell, (1, 0, 0), (-1, 0, 0))
    contacts = [floor(cell, coulomb=0.3), {"on": "block.x+", "obstacle": wall}]
    contacts[1]["friction"] = {"coulomb": 0.4}
    conditions = [
        scenes.clamp(cell, "block.x-"),
        {"on": f"block.{scenes.up(cell)}", "traction": scenes.vector(cell, 30.0, 10.0, -60.0)},
    ]
    return scenes.config(cell, [scenes.block(cell, n)], conditions, contacts)


def edge() -> scenes.Config:
    """A tilted floor below a cube: one edge touches."""
    cell = "hexahedron"
    plane = scenes.plane(cell, (1, 0, 0), (-0.2, 0, 1))
    contact = {"on": "block.z-", "obstacle": plane, "friction": {"coulomb": 0.5}}
    moved = {"on": "block.z+", "displacement": [0.01, 0.005, -0.02]}
    return scenes.config(cell, [scenes.block(cell, 3)], [moved], [contact])


def alternating() -> scenes.Config:
    """Slip to and fro."""
    made = held(0.3)
    made["conditions"] = [
        {"name": "press", "on": "block.y+", "displacement": [None, -0.01]},
        {"name": "push", "on": "block.y+", "displacement": [0.02, None]},
    ]
    steps = [{"press": 1}, {"push": 1}, {"push": -1}, {"push": 1}, {"push": 0}]
    return {**made, "steps": steps}


@pytest.mark.parametrize(
    "made",
    [
        pytest.param(held(1.0), id="μ is one"),
        pytest.param(floating(0.999 * 0.4 * PRESS, 0.4), id="onset of sliding, held by friction"),
        pytest.param(floating(0.1, 0.4), id="a floating body kept by friction"),
        pytest.param(cornered(SQUARE), id="a node in two frictional planes"),
        pytest.param(cornered("hexahedron"), id="nodes of an edge in two frictional planes"),
        pytest.param(edge(), id="an edge in contact"),
    ],
)
def test_is_certified(made: scenes.Config) -> None:
    answer = contact_app.solve(made)
    assert answer.certificate.passed, answer.certificate
    contact: dict[str, Any] = answer.summary["contacts"][0]
    assert contact["nodes"]["stick"] + contact["nodes"]["slip"] > 0


@pytest.mark.slow
def test_alternating_slip_is_certified_in_every_increment() -> None:
    steps = contact_app.solve(alternating()).summary["steps"]
    assert len(steps) == 5
    assert all(step["certificate"]["passed"] for step in steps)
    along = [step["contacts"][0]["force"][0] for step in steps]
    assert along[1] < 0.0 < along[2]
    assert along[3] < 0.0


def test_just_above_the_onset_of_sliding_is_refused() -> None:
    with pytest.raises(NoEquilibriumError, match=r"along \+x"):
        contact_app.solve(floating(1.001 * 0.4 * PRESS, 0.4))


def test_without_friction_a_coefficient_of_zero_is_none() -> None:
    rough, smooth = held(0.0), held(0.0)
    del smooth["contacts"][0]["friction"]
    energies = [contact_app.solve(m).summary["solution"]["energy"] for m in (rough, smooth)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-6)


@pytest.mark.ratchet
def test_an_edge_in_two_frictional_planes_takes_few_applications() -> None:
    """Directions of slip that lagged behind its state took 10,125, by SMALBE-M in the end."""
    made = cornered("hexahedron", 4) | {"decomposition": {"subdomains": [2, 2, 2]}}
    answer = contact_app.solve(made)
    assert answer.certificate.passed
    assert answer.summary["solver"]["hessian_multiplications"] <= 100
