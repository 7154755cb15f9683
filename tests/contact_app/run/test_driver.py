"""The method follows the scene: conjugate gradients, active sets or SMALBE, with or without
gluing."""

import gc
import itertools
import weakref
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from contact_app.run.solve import solve_scene
from solver.backend import Statuses
from solver.contact.active_set_options import ActiveSetOptions
from solver.driver import solve
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.tfeti.active_set_problem import ActiveSetProblem, State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible_multiplier import feasible_multiplier
from solver.tfeti.methods.answers import certified_answer
from solver.vectors import Array, Mask
from tests import scenes
from tests.loops import loop


@cache
def summary(name: str, *overrides: str) -> dict[str, Any]:
    return solve_scene(scenes.read(name, overrides)).summary


def test_a_scene_that_touches_nothing_ends_with_conjugate_gradients() -> None:
    found = summary("cube", "contacts.0.obstacle.plane.point=[2,0,0]")
    assert found["certificate"]["passed"]
    assert found["solver"]["outer_iterations"] == 0
    assert found["solution"]["active_contacts"] == 0
    without = summary("cube", "contacts=[]")
    assert found["solution"]["energy"] == pytest.approx(without["solution"]["energy"], rel=1e-9)


def test_only_subdomains_with_a_load_are_solved() -> None:
    """A traction on the top loads four of eight subdomains."""
    scene = scenes.read(
        "cube", ["bodies.0.mesh.box.cells=[8,8,8]", "decomposition.subdomains=[2,2,2]"]
    )
    problem = build_model(scene, MPI.COMM_SELF).problem
    (cls,), (loads,) = problem.classes, problem.loads
    loaded = np.flatnonzero(loads.any(axis=0))
    asked: list[int] = []

    class Counting:
        def solve(self, loads: Array) -> Array:
            asked.append(loads.shape[1])
            return cls.inverse.solve(loads)

    counting = replace(problem, classes=(replace(cls, inverse=Counting()),))
    free = counting.free_displacements.reshape(cls.members, -1)
    assert len(loaded) == 4
    assert asked == [4]
    each = cls.solve(np.asfortranarray(loads))
    np.testing.assert_allclose(free, each[cls.interface].T, atol=1e-12 * np.abs(each).max())
    zero = np.zeros(problem.size)
    work = counting.strain_energy(zero, counting.d)
    assert work == pytest.approx(float(np.vdot(loads, each)), rel=1e-12)


def test_one_held_subdomain_has_neither_gluing_nor_coarse_problem() -> None:
    overrides = ["decomposition.subdomains=[1,1,1]", "bodies.0.mesh.box.cells=[6,6,6]"]
    scene = scenes.read("cube", overrides)
    model = build_model(scene, MPI.COMM_SELF)
    assert model.problem.coarse is None
    assert model.problem.size == 42  # the wall's nodes less those of the foot


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("cylinder", ["bodies.0.degree=1", "bodies.0.mesh.box.cells=[30,20,3]"]),
        ("tilted_plane", []),
        ("plate_and_pins", []),
    ],
)
@pytest.mark.ratchet
def test_active_sets_solve_scenes_on_which_smalbe_is_slow(name: str, overrides: list[str]) -> None:
    """Bodies that bend, and one held by contact alone: SMALBE takes 911, 367 and 332 products."""
    found = summary(name, *overrides)
    assert found["certificate"]["passed"]
    assert found["solver"]["hessian_multiplications"] < 150


def test_an_expansion_without_a_method_means_the_papers_algorithm() -> None:
    found = summary("cube", "solver.expansion=fixed")["solver"]
    assert found["method"] == "smalbe"
    assert found["expansion_steps"] > 0
    assert (
        summary("cube", "solver={expansion: fixed, method: auto}")["solver"]["method"] != "smalbe"
    )


def test_active_sets_that_do_not_settle_are_reported() -> None:
    scene = scenes.read("cube", ["solver.method=active-set"])
    problem = build_model(scene, MPI.COMM_SELF).problem
    found = solve(problem, scene.solver, active_sets=ActiveSetOptions(most_sets=2))
    assert found.reason is Reason.UNSETTLED
    assert not found.converged
    assert found.counts.hessian > 0


@pytest.mark.ratchet
def test_the_default_cube_stays_cheap() -> None:
    """The paper's best expansion takes 269 products on its mesh, this scene 39."""
    assert summary("cube")["solver"]["hessian_multiplications"] <= 45


