"""Friction at rigid bodies: held, pressed, pushed by forces, and turned."""

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

import contact_app
from contact_app.errors import NoEquilibriumError
from contact_app.run import solve as solving
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.comparison import solve
from tests.rows import covering
from tests.stability.increments import changes

CELLS = ("quadrilateral", "tetrahedron")
LAWS = ({"coulomb": 0.3}, {"tresca": 8.0})
Law = dict[str, float]


def top(cell: str) -> scenes.Config:
    """A plane above the block, which points down."""
    d = scenes.dimension(cell)
    return {"plane": {"point": [0.0] * (d - 1) + [1.0], "normal": [0.0] * (d - 1) + [-1.0]}}


def under_a_plate(
    cell: str, law: Law, conditions: list[scenes.Config], degree: int = 1
) -> scenes.Config:
    """A block, clamped at its foot, under a rigid plate."""
    block = {**scenes.block(cell, 3), "degree": degree}
    foot = scenes.clamp(cell, f"block.{scenes.down(cell)}")
    contact = {"on": f"block.{scenes.up(cell)}", "against": "plate", "friction": law}
    plate = {"name": "plate", "rigid": top(cell)}
    return scenes.config(cell, [block, plate], [foot, *conditions], [contact])


def plate(cell: str, displacement: list[float | None], **load: Any) -> list[scenes.Config]:
    """Conditions of a plate that does not turn."""
    rotation: Any = [0.0, 0.0, 0.0] if scenes.dimension(cell) == 3 else 0.0
    held = {"in": "plate", "displacement": displacement, "rotation": rotation}
    return [held, *([{"in": "plate", **load}] if load else [])]


@cache
def reference(cell: str, law: tuple[str, float], degree: int) -> Any:
    """The block pressed against a fixed obstacle by its foot, which goes the other way."""
    block = {**scenes.block(cell, 3), "degree": degree}
    foot = scenes.vector(cell, -0.03, -0.01, 0.04)
    contact = {
        "on": f"block.{scenes.up(cell)}", "obstacle": top(cell), "friction": dict([law]),
    }  # fmt: skip
    made = scenes.config(
        cell, [block], [{"on": f"block.{scenes.down(cell)}", "displacement": foot}], [contact]
    )
    return solve(made, 1)


@pytest.mark.parametrize(
    ("law", "cell", "degree", "method"), covering(LAWS, CELLS, [1, 2], ["active-set", "primal"])
)
def test_a_plate_that_moves_is_a_foot_that_moves_back(
    cell: str, law: Law, degree: int, method: str
) -> None:
    """Held, and pressed by the force that this takes."""
    known = reference(cell, next(iter(law.items())), degree).summary
    force, moved = known["contacts"][0]["force"], scenes.vector(cell, 0.03, 0.01, -0.04)
    d = len(moved)
    pressed = [0.0] * (d - 1) + [force[d - 1]]
    held = plate(cell, [*moved])
    loaded = plate(cell, [*moved[:-1], None], total_force=pressed)
    for conditions in (held, loaded):
        made = under_a_plate(cell, law, conditions, degree)
        found = solve(made, None, method=method).summary
        assert found["certificate"]["passed"]
        assert found["solver"]["method"] == method
        np.testing.assert_allclose(found["contacts"][0]["force"], force, rtol=0, atol=1e-5)
        assert found["contacts"][0]["nodes"] == known["contacts"][0]["nodes"]
        work = known["solution"]["dissipated_work"]
        assert found["solution"]["dissipated_work"] == pytest.approx(work, rel=1e-6)
        assert found["rigid_bodies"]["plate"]["displacement"] == pytest.approx(moved, rel=1e-6)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("method", ["active-set", "primal"])
def test_friction_alone_holds_a_plate_up_to_its_limit(cell: str, method: str) -> None:
    """Pushed in any direction by 0.99 of μ times the press; at 1.01 it slides away."""
    d = scenes.dimension(cell)
    along = np.array([1.0] if d == 2 else [0.6, 0.8])
    for share in (0.99, 1.01):
        load = [*(share * 0.3 * 40.0 * along), -40.0]
        made = under_a_plate(
            cell, {"coulomb": 0.3}, plate(cell, [None] * d, total_force=[float(f) for f in load])
        )
        if share > 1.0:
            with pytest.raises(NoEquilibriumError, match="plate"):
                solve(made, None, method=method)
        else:
            found = solve(made, None, method=method).summary
            assert found["certificate"]["passed"]
            np.testing.assert_allclose(
                found["contacts"][0]["force"][:d], load, rtol=0, atol=1e-6 * 40.0
            )


