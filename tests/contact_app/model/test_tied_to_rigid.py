"""Boundaries tied to rigid bodies: against the theory of beams, and what is refused."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.scene.yaml_reader import parse
from tests import scenes
from tests.comparison import solve
from tests.scenes_on_ranks import summary_of

LENGTH, YOUNG = 8.0, 1000.0
METHODS = ("auto", "primal", "smalbe")


def bar(*loads: scenes.Config, cells: tuple[int, ...] = (6, 2, 2), **material: float) -> Any:
    """A bar of a square section of one, held at one end, with a rigid body at the other."""
    d = len(cells)
    middle = [0.5] * (d - 1)
    held = {"on": "bar.x-", "displacement": [0.0] * d}
    mesh = {"box": {"lower": [0] * d, "upper": [LENGTH, *[1] * (d - 1)], "cells": list(cells)}}
    elastic = {"name": "bar", "mesh": mesh, "degree": 2,
               "material": {"young": YOUNG, "poisson": 0.0, **material}}  # fmt: skip
    plane = {"point": [LENGTH, *middle], "normal": [-1.0, *[0.0] * (d - 1)]}
    return {
        "title": "bar with a rigid end", "dimension": 3 if d == 3 else "plane_stress",
        "bodies": [elastic, {"name": "end", "rigid": {"plane": plane}}],
        "conditions": [held, *({"in": "end", **load} for load in loads)],
        "contacts": [{"on": "bar.x+", "against": "end", "tied": True}],
        "solver": {"tolerance": 1e-9},
    }  # fmt: skip


def motion(made: scenes.Config) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and rotation of the rigid end of a certified answer."""
    summary = solve(made).summary
    assert summary["certificate"]["passed"]
    found = summary["rigid_bodies"]["end"]
    return np.array(found["displacement"]), np.atleast_1d(found["rotation"])


@pytest.mark.parametrize("method", METHODS)
def test_a_bar_in_tension_and_bending_has_the_displacements_of_beam_theory(method: str) -> None:
    """F L / (E A), M L / (E I) and M L² / (2 E I): exact for ν = 0 with quadratic displacements."""
    made = bar({"total_force": [2.0, 0, 0], "total_moment": [0, 0.05, 0]})
    made["solver"]["method"] = method
    moved, turned = motion(made)
    turn = 0.05 * LENGTH * 12.0 / YOUNG
    stretch = 2.0 * LENGTH / YOUNG
    np.testing.assert_allclose(turned, [0.0, turn, 0.0], atol=1e-8)
    np.testing.assert_allclose(moved, [stretch, 0.0, -0.5 * turn * LENGTH], atol=1e-8)


def test_a_remote_force_in_the_plane_bends_a_cantilever() -> None:
    """Timoshenko's beam: F L³ / (3 E I) + 1.2 F L / (G A), and the moment of the arm of F."""
    made = bar({"total_force": [0.0, 0.01], "at": [LENGTH + 3.0, 0.5]}, cells=(16, 2))
    moved, turned = motion(made)
    inertia, moment = YOUNG / 12.0, 0.03
    bent = 0.01 * LENGTH**3 / (3.0 * inertia) + moment * LENGTH**2 / (2.0 * inertia)
    sheared = 1.2 * 0.01 * LENGTH / (0.5 * YOUNG)
    assert moved[1] == pytest.approx(bent + sheared, rel=2e-4)
    assert turned[0] == pytest.approx((0.005 * LENGTH + moment) * LENGTH / inertia, rel=1e-6)


def test_the_scene_of_the_guide_bends_and_turns_as_a_beam() -> None:
    """Timoshenko's beam under the remote force, and Saint-Venant's torsion with stiff ends."""
    guide = (Path(__file__).parents[3] / "docs/guide/rigid.md").read_text(encoding="utf-8")
    section = guide.split("## Tied to a rigid body", 1)[1]
    made = parse(section.split("```yaml\n", 1)[1].split("```", 1)[0], "rigid.md")[0]
    summary = solve({"title": "guide", "dimension": 3, **made}).summary
    assert summary["certificate"]["passed"]
    head = summary["rigid_bodies"]["head"]
    young, bending, length = 2.1e5, 2.1e5 * 1e4 / 12.0, 100.0
    shear = young / 2.6
    bent = 50.0 * length**3 / 3.0 + 3000.0 * length**2 / 2.0
    sheared = 50.0 * length / (shear * 100.0 * 5.0 / 6.0)
    assert head["displacement"][2] == pytest.approx(-bent / bending - sheared, rel=0.01)
    turn = (50.0 * length**2 / 2.0 + 3000.0 * length) / bending
    assert head["rotation"][1] == pytest.approx(turn, rel=0.01)
    twist = 2000.0 * length / (0.1406 * shear * 1e4)
    assert head["rotation"][0] == pytest.approx(twist, rel=0.03)


