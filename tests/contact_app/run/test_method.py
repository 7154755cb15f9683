"""The method that `solver.method: auto` chooses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.method import LIMITS, MethodChoice, patience, with_chosen_method
from contact_app.run.fallback import NoAnswerError
from contact_app.run.solve import solve_scene
from contact_app.run.ways import first_certified, ways_to
from contact_app.scene.build import build_scene
from contact_app.scene.conditions import Tie
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from solver import Counts, Reason
from tests import scenes
from tests.comparison import solve
from tests.scenes import CONFIGS
from tests.stability.feature_scenes import feature_scene
from tests.stability.friction_scenes import friction_scene


def method_of(scene: Scene) -> str:
    """The method that `auto` chooses."""
    return with_chosen_method(scene).solver.method


def methods(scene: Scene, keeps_subdomains: bool = False) -> list[str | None]:
    """The method of each way to an answer; None for ways without a scene of their own."""
    ways = ways_to(scene, keeps_subdomains)
    return [way.scene.solver.method if way.scene else None for way in ways]


def strip() -> scenes.Config:
    """500 times as long as thick."""
    return scenes.lifted_strip(500.0, [800, 2])


def test_contact_that_peels_off_is_left_to_the_undecomposed_problem() -> None:
    assert MethodChoice.of(scenes.build(strip())).may_peel
    found = solve(strip()).summary
    assert found["certificate"]["passed"]
    assert found["solver"]["method"] == "primal"
    assert not any("Total FETI" in warning for warning in found["certificate"]["warnings"])
    known = solve(strip(), method="primal").summary
    assert found["solution"]["energy"] == pytest.approx(known["solution"]["energy"], rel=1e-7)


@pytest.mark.ratchet
def test_a_strip_that_peels_off_takes_few_operator_applications() -> None:
    counts = solve(strip()).summary["solver"]
    assert counts["hessian_multiplications"] < 600


def test_a_limit_on_iterations_is_respected() -> None:
    found = solve(strip(), max_iterations=20).summary
    assert not found["solver"]["converged"]
    assert found["solver"]["cg_steps"] <= 20


def test_boxes_and_small_bodies_stay_with_total_feti() -> None:
    for name in ("wall", "two_bodies", "sphere"):
        scene = scenes.build(scenes.ALL[name]("hexahedron", 4))
        assert method_of(scene) == "auto"
        assert not MethodChoice.of(scene).may_peel
    assert LIMITS.least > 3 * 5**3
    small = scenes.read("pillow_block", ["bodies.0.degree=1"])
    assert small.unknowns < LIMITS.least
    assert method_of(small) == "auto"


def test_a_named_decomposition_stays_with_total_feti() -> None:
    assert not MethodChoice.of(scenes.build(strip(), [4, 1])).may_peel


@pytest.mark.parametrize("degree", [1, 2])
def test_motions_that_are_held_on_request_meet_their_resistance(degree: int) -> None:
    """The load turns the block about z, and only `hold` resists."""
    made = scenes.ALL["sliding"]("hexahedron", 3)
    body = made["bodies"][0]
    body |= {"hold": ["x", "y", "rz"], "degree": degree}
    made["conditions"].append(
        {"on": f"{body['name']}.z+", "total_moment": [0, 0, 2.0], "total_force": [1.0, 0, 0]}
    )
    found, known = (solve(made, method=m, tolerance=1e-9) for m in ("primal", "auto"))
    assert found.summary["certificate"]["passed"]
    assert found.summary["solver"]["method"] == "primal"
    energies = [s.summary["solution"]["energy"] for s in (found, known)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)
    ours, others = (s.summary["reactions"] for s in (found, known))
    assert [r["on"] for r in ours] == [r["on"] for r in others]
    for mine, other in zip(ours, others, strict=True):
        np.testing.assert_allclose(mine["force"], other["force"], atol=1e-6)
        np.testing.assert_allclose(mine["moment"], other["moment"], atol=1e-6)


class Larger:
    """A mesh that says that it has more nodes, and another thickness if asked to."""

    def __init__(self, mesh: Any, thickness: float | None = None, times: int = 10) -> None:
        self._mesh, self._times, self.upper = mesh, times, np.array(mesh.upper)
        if thickness is not None:
            self.upper[1] = mesh.lower[1] + thickness
        self.size = float(np.prod(self.upper - np.array(mesh.lower)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._mesh, name)

    def nodes_of(self, degree: int) -> int:
        return int(self._times * self._mesh.nodes_of(degree))


def pillow_block(degree: int, thickness: float | None = None) -> Scene:
    """The pillow block with ten times its unknowns, 120 long."""
    scene = scenes.read("pillow_block", [f"bodies.0.degree={degree}"])
    body = scene.bodies[0]
    return replace(scene, bodies=(replace(body, mesh=Larger(body.mesh, thickness)),), cases=())


@pytest.mark.parametrize(
    ("degree", "poisson"),
    [
        (1, None),
        (2, None),
        pytest.param(1, 0.49, id="rubber, where Total FETI takes two to eight times the seconds"),
        (1, 0.4999),
    ],
)
def test_bodies_of_mesh_files_take_multigrid(degree: int, poisson: float | None) -> None:
    scene = pillow_block(degree)
    if poisson is not None:
        (body,) = scene.bodies
        rubber = tuple(replace(material, poisson=poisson) for material in body.materials)
        scene = replace(scene, bodies=(replace(body, materials=rubber),))
    pair = replace(scene, bodies=scene.bodies * 2)
    tied = replace(pair, ties=(Tie(0, "a", 1, "b", "contacts[0]"),))
    assert method_of(scene) == method_of(pair) == method_of(tied) == "primal"


def bimetal_strip(length: float = 30.0) -> scenes.Config:
    """Two tied layers of thickness one, clamped at one end and heated."""
    bodies = [
        {"name": name, "degree": 2,
         "mesh": {"box": {"lower": [0, y], "upper": [length, y + 1], "cells": cells}},
         "material": {"young": 2e5, "poisson": 0.3, "expansion": expansion}}
        for name, y, cells, expansion in (("lower", 0, [60, 2], 1e-5), ("upper", 1, [90, 3], 2e-5))
    ]  # fmt: skip
    clamps = [{"on": f"{body['name']}.x-", "displacement": [0, 0]} for body in bodies]
    heat = [{"in": body["name"], "temperature": 50} for body in bodies]
    return {
        "title": "bimetal strip", "dimension": "plane_stress", "bodies": bodies,
        "conditions": [*clamps, *heat], "solver": {"tolerance": 1e-8},
        "contacts": [{"on": "upper.y-", "against": "lower.y+", "tied": True}],
    }  # fmt: skip


def test_a_bimetal_strip_is_solved_undecomposed_and_agrees_with_total_feti() -> None:
    """Rows of a tie between thin bodies are ill-conditioned in the dual problem."""
    made = bimetal_strip()
    found, known = solve(made).summary, solve(made, method="active-set").summary
    assert found["solver"]["method"] == "primal"
    assert found["certificate"]["passed"]
    assert known["certificate"]["passed"]
    energy = known["solution"]["energy"]
    assert found["solution"]["energy"] == pytest.approx(energy, rel=1e-6)
    thick = scenes.build(bimetal_strip(length=2.0))
    assert method_of(thick) == "auto"
    stop = {"plane": {"point": [0, -0.1], "normal": [0, 1]}}
    made["contacts"].append({"on": "lower.y-", "obstacle": stop})
    assert method_of(scenes.build(made)) == "auto"


def test_with_friction_one_body_takes_multigrid_thick_or_thin() -> None:
    """Load histories are chosen for as single solves are."""
    config = load(CONFIGS / "pillow_block.yaml", ["contacts.0.friction={coulomb: 0.3}"])
    scene = build_scene(config)
    body = scene.bodies[0]

    def made(thickness: float | None = None) -> Scene:
        larger = replace(body, mesh=Larger(body.mesh, thickness))
        return replace(scene, bodies=(larger,), cases=())

    history = scenes.read("press_and_push").steps
    pair = replace(made(), bodies=made().bodies * 2)
    for chosen in (made(), made(thickness=2.0), pair, replace(made(), steps=history)):
        assert method_of(chosen) == "primal"


@pytest.mark.ratchet
def test_with_friction_a_small_scene_from_mesh_files_takes_multigrid() -> None:
    """Total FETI took 345 operator applications, multigrid takes 24."""
    path = CONFIGS / "mindlin.yaml"
    assert scenes.read(path).unknowns < LIMITS.least
    steps = contact_app.solve(path).summary["steps"]
    assert all(step["certificate"]["passed"] for step in steps)
    assert sum(step["solver"]["hessian_multiplications"] for step in steps) <= 40


@pytest.mark.parametrize(
    ("name", "why"),
    [("cube", "share a factor"), ("hertz_disc", "in the plane"), ("bracket", "so few unknowns")],
)
def test_check_gives_the_reason_for_total_feti(name: str, why: str) -> None:
    assert why in MethodChoice.of(scenes.read(name)).why_total_feti


def ways(scene: Scene) -> list[tuple[str, int | None]]:
    """Method and patience of each way with a scene of its own."""
    return [
        (w.scene.solver.method, w.patience) for w in ways_to(with_chosen_method(scene)) if w.scene
    ]


def test_total_feti_follows_multigrid_after_more_iterations_than_any_part_takes() -> None:
    assert ways(pillow_block(1)) == [("primal", LIMITS.patience_of_multigrid), ("auto", None)]


def test_small_thin_bodies_of_mesh_files_begin_with_total_feti() -> None:
    larger = pillow_block(1, thickness=8.0)
    assert larger.unknowns > LIMITS.least_thin
    assert ways(larger) == [("primal", LIMITS.patience_of_multigrid), ("auto", None)]
    mesh = scenes.read("pillow_block").bodies[0].mesh
    body = replace(larger.bodies[0], mesh=Larger(mesh, 8.0, times=3))
    small = replace(larger, bodies=(body,))
    assert LIMITS.least < small.unknowns < LIMITS.least_thin
    assert ways(small) == [("active-set", LIMITS.patience), ("primal", None), ("auto", None)]


def test_factors_of_larger_thin_bodies_cost_more_iterations_of_total_feti() -> None:
    bodies = pillow_block(2, thickness=8.0).bodies
    assert bodies[0].mesh.dimension * bodies[0].nodes > 2 * LIMITS.patience_unknowns
    assert patience(bodies) > 1.4 * LIMITS.patience


def test_friction_that_converges_slowly_is_left_to_multigrid() -> None:
    """Sticking nodes in several contacts can hold conjugate gradients up for thousands of steps."""
    made = scenes.ALL["wall"]("hexahedron", 2)
    made["contacts"][0]["friction"] = {"tresca": 3.0}
    assert methods(scenes.build(made)) == ["active-set", "primal", "auto", None]
    (increment,) = ways_to(scenes.build(made), keeps_subdomains=True)
    assert increment.patience == LIMITS.patience_with_friction
    assert methods(scenes.build(made, 2)) == ["active-set", "primal", "auto", None]
    assert list(ways_to(scenes.build(made)))[0].patience == LIMITS.patience_with_friction
    made["solver"]["method"] = "primal"
    assert methods(scenes.build(made, 2)) == ["primal", "auto", None]


@pytest.mark.ratchet
def test_friction_that_stalls_in_named_subdomains_is_left_to_multigrid() -> None:
    """A block between three rough planes, whose nodes rest in several of them; 10,364 otherwise."""
    made, _ = friction_scene(424014)
    summary = solve_scene(scenes.build(made, 1)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] <= 600


def test_several_bodies_from_mesh_files_with_friction_are_solved_by_multigrid() -> None:
    """Without friction, too, unless the scene is small and a body thin."""

    def chosen(*changes: str) -> str:
        scene = scenes.read("hub_on_shaft", changes)
        return method_of(scene)

    friction = "contacts.0.friction={coulomb: 0.2}"
    assert chosen() == chosen(friction) == "primal"
    coarse = ["bodies.0.degree=1", "bodies.1.degree=1"]
    scene = scenes.read("hub_on_shaft", coarse)
    hub, shaft = scene.bodies
    thin = replace(hub, mesh=Larger(hub.mesh, thickness=2.0, times=2)), shaft
    assert LIMITS.least < replace(scene, bodies=thin).unknowns < LIMITS.least_thin
    assert method_of(replace(scene, bodies=thin)) == "auto"
    pushed = [
        "conditions=[{on: shaft.end, displacement: [0, 0, 0], name: end}]",
        "steps=[{end: 1}]",
    ]
    assert chosen(friction, *pushed) == "primal"


def test_several_bodies_whose_active_sets_do_not_settle_are_left_to_multigrid() -> None:
    """Multigrid has a safeguard for sets that jump, which ends sooner than SMALBE-M."""
    scene = scenes.build(scenes.ALL["two_bodies"]("hexahedron", 2))
    assert methods(scene) == ["active-set", "primal", "auto", None]
    assert "active-set" not in methods(pillow_block(1))


def test_multigrid_is_the_last_way_of_a_method_that_is_named() -> None:
    """SMALBE left tied blocks under a rigid ball uncertified; multigrid certifies them."""
    made, subdomains = feature_scene(61458)
    made["solver"]["method"] = "smalbe"
    scene = scenes.build(made, subdomains)
    assert methods(scene) == ["smalbe", None, "primal"]
    assert [way.keeps for way in ways_to(scene)] == [False, False, True]
    summary = solve_scene(scene).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert "solved by multigrid instead" in summary["certificate"]["warnings"][-1]


def test_an_uncertified_answer_counts_if_multigrid_leaves_none() -> None:
    scene = scenes.build(scenes.ALL["wall"]("hexahedron", 2), 2)
    solved = solve_scene(scene)
    certificate = replace(solved.solution.certificate, passed=False)
    solution = replace(solved.solution, certificate=certificate, reason=Reason.UNSETTLED)
    uncertified = replace(solved, solution=solution)

    def solve(tried: Scene, counts_before: Counts, first: bool) -> SolvedScene:
        if tried.solver.method == "primal":
            raise NoAnswerError("no body is held")
        return uncertified

    answer = first_certified(scene, MPI.COMM_WORLD, solve, Counts())
    assert answer.solution.multiplier is uncertified.solution.multiplier
    assert (
        "multigrid left no certified answer, either: no body is held"
        in answer.solution.certificate.warnings
    )


@pytest.mark.ratchet
def test_one_thin_body_with_friction_in_the_plane_takes_multigrid() -> None:
    """Its factor is inexpensive: Total FETI took 344 operator applications and more."""
    made = load(CONFIGS / "rough_rod.yaml")
    scene = build_scene(made)
    assert method_of(scene) == "primal"
    thick = replace(scene.bodies[0], mesh=Larger(scene.bodies[0].mesh, 100.0))
    assert method_of(replace(scene, bodies=(thick,))) == "auto"
    assert method_of(replace(scene, bodies=scene.bodies * 2)) == "auto"
    counts = solve_scene(scene, MPI.COMM_WORLD).summary["solver"]
    assert counts["converged"]
    assert counts["hessian_multiplications"] <= 60


def test_a_curved_strip_with_friction_is_thin_by_its_area() -> None:
    """A strap over a cylinder took 1,024 operator applications by Total FETI, and 44 so."""
    scene = scenes.read("rough_rod")
    body = scene.bodies[0]
    strap = Larger(body.mesh, 100.0)  # its box is as high as it is long
    strap.size = body.mesh.size
    assert (
        with_chosen_method(replace(scene, bodies=(replace(body, mesh=strap),))).solver.method
        == "primal"
    )