def roller(moment: float) -> scenes.Config:
    """A rigid roller pressed into a block and turned by a moment, which friction carries."""
    block = scenes.block("quadrilateral", 8)
    circle = {"sphere": {"center": [0.5, 3.0], "radius": 2.0}}
    conditions = [
        scenes.clamp("quadrilateral", "block.y-"),
        {"in": "roller", "displacement": [0.0, None]},
        {"in": "roller", "total_force": [0.0, -30.0], "total_moment": moment},
    ]
    contact = {"on": "block.y+", "against": "roller", "friction": {"coulomb": 0.3}}
    rigid = {"name": "roller", "rigid": circle}
    return scenes.config("quadrilateral", [block, rigid], conditions, [contact])


@pytest.mark.parametrize("method", ["active-set", "primal"])
def test_a_roller_turns_until_friction_carries_its_moment(method: str) -> None:
    found = solve(roller(-9.0), None, method=method).summary
    assert found["certificate"]["passed"]
    contact, sunk = found["contacts"][0], found["rigid_bodies"]["roller"]["displacement"][1]
    force, arm = np.array(contact["force"]), np.array(contact["point"]) - [0.5, 3.0 + sunk, 0.0]
    assert force[1] == pytest.approx(-30.0, rel=1e-6)
    about_center = contact["moment"] + arm[0] * force[1] - arm[1] * force[0]
    assert about_center == pytest.approx(-9.0, rel=1e-5)
    assert abs(found["rigid_bodies"]["roller"]["rotation"]) > 1e-5
    with pytest.raises(NoEquilibriumError, match="roller"):
        solve(roller(-25.0), None, method=method)


def history(made: scenes.Config, steps: list[scenes.Config]) -> list[Any]:
    """Records of a history, all certified."""
    answer = contact_app.solve({**made, "steps": steps})
    assert answer.converged
    return list(answer.summary["steps"])


def test_a_plate_that_slides_in_a_history_is_reported_with_the_factor() -> None:
    """The push is 1.5 times what friction holds: the halves of the increment enclose 2/3."""
    cell = "quadrilateral"
    press = plate(cell, [None, None], total_force=[0.0, -40.0])
    push = {"name": "push", "in": "plate", "total_force": [1.5 * 0.3 * 40.0, 0.0]}
    made = under_a_plate(cell, {"coulomb": 0.3}, [*press, push])
    with pytest.raises(NoEquilibriumError) as refused:
        contact_app.solve({**made, "steps": [{"push": 0}, {"push": 1}]})
    said = re.search(
        r"step 2, between its factors (\S+) and (\S+): .* stops plate .* along \+x",
        str(refused.value),
    )
    assert said is not None, refused.value
    assert float(said[1]) < 2.0 / 3.0 < float(said[2]) <= float(said[1]) + 1.0 / 16.0 + 1e-4


def agree(some: list[Any], others: list[Any]) -> None:
    """Contact forces and the work that friction takes are the same in each increment."""
    for one, other in zip(some, others, strict=True):
        forces = [record["contacts"][0]["force"] for record in (one, other)]
        np.testing.assert_allclose(*forces, rtol=0, atol=1e-5)
        lost = [record["solution"]["dissipated_work"] for record in (one, other)]
        assert lost[0] == pytest.approx(lost[1], abs=1e-6)
    assert others[-1]["contacts"][0]["nodes"]["slip"] > 0
    assert lost[1] > 1.01 * others[0]["solution"]["dissipated_work"]


@pytest.mark.parametrize(("cell", "method"), [(CELLS[0], "active-set"), (CELLS[1], "primal")])
def test_a_history_of_a_plate_is_that_of_a_foot(cell: str, method: str) -> None:
    """Pressed and pushed to and fro, beside a fixed obstacle and a foot that goes the other way."""
    moved = {"push": scenes.vector(cell, 0.03, 0.01, None),
             "press": scenes.vector(cell, None, None, -0.04)}  # fmt: skip
    back = [
        {"name": name, "on": f"block.{scenes.down(cell)}",
         "displacement": [None if x is None else -x for x in to]}
        for name, to in moved.items()
    ]  # fmt: skip
    law = {"coulomb": 0.3}
    fixed = {"on": f"block.{scenes.up(cell)}", "obstacle": top(cell), "friction": law}
    steps = [{"press": 1}, {"push": 1, "increments": 2}, {"push": -0.5, "increments": 2}]
    known = history(scenes.config(cell, [scenes.block(cell, 3)], back, [fixed]), steps)
    rotation: Any = [0.0] * 3 if scenes.dimension(cell) == 3 else 0.0
    held = [{"name": name, "in": "plate", "displacement": to} for name, to in moved.items()]
    made = under_a_plate(cell, law, [{**held[0], "rotation": rotation}, held[1]])
    made["solver"]["method"] = method
    agree(history(made, steps), known)


