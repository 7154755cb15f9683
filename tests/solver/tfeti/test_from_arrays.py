"""Contact problems from plain arrays, against what they are made of."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import lsq_linear

from solver.contact.options import SolverOptions
from solver.driver import solve
from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Subdomain, problem_from_arrays
from tests.solver.lattices import COLUMNS, in_pieces, lattice

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "docs" / "guide" / "string_on_a_floor.py"


def test_the_example_is_short_and_has_the_exact_answer() -> None:
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 60
    imported = {
        node.module if isinstance(node, ast.ImportFrom) else node.names[0].name
        for node in ast.walk(ast.parse("\n".join(lines)))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    roots = {str(name).split(".")[0] for name in imported}
    assert roots == {"numpy", "mpi4py", "petsc4py", "solver"}
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)], capture_output=True, text=True, check=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    first, second = done.stdout.splitlines()
    assert first == "certified: True, by active-set"
    assert second == "the floor carries 0.3675 of 1 (exact: 0.3675); lowest -0.0500"


GAP = 0.2


def beam(load: float, pieces: int = 3) -> DualProblem:
    """A lattice held on its left, pulled down on its right end, above a floor, in pieces."""
    width = pieces * COLUMNS
    return in_pieces(COLUMNS, pieces, lambda x: load * (x[:, 0] == width), np.full(width, GAP))


def reference(load: float, pieces: int = 3) -> float:
    """Force of the floor by bounded least squares on the whole lattice."""
    points, K = lattice(pieces * COLUMNS)
    free = np.flatnonzero(np.repeat(points[:, 0] > 0, 2))
    f = np.zeros((len(points), 2))
    f[points[:, 0] == points[:, 0].max(), 1] = -load
    lower = np.full(2 * len(points), -np.inf)
    lower[2 * np.flatnonzero(points[:, 1] == 0) + 1] = -GAP
    chol = np.linalg.cholesky(K[np.ix_(free, free)])
    rhs = np.linalg.solve(chol, f.ravel()[free])
    found = lsq_linear(chol.T, rhs, (lower[free], np.full(len(free), np.inf)), tol=1e-14)
    return float((K[np.ix_(free, free)] @ found.x - f.ravel()[free])[1::2].sum())


def floor_force(problem: DualProblem) -> float:
    answer = solve(problem, SolverOptions(tolerance=1e-10))
    assert answer.converged
    return float((answer.multiplier * problem.spread)[problem.inequality].sum())


@pytest.mark.parametrize("load", [0.004, 0.05])
def test_a_lattice_in_three_subdomains_has_the_answer_of_one(load: float) -> None:
    """Its kernel is the rigid motions of its points."""
    expected = reference(load)
    assert expected > 0.01 * load
    problem = beam(load)
    assert len(problem.classes) == 1
    assert problem.held_without_contact
    assert floor_force(problem) == pytest.approx(expected, rel=1e-6)


def test_another_load_needs_no_factor_and_no_constraint() -> None:
    problem = beam(0.004)
    assert floor_force(problem) == pytest.approx(reference(0.004), rel=1e-6)
    heavier = problem.with_loads([12.5 * f for f in problem.forces])
    assert heavier.classes is problem.classes
    assert heavier.coarse is problem.coarse
    assert heavier.F is problem.F
    assert floor_force(heavier) == pytest.approx(reference(0.05), rel=1e-6)


def test_a_condition_at_a_node_of_no_subdomain_is_refused() -> None:
    points, K = lattice(1)
    piece = Subdomain(K, np.zeros(len(K)), np.arange(len(points)), points)
    nowhere = Held(np.array([99]), np.ones((1, 2), bool), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="names a node"):
        problem_from_arrays(MPI.COMM_SELF, [piece], nowhere, [])


def test_a_kernel_that_the_stiffness_resists_is_refused() -> None:
    points, K = lattice(1)
    wrong = np.eye(len(K))[:, :1]
    piece = Subdomain(K, np.zeros(len(K)), np.arange(len(points)), points, kernel=wrong)
    held = Held(np.array([0]), np.ones((1, 2), bool), np.zeros((1, 2)))
    with pytest.raises(ArithmeticError, match="resists"):
        problem_from_arrays(MPI.COMM_SELF, [piece], held, [])
