"""The contact of rigid subdomains on a Winkler foundation, beside a general optimiser."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import minimize

from contact_app.model.model import build_model
from contact_app.run.solve import solve_scene
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.by_active_sets import gaps_are_zero
from solver.tfeti.winkler import WinklerOptions, contact_stiffness, winkler_contact
from tests import scenes

CASES = {
    "corner, hexahedra": ("floating_in_corner", "hexahedron", [2, 2, 2]),
    "corner, graph": ("floating_in_corner", "triangle", 3),
    "hollow sphere": ("rolling_in_hollow_sphere", "tetrahedron", 2),
}


def problem_of(case: str) -> DualProblem:
    name, cell, subdomains = CASES[case]
    return scenes.problem(scenes.ALL[name](cell, 4), subdomains)


@pytest.mark.parametrize("case", CASES)
def test_rigid_bodies_on_springs(case: str) -> None:
    problem = problem_of(case)
    assert problem.coarse is not None
    assert not problem.held_without_contact
    B = dense(problem)
    diagonal = np.concatenate(
        [np.tile(c.stiffness.diagonal()[c.interface], c.members) for c in problem.classes]
    )
    own = np.array([row**2 @ diagonal for row in B])
    springs, top = contact_stiffness(problem)
    np.testing.assert_allclose(springs, own[problem.inequality], rtol=1e-12)
    assert top == diagonal.max()
    k = np.where(problem.inequality, np.minimum(WinklerOptions().softness * own, top), top)
    G = np.array([column(problem, i) for i in range(problem.coarse.kernels)])

    def phi(alpha: np.ndarray) -> tuple[float, np.ndarray]:
        pull = problem.d - alpha @ G
        pull = np.where(problem.inequality, np.maximum(pull, 0.0), pull)
        return 0.5 * float(k @ pull**2) + float(problem.e @ alpha), problem.e - G @ (k * pull)

    found = minimize(phi, np.zeros(len(G)), jac=True, method="BFGS", options={"maxiter": 5000})
    reached = phi(found.x)
    pull = problem.d - found.x @ G
    decided = problem.inequality & (np.abs(pull) > 1e-4 * np.abs(pull).max())
    assert np.linalg.norm(reached[1]) < 1e-3 * np.linalg.norm(problem.e)
    touching = winkler_contact(problem)
    np.testing.assert_array_equal(touching[decided], pull[decided] > 0.0)
    assert touching.any()
    assert not touching[~problem.inequality].any()


def dense(problem: DualProblem) -> np.ndarray:
    columns = []
    for i in range(problem.B.columns):
        unit, out = np.zeros(problem.B.columns), np.empty(problem.size)
        unit[i] = 1.0
        problem.B.apply(unit, out)
        columns.append(out)
    return np.array(columns).T


def column(problem: DualProblem, i: int) -> np.ndarray:
    assert problem.coarse is not None
    unit, out = np.zeros(problem.coarse.kernels), np.empty(problem.size)
    unit[i] = 1.0
    problem.coarse.extend(unit, out)
    return out


@pytest.mark.ratchet
def test_a_ball_on_a_plane_needs_few_products() -> None:
    """It takes 104 if sets begin at the multiplier of least norm, which presses all over the
    ball."""
    solved = solve_scene(scenes.read("hertz_sphere"), MPI.COMM_SELF)
    assert solved.summary["certificate"]["passed"]
    assert solved.summary["solver"]["outer_iterations"] == 0
    assert solved.summary["solver"]["hessian_multiplications"] < 60


@pytest.mark.parametrize(
    ("name", "flat"),
    [("wall", True), ("tilted_plane", False), ("sphere", False), ("duplicate_obstacles", False)],
)
def test_flat_boundaries(name: str, flat: bool) -> None:
    """All gaps are closed, and no node has two equal rows."""
    scene = scenes.build(scenes.ALL[name]("hexahedron", 4), [2, 2, 2])
    assert gaps_are_zero(build_model(scene, MPI.COMM_SELF).problem) is flat


FINE = ["bodies.0.mesh.box.cells=[40, 40, 40]", "decomposition={subdomains: [10, 10, 10]}"]


@pytest.mark.parametrize(
    ("scene", "overrides", "products"), [("cube", FINE, 18), ("bracket", [], 58)]
)
@pytest.mark.ratchet
def test_bodies_that_lie_flat_need_few_products(
    scene: str, overrides: list[str], products: int
) -> None:
    """The cube's wall takes 19 from the springs' guess on, the bracket 63 peeled row by row."""
    built = scenes.read(scene, overrides)
    solved = solve_scene(built, MPI.COMM_SELF)
    assert solved.summary["certificate"]["passed"]
    assert solved.summary["solver"]["hessian_multiplications"] <= products