def test_a_history_of_a_plate_that_sinks_is_that_of_one_held_there() -> None:
    push = {"name": "push", "in": "plate", "displacement": [0.03, None], "rotation": 0.0}
    press = {"name": "press", "in": "plate", "total_force": [0.0, -40.0]}
    free = under_a_plate("quadrilateral", {"coulomb": 0.3}, [push, press])
    found = history(free, [{"press": 1}, {"push": 1}, {"push": -0.5}])
    lower = {"name": "lower", "in": "plate", "displacement": [None, 1.0]}
    held = under_a_plate("quadrilateral", {"coulomb": 0.3}, [push, lower])
    heights = [record["rigid_bodies"]["plate"]["displacement"][1] for record in found]
    pushes = (0.0, 1.0, -0.5)
    steps = [{"push": p, "lower": height} for p, height in zip(pushes, heights, strict=True)]
    agree(found, history(held, steps))


@pytest.mark.parametrize("method", ["active-set", "primal"])
def test_the_other_method_goes_on_from_the_place_of_a_rigid_body(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """Slip is measured from there. Such histories ended where one method failed."""
    held = plate("quadrilateral", [None, None])
    push = {"name": "push", "in": "plate", "total_force": [9.0, 0.0]}
    press = {"name": "press", "in": "plate", "total_force": [0.0, -40.0]}
    made = under_a_plate("quadrilateral", {"coulomb": 0.3}, [*held, push, press])
    made["solver"]["method"] = method
    steps = [{"press": 1}, {"push": 0.5}, {"push": 1}, {"push": -0.5}]
    known, by = history(made, steps), solving.solve

    def fails_when_pushed(problem: DualProblem, *rest: Any) -> Solution:
        slips = np.abs(problem.c[problem.tangential]).max(initial=0.0)
        if problem.factored == (method == "active-set") and slips > 2e-3:
            raise ArithmeticError("no digit is right")
        return by(problem, *rest)

    monkeypatch.setattr(solving, "solve", fails_when_pushed)
    found = [record for record in history(made, steps) if record["factor"] == 1.0]
    assert {record["solver"]["method"] for record in found} == {"active-set", "primal"}
    for one, other in zip(found, known, strict=True):
        places = [r["rigid_bodies"]["plate"]["displacement"] for r in (one, other)]
        assert places[0] == pytest.approx(places[1], rel=1e-3)


@pytest.mark.parametrize("free", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_coarse_increments_cause_a_warning_with_their_changes(free: bool) -> None:
    """The changes in the warning are those of two increments, also where a held plate closes."""
    move = {"name": "move", "in": "plate", "displacement": [0.03, -0.047], "rotation": 0.0}
    made = under_a_plate("quadrilateral", {"coulomb": 0.3}, [move])
    plane = made["bodies"][1]["rigid"]["plane"]
    plane["point"][1] = 1.02
    if free:
        plane["point"][1], plane["normal"] = 1.0, [0.02, -1.0]
        move["displacement"] = [0.03, None]
        press = {"name": "press", "in": "plate", "total_force": [0.0, -40.0]}
        made["conditions"].append(press)
    one, two = (
        contact_app.solve({**made, "steps": [{"move": 1, **({"press": 1} if free else {}),
                                              "increments": n}]})
        for n in (1, 2)
    )  # fmt: skip
    assert one.converged
    assert two.converged
    for answer, other, share in ((one, two, 1.0), (two, one, 0.5)):
        (said,) = [w for w in answer.summary["certificate"]["warnings"] if "halving" in w]
        told = [float(x) for x in re.findall(r"([\d.e+]+) % of", said)]
        known = changes(answer.increments[-1].solved, other.increments[-1].solved)
        assert told == pytest.approx([100.0 * share * x for x in known], rel=0.06, abs=0.1), said