def test_torsion_by_a_moment_and_by_an_angle_agree() -> None:
    """Saint-Venant's 0.1406 G a⁴, a little stiffer since the ends do not warp."""
    turned = motion(bar({"total_moment": [1.0, 0, 0]}, cells=(6, 3, 3)))[1]
    assert 0.95 < turned[0] * 0.1406 * 0.5 * YOUNG / LENGTH < 1.0
    held = bar({"displacement": [0, 0, 0], "rotation": [turned[0], 0, 0]}, cells=(6, 3, 3))
    summary = solve(held).summary
    reaction = next(r for r in summary["reactions"] if r["on"] == "end")
    np.testing.assert_allclose(reaction["moment"], [1.0, 0, 0], atol=1e-6)
    contact = summary["contacts"][0]
    assert (contact["with"], contact["area"]) == ("end", pytest.approx(1.0))
    np.testing.assert_allclose(contact["moment"], [1.0, 0, 0], atol=1e-6)


def test_the_largest_traction_is_that_of_bending() -> None:
    """M / W at the edge; vertices of quadratic triangles count by the middles of their edges."""
    made = bar({"total_moment": [0, 0.05, 0]})
    assert solve(made).summary["contacts"][0]["max_pressure"] == pytest.approx(0.3, rel=1e-6)


def half(cells: tuple[int, int, int]) -> scenes.Config:
    """Half of the bar, cut at the plane through the middle of its section."""
    made = bar(
        {"total_force": [1.0, 0, -0.01]}, {"rotation": [None, None, 0]}, cells=cells, poisson=0.3
    )
    made["bodies"][0]["mesh"]["box"]["lower"][1] = 0.5
    made["conditions"].insert(1, {"on": "bar.y-", "displacement": [None, 0, None]})
    return made


