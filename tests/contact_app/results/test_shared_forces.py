"""Nodes that rest in several contacts, whose force may be divided in several ways."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.results.shared_forces import SharedNode
from contact_app.run.increments import SolvedIncrement, solved_increments
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.comparison import solve
from tests.stability.friction_scenes import history_scene

X, Y, Z = np.eye(3)

EDGE = SharedNode(
    sources=np.array([0, 1]),
    normals=np.stack([Z, -X]),
    normal_forces=np.array([10.0, 2.0]),
    tangents=np.stack([[X, Y], [Y, Z]]),
    friction=np.zeros((2, 2)),
    coefficients=np.array([0.3, 0.0]),
    limits=np.zeros(2),
    presses=np.array([True, True]),
    rests=np.array([True, False]),
)
"""A node that rests on a rough floor and presses a smooth wall."""


def test_friction_of_the_floor_replaces_the_normal_force_of_the_wall() -> None:
    """The wall carries 2 - t_x with |t_x| ≤ 3: between 0 and 5. Nothing else carries along z."""
    assert EDGE.ranges() == pytest.approx([0.0, 5.0])


def test_friction_along_the_edge_leaves_less_for_the_division() -> None:
    along = replace(EDGE, friction=np.array([[0.0, np.sqrt(5.0)], [0.0, 0.0]]))
    assert along.ranges() == pytest.approx([0.0, 4.0])


def test_two_rough_surfaces_hold_each_other() -> None:
    """Each may press more by what the friction of the other carries, and less by the same."""
    rough = replace(EDGE, rests=np.array([True, True]), coefficients=np.array([0.3, 0.3]))
    assert rough.ranges() == pytest.approx([2.0 * 0.3 * 2.0, 2.0 + 0.3 * 10.0])


def test_a_point_that_slides_on_the_floor_leaves_nothing_to_divide() -> None:
    assert (replace(EDGE, rests=np.zeros(2, bool)).ranges() == 0.0).all()


@pytest.mark.parametrize(("along", "wedged"), [(3.5, False), (3.7, True)])
def test_friction_across_an_edge_may_hold_a_node_that_could_slide(
    along: float, wedged: bool
) -> None:
    """Without friction across the edge the limit along it is 0.3 · (10 + 2) = 3.6."""
    node = replace(
        EDGE, rests=np.array([True, True]), coefficients=np.array([0.3, 0.3]),
        friction=np.array([[0.0, along], [0.0, 0.0]]),
    )  # fmt: skip
    assert node.is_wedged() == wedged


def test_a_tie_without_limit_moves_the_force_from_one_block_to_the_other() -> None:
    """A brick, first node, rests on two tied blocks, the others: either may carry all of it."""
    down = np.array([0.0, -1.0])
    none = np.zeros(2)
    node = SharedNode(
        sources=np.array([0, 1, 2]),
        normals=np.stack([np.concatenate(row) for row in
                          ([-down, down, none], [-down, none, down], [none, -down, down])]),
        normal_forces=np.array([10.0, 2.0, np.inf]),
        tangents=np.zeros((3, 1, 6)), friction=np.zeros((3, 1)),
        coefficients=np.zeros(3), limits=np.zeros(3),
        presses=np.ones(3, bool), rests=np.zeros(3, bool),
    )  # fmt: skip
    assert node.ranges() == pytest.approx([12.0, 12.0, 0.0])


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.7, 1.1])
def test_a_tie_against_a_contact_leaves_its_force_open(angle: float) -> None:
    """A node that is tied along the normal of a contact, and pressed across it by another one."""
    across, along = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    node = SharedNode(
        sources=np.array([0, 1, 2]), normals=np.stack([along, across, along]),
        normal_forces=np.array([10.0, 2.0, np.inf]),
        tangents=np.zeros((3, 1, 2)), friction=np.zeros((3, 1)),
        coefficients=np.zeros(3), limits=np.zeros(3),
        presses=np.ones(3, bool), rests=np.zeros(3, bool),
    )  # fmt: skip
    assert node.ranges() == pytest.approx([np.inf, 0.0, 0.0])


def _on_one_floor(cells: tuple[int, int], method: str) -> tuple[list[float], str]:
    """Vertical forces of two tied blocks on a floor without friction, and the warnings."""
    bodies = [scenes.block("quadrilateral", n, name, (k, 0, 0), (k + 1, 1, 1), 1e3 / (k + 1))
              for k, (n, name) in enumerate(zip(cells, "ab", strict=True))]  # fmt: skip
    loads = [*({"on": f"{name}.y+", "traction": [0.0, -20.0]} for name in "ab"),
             {"on": "a.x-", "displacement": [0.0, None]}]  # fmt: skip
    floor = {"plane": {"point": [0, 0], "normal": [0, 1]}}
    contacts = [{"on": "b.x-", "against": "a.x+", "tied": True},
                *({"on": f"{name}.y-", "obstacle": floor} for name in "ab")]  # fmt: skip
    made = scenes.config("quadrilateral", bodies, loads, contacts)
    answer = solve(made, method=method, tolerance=1e-9)
    assert answer.solution.certificate.passed
    records = answer.summary["contacts"][1:]
    warnings = answer.summary["certificate"]["warnings"]
    return [record["force"][1] for record in records], " ".join(
        w for w in warnings if "several" in w
    )


def test_a_tie_that_reaches_a_floor_shares_its_force() -> None:
    """Two nodes at one place press the floor: statics leave open which of them, and methods differ.

    If `on` has the coarser mesh, the row of the tie there has further nodes, off the floor.
    """
    (one, first), (other, second) = (_on_one_floor((4, 4), m) for m in ("active-set", "primal"))
    assert abs(other[0] / one[0] - 1.0) > 0.01
    for warning in (first, second):
        assert "contacts[1]: 2 nodes rest in several contacts, and a tie allows" in warning
        assert "so may the force of the tie" in warning
    (one, first), (other, second) = (_on_one_floor((5, 4), m) for m in ("active-set", "primal"))
    assert other == pytest.approx(one, rel=1e-5)
    assert first == second == ""


def _solved(subdomains: int) -> list[SolvedIncrement]:
    """A block that pushes over a floor with given limits into a wall with Coulomb friction."""
    scene = scenes.build(history_scene(300)[0], subdomains)
    return list(solved_increments(scene, MPI.COMM_WORLD, lambda place: None))


def test_two_certified_answers_warn_that_there_are_several() -> None:
    """A corner sticks to the floor, where it is open, and slides down the wall.

    Its force across the wall may be that of the wall or of the floor.
    """
    one, other = _solved(1), _solved(4)
    works = [found[-1].dissipated for found in (one, other)]
    assert abs(works[1] / works[0] - 1.0) > 1e-5
    for increment in (one[-1], other[-1]):
        certificate = increment.solved.summary["certificate"]
        assert certificate["passed"]
        told = [w for w in certificate["warnings"] if "rest in several contacts" in w]
        assert "contacts[1]" in [w.split(":")[0] for w in told]
        assert all("so may displacements" in w for w in told)


def brick_on_two(gap: float) -> scenes.Config:
    """Three bricks of matching meshes, the upper one on the joint of the others."""
    boxes = {"left": (-2.0 - gap, 0), "right": (0, 0), "upper": (-1, 1)}
    rough = {"coulomb": 0.4}
    return {
        "title": "three bricks", "dimension": 2,
        "bodies": [
            {"name": name, "material": {"young": 1e4, "poisson": 0.3},
             "mesh": {"box": {"lower": [x, y], "upper": [x + 2.0, y + 1.0], "cells": [4, 2]}}}
            for name, (x, y) in boxes.items()
        ],
        "conditions": [
            {"on": "left.y-", "displacement": [0, 0]},
            {"on": "right.y-", "displacement": [None if gap == 0.0 else 0, 0]},
            {"on": "right.x+", "total_force": [-3, 0]},
            {"on": "upper.y+", "total_force": [0.5, -6]},
        ],
        "contacts": [
            {"on": "right.x-", "against": "left.x+", "friction": rough},
            {"on": "upper.y-", "against": "left.y+", "friction": rough},
            {"on": "upper.y-", "against": "right.y+", "friction": rough},
        ],
        "solver": {"tolerance": 1e-9},
    }  # fmt: skip


def test_a_brick_on_two_others_may_share_its_friction_with_their_thrust() -> None:
    """Two methods give other forces of the joint at one energy, and the warning has the range."""
    answers = []
    for method in ("primal", "smalbe"):
        made = brick_on_two(0.0)
        made["solver"]["method"] = method
        answers.append(solve_scene(scenes.build(made), MPI.COMM_SELF).summary)
    one, other = answers
    assert one["solution"]["energy"] == pytest.approx(other["solution"]["energy"], rel=1e-8)
    thrust, other_thrust = (made["contacts"][0]["force"][0] for made in answers)
    warned = [w for w in one["certificate"]["warnings"] if "rest in several contacts" in w]
    (text,) = (w for w in warned if w.startswith("contacts[0]: 2 nodes"))
    share = float(text.split("may differ by ")[1].split(" %")[0]) / 100.0
    assert 0.02 < abs(thrust / other_thrust - 1.0) < share < 0.5


def test_bricks_that_do_not_meet_share_no_force() -> None:
    made = brick_on_two(0.5)
    summary = solve_scene(scenes.build(made), MPI.COMM_SELF).summary
    assert summary["certificate"]["passed"]
    assert not any("several contacts" in w for w in summary["certificate"]["warnings"])
