"""Rigid bodies: against fixed obstacles, springs and statics; held, moved, loaded and let go."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.model.model import build_model
from contact_app.results.rigid import placements_of
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from solver.contact.stopping import StoppingRule
from solver.driver import solve as solve_problem
from solver.primal.by_active_sets import solve_by_multigrid
from solver.primal.factor import FactorOptions
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from tests import scenes
from tests.comparison import same_contacts, solve
from tests.scenes_on_ranks import run_scene, summary_of

RADIUS, FORCE = 2.0, 30.0


def three(d: int, *values: float) -> list[float]:
    """A vector; in the plane without its second component."""
    return list(values) if d == 3 else [values[0], values[2]]


def ball_on_block(cell: str, n: int) -> scenes.Config:
    """A ball, or a disc, that a force presses into a block; it can move up and down alone."""
    d = scenes.dimension(cell)
    block = scenes.block(cell, n, lower=(-1, -1, -1), upper=(1, 1, 0))
    ball = {"name": "ball", "rigid": {"sphere": {"center": three(d, 0.05, 0, RADIUS),
                                                 "radius": RADIUS}}}  # fmt: skip
    free = three(d, 0, 0, 0)[:-1]
    return scenes.config(
        cell, [block, ball],
        [
            scenes.clamp(cell, f"block.{scenes.down(cell)}"),
            {"in": "ball", "displacement": [*free, None], "rotation": [0, 0, 0][: 2 * d - 3]},
            {"name": "press", "in": "ball", "total_force": three(d, 0, 0, -FORCE)},
        ],
        [{"on": f"block.{scenes.up(cell)}", "against": "ball"}],
    )  # fmt: skip


def fixed_at(made: scenes.Config, depth: float) -> scenes.Config:
    """The same with the ball as an obstacle that is so much lower."""
    made = copy.deepcopy(made)
    ball = made["bodies"].pop()
    made["conditions"] = made["conditions"][:1]
    sphere = ball["rigid"]["sphere"]
    sphere["center"][-1] -= depth
    contact = made["contacts"][0]
    del contact["against"]
    contact["obstacle"] = {"sphere": sphere}
    return made


CELLS = [("quadrilateral", 12, 1), ("triangle", 8, 2), ("hexahedron", 6, 1), ("tetrahedron", 4, 2)]


@pytest.mark.parametrize(("cell", "n", "degree"), CELLS)
def test_a_pressed_ball_is_the_fixed_obstacle_at_its_depth(cell: str, n: int, degree: int) -> None:
    """Force, approach, pressure and displacements; the force is the one given."""
    made = ball_on_block(cell, n)
    made["bodies"][0]["degree"] = degree
    pressed = solve(made, 3)
    found = pressed.summary["rigid_bodies"]["ball"]
    depth = -found["displacement"][-1]
    assert depth > 0.003  # of which the square over the radius is no rounding error
    assert found["displacement"][:-1] == [0.0] * (scenes.dimension(cell) - 1)
    fixed = solve(fixed_at(made, depth), 3)
    known, told = (s.summary["contacts"][0] for s in (fixed, pressed))
    d = scenes.dimension(cell)
    assert told["force"][d - 1] == pytest.approx(-FORCE, rel=1e-9)
    np.testing.assert_allclose(told["force"], known["force"], atol=1e-6 * FORCE)
    assert told["max_pressure"] == pytest.approx(known["max_pressure"], rel=1e-6)
    assert told["nodes"]["slip"] == known["nodes"]["slip"]
    assert told["with"] == "ball"
    u, v = (s.nodes.displacement for s in (pressed, fixed))
    np.testing.assert_allclose(u, v, rtol=0, atol=1e-6 * np.abs(v).max())
    assert pressed.summary["certificate"]["passed"]


def test_a_moved_body_is_the_moved_obstacle() -> None:
    """Displacement and rotation are prescribed: the obstacle is turned and moved."""
    made = scenes.config(
        "hexahedron",
        [
            scenes.block("hexahedron", 4),
            {"name": "tool", "rigid": {"plane": {"point": [0.5, 0.5, 1.0], "normal": [0, 0, -1]}}},
        ],
        [
            scenes.clamp("hexahedron", "block.z-"),
            {"in": "tool", "displacement": [0.3, 0.2, -0.02], "rotation": [0.0, 0.08, 0.4]},
        ],
        [{"on": "block.z+", "against": "tool"}],
    )
    moved = solve(made, 2)
    from scipy.spatial.transform import Rotation

    normal = Rotation.from_rotvec([0.0, 0.08, 0.4]).apply([0, 0, -1]).tolist()
    fixed = copy.deepcopy(made)
    del fixed["bodies"][1], fixed["conditions"][1]
    fixed["contacts"] = [
        {"on": "block.z+", "obstacle": {"plane": {"point": [0.8, 0.7, 0.98], "normal": normal}}}
    ]
    known = solve(fixed, 2)
    same = {**moved.summary, "contacts": [{**moved.summary["contacts"][0], "with": "plane"}]}
    same_contacts(same, known.summary, 1e-9)
    assert moved.summary["rigid_bodies"]["tool"]["rotation"] == [0.0, 0.08, 0.4]
    tool = moved.summary["reactions"][-1]
    assert tool["on"] == "tool"
    np.testing.assert_allclose(tool["force"], moved.summary["contacts"][0]["force"], rtol=1e-9)


PLACES, MODULI = ((0.0, 0.0), (3.0, 0.0), (0.0, 3.0)), (1000.0, 2000.0, 4000.0)


def plate_on_blocks(**motion: Any) -> scenes.Config:
    """A rigid plate on three blocks of different stiffness, each of which is a spring."""
    bodies = [
        scenes.block("hexahedron", 2, f"b{k}", (x, y, 0), (x + 1, y + 1, 1), young, 0.0)
        for k, ((x, y), young) in enumerate(zip(PLACES, MODULI, strict=True))
    ]
    conditions = [scenes.clamp("hexahedron", f"b{k}.z-") for k in range(3)]
    if motion:
        conditions.append({"in": "plate", **motion})
    plane = {"plane": {"point": [1.5, 1.5, 1.0], "normal": [0, 0, -1]}}
    return scenes.config(
        "hexahedron", [*bodies, {"name": "plate", "rigid": plane}], conditions,
        [{"on": f"b{k}.z+", "against": "plate"} for k in range(3)],
    )  # fmt: skip


def test_a_plate_that_stays_level_shares_its_force_by_stiffness() -> None:
    """Springs side by side: E A / h each, and the moment that keeps the plate level."""
    made = plate_on_blocks(displacement=[0, 0, None], rotation=[0, 0, 0])
    made["conditions"].append({"in": "plate", "total_force": [0, 0, -7.0]})
    summary = solve(made).summary
    forces = np.array([c["force"] for c in summary["contacts"]])
    np.testing.assert_allclose(forces[:, 2], [-1.0, -2.0, -4.0], rtol=1e-9)
    assert summary["rigid_bodies"]["plate"]["displacement"][2] == pytest.approx(-1e-3, rel=1e-9)
    held = next(r for r in summary["reactions"] if r["on"] == "plate")
    arms = np.array([[x - 1.0, y - 1.0, 0.0] for x, y in PLACES])
    needed = np.cross(arms, forces).sum(axis=0)  # what the blocks do to it, with the other sign
    np.testing.assert_allclose(held["moment"], needed, atol=1e-6)
    np.testing.assert_allclose(held["force"], 0.0, atol=1e-8)


@pytest.mark.parametrize("held", [True, False])
def test_a_plate_that_tilts_is_in_equilibrium(held: bool) -> None:
    """Force and moment of the blocks balance those given; their tops follow the plate."""
    motion = {"displacement": [0, 0, None], "rotation": [None, None, 0]} if held else {}
    made = plate_on_blocks(**motion)
    made["conditions"].append(
        {"in": "plate", "total_force": [0, 0, -7.0], "total_moment": [0.4, -0.2, 0]}
    )
    solution = solve(made)
    summary = solution.summary
    contacts = summary["contacts"]
    force = np.sum([c["force"] for c in contacts], axis=0)
    moment = np.sum([
        np.array(c["moment"]) + np.cross(np.subtract(c["point"], [1.5, 1.5, 1.0]), c["force"])
        for c in contacts
    ], axis=0)  # fmt: skip
    np.testing.assert_allclose(force, [0, 0, -7.0], atol=1e-8)
    np.testing.assert_allclose(moment, [0.4, -0.2, 0.0], atol=1e-6)
    plate = summary["rigid_bodies"]["plate"]
    t, turn = np.array(plate["displacement"]), np.array(plate["rotation"])
    assert np.linalg.norm(turn) > 1e-4
    assert all(c["nodes"]["open"] == 0 for c in contacts)
    points, u = solution.nodes.points, solution.nodes.displacement
    top = points[:, 2] == 1.0
    follows = t + np.cross(turn, points[top] - [1.5, 1.5, 1.0])
    np.testing.assert_allclose(u[top, 2], follows[:, 2], atol=1e-6 * np.abs(u).max())
    warned = [w for w in summary["certificate"]["warnings"] if w.startswith("plate can move")]
    assert len(warned) == (0 if held else 1)


@pytest.mark.parametrize(
    ("load", "where"),
    [
        ({"total_force": [0, 0, 5.0]}, r"plate from leaving along \+z"),
        ({"total_force": [0, 0, -7.0], "at": [9, 9, 1]}, "plate from leaving along .*a turn"),
        ({"total_force": [1.0, 0, -7.0]}, r"plate from leaving along \+x"),
        ({"total_moment": [0, 0, 1.0]}, "plate from leaving along a turn about z"),
    ],
)
def test_a_body_that_nothing_holds_has_no_equilibrium(
    load: dict[str, Any], where: str, tmp_path: Path
) -> None:
    """It is named with the direction in which it leaves."""
    made = plate_on_blocks()
    made["conditions"].append({"in": "plate", **load})
    with pytest.raises(NoEquilibriumError, match=where):
        solve(made)
    if "at" not in load and load.get("total_force", [1])[0] == 0:
        done = run_scene(scenes.write(made, tmp_path / "up.yaml"), tmp_path / "out", 1)
        assert done.returncode == 3
        assert "plate from leaving" in done.stderr


def test_force_at_a_point_is_force_and_moment() -> None:
    """`at` moves the force from the reference point."""
    made = plate_on_blocks(displacement=[0, 0, None], rotation=[None, None, 0])
    one, other = copy.deepcopy(made), copy.deepcopy(made)
    one["conditions"].append({"in": "plate", "total_force": [0, 0, -7.0], "at": [1.4, 1.6, 3.0]})
    moment = np.cross([-0.1, 0.1, 2.0], [0, 0, -7.0]).tolist()
    other["conditions"].append({"in": "plate", "total_force": [0, 0, -7.0], "total_moment": moment})
    same_contacts(solve(one).summary, solve(other).summary, 1e-7)


def test_shapes_of_one_body_move_together() -> None:
    """A wedge of two planes lowered on the corner of a block touches on both sides."""
    d, cell = 2, "quadrilateral"
    wedge = [
        {"plane": {"point": [1.0, 1.0], "normal": normal}}
        for normal in ([-1.0, -0.3], [-0.2, -1.0])
    ]
    made = scenes.config(
        cell, [scenes.block(cell, 6), {"name": "wedge", "rigid": wedge}],
        [
            scenes.clamp(cell, "block.y-"),
            {"in": "wedge", "displacement": [None, None], "rotation": 0.0},
            {"in": "wedge", "total_force": [-5.0, -20.0]},
        ],
        [{"on": "block.x+", "against": "wedge"}, {"on": "block.y+", "against": "wedge"}],
    )  # fmt: skip
    summary = solve(made, 4).summary
    forces = np.array([c["force"][:d] for c in summary["contacts"]])
    np.testing.assert_allclose(forces.sum(axis=0), [-5.0, -20.0], rtol=1e-8)
    assert [c["with"] for c in summary["contacts"]] == ["wedge", "wedge"]
    split = copy.deepcopy(made)  # as two obstacles, where the wedge has come to
    t = summary["rigid_bodies"]["wedge"]["displacement"]
    split["bodies"].pop()
    split["conditions"] = split["conditions"][:1]
    for face in wedge:
        face["plane"]["point"] = (np.array([1.0, 1.0]) + t).tolist()
    split["contacts"] = [
        {"on": f"block.{on}", "obstacle": face} for on in ("x+", "y+") for face in wedge
    ]
    known = [np.array(c["force"][:d]) for c in solve(split, 4).summary["contacts"]]
    np.testing.assert_allclose(forces[0], known[0] + known[1], atol=2e-6 * 20)
    np.testing.assert_allclose(forces[1], known[2] + known[3], atol=2e-6 * 20)


def plate_on_held() -> scenes.Config:
    """A plate in the plane on a block of which a top node is held."""
    cell = "quadrilateral"
    return scenes.config(
        cell,
        [
            scenes.block(cell, 4, boundaries={"left": "x < 1e-9 and y > 1 - 1e-9"}),
            {"name": "plate", "rigid": scenes.plane(cell, (0.0, 0, 1.0), (0, 0, -1))},
        ],
        [
            scenes.clamp(cell, "block.y-"),
            scenes.clamp(cell, "block.left"),
            {"in": "plate", "displacement": [0, None], "rotation": None},
            {"in": "plate", "total_force": [0, -10.0], "at": [0.6, 1.0]},
        ],
        [{"on": "block.y+", "against": "plate"}],
    )


@pytest.mark.parametrize("method", ["auto", "primal"])
def test_a_plate_rests_on_held_bodies(method: str) -> None:
    """Nodes that conditions hold carry a rigid body, too: there a row has no elastic part."""
    summary = solve(plate_on_held(), method=method).summary
    assert method in ("auto", summary["solver"]["method"])
    plate = summary["rigid_bodies"]["plate"]
    assert plate["displacement"][1] == pytest.approx(0.0, abs=1e-9)  # it turns about the held node
    assert plate["rotation"] < -1e-3
    assert summary["contacts"][0]["force"][1] == pytest.approx(-10.0, rel=1e-8)
    moment = summary["contacts"][0]
    (x, y), (fx, fy) = moment["point"][:2], moment["force"][:2]
    arm = moment["moment"] + x * fy - y * fx
    assert arm == pytest.approx(-10.0 * 0.6, rel=1e-6)
    assert summary["certificate"]["passed"]


def mixed() -> scenes.Config:
    """A ball on a stack of tied blocks of which one meets a neighbour; a roller that is moved."""
    cell = "hexahedron"
    return scenes.config(
        cell,
        [
            scenes.block(cell, 3, "base"),
            scenes.block(cell, 2, "top", (0, 0, 1), (1, 1, 2), 700.0),
            scenes.block(cell, 2, "beside", (1, 0, 1), (2, 1, 2), 400.0),
            {"name": "ball", "rigid": {"sphere": {"center": [0.5, 0.45, 4.0], "radius": 2.0}}},
            {"name": "roller", "rigid": {"cylinder": {"point": [1.5, 0, 3.0], "axis": [0, 1, 0],
                                                      "radius": 1.0}}},
        ],
        [
            scenes.clamp(cell, "base.z-"), scenes.clamp(cell, "beside.z-"),
            {"in": "ball", "total_force": [3.0, 0, -60.0]},
            {"in": "ball", "displacement": [0, 0, None]},
            {"in": "roller", "displacement": [0, 0, -0.02], "rotation": [None, 0, 0]},
        ],
        [
            {"on": "top.z-", "against": "base.z+", "tied": True},
            {"on": "top.x+", "against": "beside.x-"},
            {"on": "top.z+", "against": "ball"},
            {"on": "beside.z+", "against": "roller", "interference": 0.005},
        ],
    )  # fmt: skip


def test_ranks_agree(tmp_path: Path) -> None:
    """The last rank has the rigid bodies; the answer does not know."""
    made = mixed()
    made["decomposition"] = {"subdomains": 5}
    known, found = (summary_of(made, tmp_path, n) for n in (1, 3))
    same_contacts(found, known, 3e-6)
    for name, body in known["rigid_bodies"].items():
        for key, values in body.items():
            np.testing.assert_allclose(found["rigid_bodies"][name][key], values, atol=3e-8)
    assert found["reactions"][-1]["on"] == "roller"


FACTORS = {"factors": FactorOptions(), "multigrid": FactorOptions(0.0, 12.0, 0.0, slow_seconds=0.0)}


@pytest.mark.parametrize("factors", FACTORS)
def test_undecomposed_bodies_give_the_same_answer(factors: str) -> None:
    """Six unknowns more for the ball and one for the roller, in both preconditioners."""
    made, answers = mixed(), []
    for method in ("active-set", "primal"):
        made["solver"] = {"method": method, "tolerance": 1e-9}
        scene = scenes.build(made)
        model = build_model(scene, MPI.COMM_SELF)
        if method == "active-set":
            found = solve_problem(model.problem, scene.solver)
        else:
            inner = MPRGP(rtol=1e-10, max_iterations=2000)
            task = Task(model.problem, StoppingRule(1e-9), inner)
            found = solve_by_multigrid(task, None, None, FACTORS[factors])
        assert found.converged, found.certificate
        answers.append((found.measures.energy, placements_of(model.geometry, model.problem, found)))
    (energy, known), (ours, places) = answers
    assert ours == pytest.approx(energy, rel=1e-8)
    for place, other in zip(places, known, strict=True):
        np.testing.assert_allclose(place.displacement, other.displacement, atol=1e-7)
        np.testing.assert_allclose(place.rotation, other.rotation, atol=1e-7)


def test_load_cases_place_it_anew() -> None:
    """Each case has a placement of its own."""
    import contact_app

    made = ball_on_block("quadrilateral", 8)
    made["cases"] = {"soft": {"press": 0.25}, "hard": {"press": 1.0}}
    answer = contact_app.solve(made)
    alone = solve({k: v for k, v in made.items() if k != "cases"}).summary
    hard = answer.cases["hard"].summary
    assert hard["rigid_bodies"]["ball"]["displacement"] == pytest.approx(
        alone["rigid_bodies"]["ball"]["displacement"], rel=1e-6
    )
    soft = answer.cases["soft"].summary["contacts"][0]["force"]
    assert soft[1] == pytest.approx(-0.25 * FORCE, rel=1e-9)


def test_large_free_rotations_are_warned_about() -> None:
    """A soft block under a plate that tilts by more than a tenth."""
    made = plate_on_blocks(displacement=[0, 0, None], rotation=[None, None, 0])
    made["conditions"].append({"in": "plate", "total_force": [0, 0, -2500.0], "at": [1.0, 1.3, 1]})
    warnings = solve(made).summary["certificate"]["warnings"]
    assert any("plate turns by" in text and "small rotations" in text for text in warnings)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"bodies.1.material": {"young": 1.0, "poisson": 0.3}},
         "bodies[1].material is an unknown key; a rigid body has no mesh and no material"),
        ({"bodies.1.mesh": {"file": "ball.msh"}},
         "bodies[1].mesh is an unknown key; a rigid body has no mesh and no material"),
        ({"bodies.1.rigid": {"cube": 1}}, "bodies[1].rigid.cube is an unknown key"),
        ({"bodies.1.rigid": {}}, "bodies[1].rigid has no shape"),
        ({"bodies.1.rigid": []}, "bodies[1].rigid is []; it must not be empty"),
        ({"bodies.1.name": "block"}, "bodies[1].name is 'block', the name of an earlier body"),
        ({"conditions.1.rotation": [0, 0]}, "conditions[1].rotation has 2 components; in 3D"),
        ({"conditions.1.displacement": [0, 0]}, "conditions[1].displacement has 2 components"),
        ({"conditions.2": {"in": "ball", "traction": [0, 0, 1]}},
         "conditions[2].traction has no meaning in a rigid body"),
        ({"conditions.2": {"in": "ball", "on": "block.z+", "total_force": [0, 0, 1]}},
         "conditions[2].on stands beside `in`"),
        ({"conditions.2.displacement": [0, 0, 0]}, "conditions[2].total_force stands beside"),
        ({"conditions.2": {"in": "ball", "displacement": [0, None, None]}},
         "conditions[2].displacement holds component 0 of ball, which conditions[1] holds already"),
        ({"conditions.2": {"in": "block", "rotation": [0, 0, 1]}},
         "conditions[2].rotation is of a rigid body"),
        ({"conditions.2": {"on": "ball.z+", "pressure": 1.0}}, "conditions[2].on names ball"),
        ({"conditions.2": {"in": "bal", "total_force": [0, 0, 1]}},
         "conditions[2].in names the body 'bal'; did you mean ball? (known: block, ball)"),
        ({"contacts.0.on": "ball.skin"}, "contacts[0].on is 'ball.skin', which is rigid as ball"),
        ({"contacts.0": {"on": "ball", "against": "block.z+"}},
         "contacts[0].on names ball, which is rigid"),
        ({"contacts.1": {"on": "block.z+", "against": "ball"}}, "contacts[1] repeats contacts[0]"),
        ({"bodies": [{"name": "ball", "rigid": {"sphere": {"center": [0, 0, 0], "radius": 1}}}]},
         "bodies are all rigid"),
        ({"certificate": {"guaranteed": True}}, "certificate.guaranteed is not available"),
    ],
)  # fmt: skip
def test_errors_name_their_place(change: dict[str, Any], said: str) -> None:
    """Each names the key and what is allowed."""
    with pytest.raises(ConfigurationError) as found:
        build_scene(from_mapping(scenes.changed(ball_on_block("hexahedron", 2), change)))
    assert said in str(found.value)


def test_places_converge_where_contact_forces_turn_with_the_body() -> None:
    """x → a + x/2: the second step tells the factor, and the third place is the fixed point."""
    from contact_app.run.placing import Relaxation
    from contact_app.scene.rigid import Placement

    relaxation, place, taken = Relaxation(), Placement(), []
    for _ in range(3):
        x, y, _z = place.displacement
        found = Placement((0.1 + 0.5 * x, -0.4 + 0.5 * y, 0.0))
        (place,) = relaxation.towards([place], [found])
        taken.append(place.displacement)
    assert taken[0] == (0.1, -0.4, 0.0)
    np.testing.assert_allclose(taken[1], [0.2, -0.8, 0.0], rtol=1e-12)
    np.testing.assert_allclose(taken[2], taken[1], rtol=1e-12)


def test_an_accuracy_is_met_with_a_body_that_a_force_moves() -> None:
    """The claim on the error holds beside a fine mesh; each level places the ball anew."""
    made, fine = (ball_on_block("quadrilateral", n) for n in (6, 24))
    made["accuracy"], fine["bodies"][0]["degree"] = 0.12, 2
    found = solve_to_accuracy(scenes.build(made), solve_scene)
    assert not found.missed
    summary = found.solved.summary
    known, claim = solve(fine, 4).summary, summary["accuracy"]
    energy, least = (s["solution"]["energy"] for s in (summary, known))
    # of a given force; either sign, since contact holds in the mean over nodes
    error = np.sqrt(abs(energy - least) / abs(least))
    assert 0.2 * claim["total"] <= error <= 1.2 * claim["total"] <= 1.2 * 0.12
    depth, exact = (s["rigid_bodies"]["ball"]["displacement"][-1] for s in (summary, known))
    assert depth == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("method", ["auto", "smalbe", "primal"])
def test_a_plate_on_held_nodes_alone_sinks_onto_them(method: str) -> None:
    """No unknown of the elastic body is in a row; nothing is divided by zero."""
    made = ball_on_block("hexahedron", 2)
    made["bodies"][1]["rigid"] = {"plane": {"point": [0.2, 0.1, 0.01], "normal": [0, 0, -1]}}
    made["conditions"][0]["on"] = "block.z+"
    made["solver"] = {"method": method}
    with np.errstate(all="raise", under="ignore"):
        summary = solve(made).summary
    assert summary["certificate"]["passed"]
    assert summary["rigid_bodies"]["ball"]["displacement"][2] == pytest.approx(-0.01)


@pytest.mark.parametrize(("free", "warned"), [(0.0, True), (None, False)])
def test_a_load_on_held_components_causes_a_warning(free: float | None, warned: bool) -> None:
    made = ball_on_block("quadrilateral", 6)
    made["conditions"][1]["displacement"][-1] = free
    warnings = solve(made).summary["certificate"]["warnings"]
    assert any("ball is held against this load" in w for w in warnings) == warned