@pytest.mark.parametrize("method", METHODS)
def test_held_nodes_of_a_half_model_guide_the_rigid_end(method: str) -> None:
    """Rows of held nodes hold motions of the rigid body; each needs one row only."""
    whole = bar({"total_force": [2.0, 0, -0.02]}, cells=(4, 2, 2), poisson=0.3)
    made = half((4, 1, 2))
    made["solver"]["method"] = method
    for ours, theirs in zip(motion(made), motion(whole), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_ranks_agree(tmp_path: Path) -> None:
    known, found = (summary_of(half((4, 1, 2)), tmp_path, ranks) for ranks in (1, 2))
    for summary in (known, found):
        assert summary["certificate"]["passed"]
    for key in ("displacement", "rotation"):
        ours, theirs = (s["rigid_bodies"]["end"][key] for s in (found, known))
        np.testing.assert_allclose(ours, theirs, atol=1e-8)


def test_its_heat_and_a_force_on_the_end_balance() -> None:
    """α ∫ T dx of free expansion less F L / (E A)."""
    made = bar({"total_force": [-0.5, 0, 0]}, expansion=1e-5)
    made["conditions"].append({"in": "bar", "temperature": "10 * x"})
    made["conditions"][0]["displacement"] = [0, None, None]
    made["conditions"].append({"in": "end", "displacement": [None, 0, 0], "rotation": [0, 0, 0]})
    moved, _ = motion(made)
    assert moved[0] == pytest.approx(5e-5 * LENGTH**2 - 0.5 * LENGTH / YOUNG, abs=1e-8)


def on_a_floor() -> scenes.Config:
    """The bar, bent onto a floor that its tied edge touches and turned a little about its axis."""
    made = bar({"total_force": [0, 0, -2.0], "total_moment": [0.02, 0, 0]}, poisson=0.3)
    floor = {"plane": {"point": [0, 0, -0.05], "normal": [0, 0, 1]}}
    made["contacts"].append({"on": "bar.z-", "obstacle": floor})
    return made


def balance(summary: dict[str, Any], loads: dict[str, np.ndarray]) -> None:
    """Forces and moments about the origin of the bar, and of the end with its loads, vanish."""
    tie, floor = summary["contacts"]
    (held,) = (r for r in summary["reactions"] if r["on"] == "bar.x-")
    about = {"bar": [tie, floor, held]}
    for records in about.values():
        forces = [np.array(r["force"]) for r in records]
        moments = [np.array(r["moment"]) + np.cross(r["point"], r["force"]) for r in records]
        np.testing.assert_allclose(np.sum(forces, axis=0), 0.0, atol=1e-6)
        np.testing.assert_allclose(np.sum(moments, axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(np.array(tie["force"]), loads["force"], atol=1e-6)
    turned = np.array(tie["moment"]) + np.cross(np.array(tie["point"]) - loads["at"], tie["force"])
    np.testing.assert_allclose(turned, loads["moment"], atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_tied_nodes_touch_a_floor(method: str) -> None:
    """Multigrid certifies it itself; the tie carries the load of the end, the floor the rest."""
    made = on_a_floor()
    made["solver"]["method"] = method
    summary = solve(made).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == {"auto": "active-set"}.get(method, method)
    moved = np.array(summary["rigid_bodies"]["end"]["displacement"])
    turned = np.array(summary["rigid_bodies"]["end"]["rotation"])
    edge = [moved[2] + np.cross(turned, [0.0, y - 0.5, -0.5])[2] for y in (0.0, 1.0)]
    assert min(edge) == pytest.approx(-0.05, rel=1e-6)
    assert summary["contacts"][1]["force"][2] > 1.0
    load = {"force": [0, 0, -2.0], "moment": [0.02, 0, 0], "at": [LENGTH, 0.5, 0.5]}
    balance(summary, {name: np.array(value) for name, value in load.items()})


def test_tied_nodes_on_a_floor_do_not_depend_on_ranks(tmp_path: Path) -> None:
    known, found = (summary_of(on_a_floor(), tmp_path, ranks) for ranks in (1, 3))
    for name in ("force", "moment"):
        ours, theirs = ([np.array(c[name]) for c in s["contacts"]] for s in (found, known))
        np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("free", "nothing stops bar from leaving"),
        ("pushed", "pushes nodes that are tied to it by 0.1 into what contacts[1] names"),
        (
            "guided",
            "leave the rigid body end no room: wherever its free components take it, held or "
            "tied nodes of contacts[1] enter by 0.1 or more",
        ),
        ("pulled", "conditions hold would move end, which is rigid, in two ways, 0.1 apart"),
        ("shared", "contacts[1].on: has nodes that are tied to end, too"),
        ("friction", "contacts[0].friction has no meaning in a tied contact"),
        ("empty", "contacts[0].on: no whole facet of the surface of bar lies on nowhere"),
    ],
)
def test_impossible_scenes_are_refused(change: str, said: str) -> None:
    """Each names the contact, the body, and by how much."""
    made = copy.deepcopy(bar({"total_force": [1.0, 0, 0]}, cells=(2, 1, 1)))
    floor = {"on": "bar.z-", "obstacle": {"plane": {"point": [0, 0, -0.1], "normal": [0, 0, 1]}}}
    held = {"in": "end", "displacement": [0, 0, -0.2], "rotation": [0, 0, 0]}
    other = {"name": "other", "rigid": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}
    where = made["bodies"][0].setdefault("boundaries", {})
    if change == "free":
        del made["conditions"][0]
    elif change in ("pushed", "guided"):
        made["contacts"].append(floor)
        made["conditions"][1] = held
        if change == "guided":  # rows of contact at single nodes
            held["displacement"][0], made["bodies"][0]["degree"] = None, 1
    elif change == "pulled":
        for name, side, moved in (("front", "y < 1e-9", 0.0), ("back", "y > 1 - 1e-9", 0.1)):
            where[name] = {"where": f"x > {LENGTH} - 1e-9 and {side}"}
            made["conditions"].append({"on": f"bar.{name}", "displacement": [None, moved, None]})
    elif change == "shared":
        made["bodies"].append(other)
        made["contacts"].append({"on": "bar.z-", "against": "other", "tied": True})
    elif change == "friction":
        made["contacts"][0]["friction"] = {"coulomb": 0.3}
    else:
        where["nowhere"] = {"where": "x > 9"}
        made["contacts"][0]["on"] = "bar.nowhere"
    with pytest.raises((ConfigurationError, NoEquilibriumError)) as found:
        solve(made)
    assert said in str(found.value)


def test_nodes_tied_to_a_rigid_body_rub_as_those_tied_to_a_stiff_block() -> None:
    """Coulomb friction below a rigid end that moves, beside a block of 10⁵ times the stiffness."""
    rigid, stiff = bar({"total_force": [2.0, -0.3, 0.1]}), bar()
    mesh = {"box": {"lower": [LENGTH, 0, 0], "upper": [LENGTH + 0.5, 1, 1], "cells": [1, 2, 2]}}
    stiff["bodies"][1] = {"name": "end", "mesh": mesh, "degree": 2,
                          "material": {"young": 1e5 * YOUNG, "poisson": 0.0}}  # fmt: skip
    stiff["contacts"][0] = {"on": "end.x-", "against": "bar.x+", "tied": True}
    load = {"on": "end.x+", "total_force": [2.0, -0.3, 0.1], "at": [LENGTH, 0.5, 0.5]}
    stiff["conditions"].append(load)
    floor = {"plane": {"point": [0, -0.01, 0], "normal": [0, 1.0, 0]}}
    forces = []
    for made in (rigid, stiff):
        made["bodies"][0]["boundaries"] = {"low": {"where": f"y < 1e-9 and x > {LENGTH - 0.01}"}}
        rubs = {"on": "bar.low", "obstacle": floor, "friction": {"coulomb": 0.3}}
        made["contacts"].append(rubs)
        made["solver"]["tolerance"] = 1e-8
        summary = solve(made).summary
        assert summary["certificate"]["passed"]
        forces.append(np.array(summary["contacts"][1]["force"]))
    x, y, z = forces[0]
    np.testing.assert_allclose(np.hypot(x, z), 0.3 * y, rtol=5e-3)  # nodes slide apart
    np.testing.assert_allclose(*forces, atol=1e-3 * y)


@pytest.mark.parametrize(("foot", "warned"), [("x < 2", True), ("x < 0.8", False)])
def test_friction_at_tied_nodes_is_warned_about(foot: str, warned: bool) -> None:
    """Friction and a tie at one node share its force in no single way; apart they do.

    Total FETI solves such a scene with `method: primal`, too, without any work by multigrid.
    """
    peaks, applications = [], []
    for method in ("auto", "primal"):
        made = {
            "title": "a block tied to a free plate on a rough floor", "dimension": 2,
            "bodies": [
                {"name": "block", "material": {"young": 1000.0, "poisson": 0.3},
                 "mesh": {"box": {"lower": [0, 0], "upper": [1, 1], "cells": [4, 4]}},
                 "boundaries": {"foot": {"where": f"y < 1e-9 and {foot}"}}},
                {"name": "plate", "rigid": {"plane": {"point": [1, 0.5], "normal": [-1, 0]}}},
            ],
            "conditions": [{"on": "block.y+", "traction": [0, -10]},
                           {"in": "plate", "total_force": [1.0, -1.0]}],
            "contacts": [{"on": "block.x+", "against": "plate", "tied": True},
                         {"on": "block.foot", "friction": {"coulomb": 0.3},
                          "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}}],
            "solver": {"tolerance": 1e-8, "method": method},
        }  # fmt: skip
        summary = solve(made).summary
        assert summary["certificate"]["passed"]
        told = [w for w in summary["certificate"]["warnings"] if "share the forces" in w]
        assert [w.startswith("contacts[1]: 1 of its nodes") for w in told] == [True] * warned
        peaks.append(summary["contacts"][1]["max_pressure"])
        applications.append(summary["solver"]["hessian_multiplications"])
        assert (summary["solver"]["method"] == "primal") == (method == "primal" and not warned)
    if warned:
        assert applications[0] == applications[1]
    else:
        assert peaks[0] == pytest.approx(peaks[1], rel=1e-5)