def test_a_repaired_multiplier_is_admissible() -> None:
    """λ ≥ 0 on contact rows and Gλ = e, whatever iterate it starts from."""
    made = scenes.ALL["floating_in_corner"]("hexahedron", 4)
    problem = scenes.problem(made, [2, 2, 2])
    assert problem.coarse is not None
    random = np.random.default_rng(3)
    size = np.abs(problem.offset).max()
    x = 1e-3 * size * random.normal(size=problem.size)
    assert problem.lower is not None
    x = np.maximum(x, problem.lower)
    repaired = feasible_multiplier(problem, problem.offset + x, x > problem.lower)
    assert (repaired[problem.inequality] >= 0).all()
    work = np.empty(len(problem.e))
    problem.coarse.restrict(repaired, work)
    np.testing.assert_allclose(work, problem.e, atol=1e-11 * np.abs(problem.e).max())


def test_an_answer_far_from_the_solution_is_not_certified() -> None:
    scene = scenes.build(scenes.ALL["wall"]("hexahedron", 4), [2, 2, 2])
    problem = build_model(scene, MPI.COMM_SELF).problem
    answer = certified_answer(problem, np.zeros(problem.size), None, 1e-9)
    assert not answer.certificate.passed
    assert answer.certificate.duality_gap > 1e-3
    assert answer.certificate.equilibrium < 1e-9


def cube_problem() -> DualProblem:
    return build_model(scenes.read("cube"), MPI.COMM_SELF).problem


def test_an_active_set_is_let_go_before_the_next_is_made() -> None:
    """Without waiting for Python's collector: on large problems each holds a gigabyte."""
    made: list[weakref.ref[ActiveSetProblem]] = []
    alive: list[int] = []

    class Watched(TotalFeti):
        def on_set(self, statuses: Statuses, multiplier: Any) -> ActiveSetProblem:
            alive.append(sum(one() is not None for one in made))
            found = super().on_set(statuses, multiplier)
            made.append(weakref.ref(found))
            return found

    backend = Watched(cube_problem())
    gc.disable()
    try:
        loop(backend)
    finally:
        gc.enable()
    assert len(alive) > 3
    assert max(alive) == 0


def test_active_sets_that_come_back_are_decided_later() -> None:
    """The second set is made to lead back to the first one, as a set left too early may."""
    residuals: list[list[float]] = []
    first: list[Mask] = []

    class Recorded(ActiveSetProblem):
        def solve(self, inner: MPRGP, residual: float, *rest: Any) -> Reason:
            residuals[-1].append(residual / self.residual)
            return super().solve(inner, residual, *rest)

        def state(self) -> State:
            state = super().state()
            if (
                len(residuals) == 2
            ):  # all rows of the first set penetrate, the others are in tension
                contact, back = self.problem.inequality, first[0]
                jumps = np.where(back, 1.0, -1.0) * np.abs(state.jumps).max()
                pull = np.where(back, 1.0, -1.0) * np.abs(state.multiplier).max()
                state = replace(
                    state,
                    jumps=np.where(contact, jumps, state.jumps),
                    multiplier=np.where(contact, pull, state.multiplier),
                )
            return state

    class Hasty(TotalFeti):
        def on_set(self, statuses: Statuses, multiplier: Any) -> ActiveSetProblem:
            residuals.append([])
            first.append(statuses.active)
            if len(residuals) == 3:
                multiplier = None
            return Recorded(self.problem, statuses, multiplier)

    problem = cube_problem()
    found = loop(Hasty(problem))
    assert found.reason is Reason.ACCEPTED
    np.testing.assert_array_equal(first[2], first[0])
    assert residuals[1][0] == pytest.approx(residuals[0][0])
    assert residuals[2][0] == pytest.approx(0.1 * residuals[0][0])


def test_rows_of_b_come_one_face_edge_or_corner_after_another() -> None:
    """Rows that touch the same subdomains are one run of them; contact rows last, by node."""
    made = scenes.ALL["wall"]("hexahedron", 6)
    problem = scenes.problem(made, [3, 3, 3])
    begins, columns, _ = problem.B.matrix.getValuesCSR()
    widths = [len(c.interface) for c in problem.classes for _ in range(c.members)]
    subdomain = np.repeat(np.arange(len(widths)), widths)
    contact = np.flatnonzero(problem.inequality)
    assert contact[0] == problem.size - len(contact)
    touched = [tuple(subdomain[part]) for part in np.split(columns, begins[1:-1])][: contact[0]]
    runs = 1 + sum(one != next for one, next in itertools.pairwise(touched))
    assert runs == len(set(touched))
    assert (np.diff(problem.contact.nodes) >= 0).all()
