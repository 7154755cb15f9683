"""Rows where more than two subdomains meet, and the oblique projector their weights make."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from contact_app.model.model import build_model
from solver.contact.row_kinds import RowKind
from solver.driver import solve
from solver.tfeti.constraints.cross_points import Neighbours, helmert, joining
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Mask
from tests import scenes
from tests.ranks import execute


def graph(m: int, edges: list[tuple[int, int]]) -> Mask:
    result = np.zeros((m, m), bool)
    for a, b in edges:
        result[a, b] = result[b, a] = True
    return result


def laplacian(adjacent: Mask) -> Array:
    return np.diag(adjacent.sum(axis=1)) - adjacent.astype(float)


@pytest.mark.parametrize("m", range(2, 9))
def test_helmert_rows_span_the_differences_of_copies(m: int) -> None:
    rows = helmert(m)
    np.testing.assert_allclose(rows @ rows.T, np.eye(m - 1), atol=1e-15)
    np.testing.assert_allclose(rows @ np.ones(m), 0, atol=1e-15)


@settings(max_examples=80, deadline=None)
@given(st.integers(2, 9), st.data())
def test_rows_are_orthonormal_and_join_neighbours_alone(m: int, data: st.DataObject) -> None:
    pairs = [(a, b) for a in range(m) for b in range(a)]
    adjacent = graph(m, data.draw(st.lists(st.sampled_from(pairs))))
    rows, weights = joining(adjacent)
    np.testing.assert_allclose(rows @ rows.T, np.eye(m - 1), atol=1e-13)
    np.testing.assert_allclose(rows @ np.ones(m), 0, atol=1e-13)
    assert weights.max() == pytest.approx(1.0)
    assert weights.min() > 0.0
    values = np.linalg.eigvalsh(laplacian(adjacent))
    if values[1] < 1e-9:  # not connected: nothing to choose
        np.testing.assert_array_equal(weights, 1.0)
        return
    joined = rows.T @ (weights[:, None] * rows)
    np.testing.assert_allclose(joined, laplacian(adjacent) / values[-1], atol=1e-12)


def test_neighbours_are_alone_at_a_node() -> None:
    known = Neighbours(MPI.COMM_SELF, np.array([[3, 1], [1, 3], [1, 2]]))
    adjacent = known.adjacent(np.array([[1, 2, 3], [2, 3, 4]]))
    np.testing.assert_array_equal(adjacent[0], graph(3, [(0, 1), (0, 2)]))
    assert not adjacent[1].any()
    none = Neighbours(MPI.COMM_SELF, np.zeros((0, 2), np.int64))
    assert not none.adjacent(np.array([[1, 2, 3]])).any()


CASES = {
    "regular": ("wall", "hexahedron", [3, 3, 3]),
    "unstructured": ("wall", "tetrahedron", 9),
    "two bodies": ("two_bodies", "hexahedron", 4),
}


FEW = TotalFetiOptions(many_subdomains=2)
"""Few subdomains count as many."""


def problem_of(
    case: str, comm: MPI.Intracomm = MPI.COMM_SELF, options: TotalFetiOptions = FEW
) -> DualProblem:
    name, cell, subdomains = CASES[case]
    return scenes.problem(scenes.ALL[name](cell, 6), subdomains, comm, options=options)


def errors_of(problem: DualProblem) -> float:
    """Largest relative error of P² = P, G P = 0 and xᵀ P y = yᵀ Pᵀ x on two sets (collective)."""
    comm, rng = problem.comm, np.random.default_rng(problem.comm.rank)
    assert problem.coarse is not None
    worst = 0.0
    some = problem.inequality & (rng.random(problem.size) < 0.7)
    for touching in (problem.inequality, some):
        coarse = with_active(problem, touching).coarse
        assert coarse is not None
        x, y = rng.standard_normal((2, problem.size))
        once, twice, adjoint = (np.empty(problem.size) for _ in range(3))
        left, whole = np.empty(coarse.kernels), np.empty(coarse.kernels)
        coarse.project(x, once)
        coarse.project(once, twice)
        coarse.project_transpose(y, adjoint)
        coarse.restrict(once, left)
        coarse.restrict(x, whole)
        products = comm.allreduce(np.array([y @ once, adjoint @ x, x @ x]))
        found = [
            np.abs(twice - once).max(initial=0.0),
            np.abs(left).max(initial=0.0) / max(np.abs(whole).max(initial=0.0), 1e-9),
            abs(products[0] - products[1]) / products[2],
        ]
        worst = max(worst, *map(float, found))
    return float(comm.allreduce(worst, op=MPI.MAX))


@pytest.mark.parametrize("case", CASES)
def test_active_sets_have_an_oblique_projector_onto_the_kernel(case: str) -> None:
    assert errors_of(problem_of(case)) < 1e-10


def test_the_coarse_problem_of_an_active_set_couples_neighbours_only() -> None:
    """27 subdomains of six motions, 54 faces; edges count only where there is contact."""
    problem = problem_of("regular")
    assert problem.coarse is not None
    none = with_active(problem, np.zeros(problem.size, bool)).coarse
    assert none is not None
    metric = problem.coarse.metric
    assert set(np.round(metric, 12)) == {0.5, 1.0, np.round(1 / 3, 12), np.round(2 / 3, 12)}
    assert (metric[problem.kinds != RowKind.GLUING] == 1.0).all()
    at_contact = 4 * 2  # the contact's plane has four edges, at each two pairs meet crosswise
    assert none.entries == 36 * (27 + 2 * 54 + 2 * at_contact)
    assert problem.coarse.entries == 36 * 7**3  # 27 neighbours each, less beyond the surface


def test_few_subdomains_and_plane_ones_have_no_weights() -> None:
    plane = build_model(
        scenes.build(scenes.ALL["wall"]("quadrilateral", 12), [12, 9]), MPI.COMM_SELF
    )
    for problem in (problem_of("regular", options=TotalFetiOptions()), plane.problem):
        assert problem.coarse is not None
        assert (problem.coarse.metric == 1.0).all()


@pytest.mark.parametrize("case", CASES)
def test_the_answer_is_the_same(case: str) -> None:
    """With weights and without."""
    made = scenes.ALL[CASES[case][0]](CASES[case][1], 6)
    scene = scenes.build(made, CASES[case][2])
    options = replace(scene.solver, tolerance=1e-8)
    answers = []
    for many in (2, 1000):
        model = build_model(scene, MPI.COMM_SELF, options=TotalFetiOptions(many_subdomains=many))
        assert model.problem.coarse is not None
        assert (model.problem.coarse.metric != 1.0).any() == (many == 2)
        answers.append(solve(model.problem, options, None))
        assert answers[-1].converged
    energies = [a.measures.energy for a in answers]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("shared", [0, 20_000])
def test_on_ranks(shared: int) -> None:
    program = (
        "from mpi4py import MPI\n"
        "from solver.tfeti.derived import with_active\n"
        "from solver.tfeti.constraints.options import TotalFetiOptions\n"
        "from tests.contact_app.model.test_cross_points import CASES, errors_of, problem_of\n"
        f"options = TotalFetiOptions(many_subdomains=2, gathered={shared})\n"
        "for case in CASES:\n"
        "    error = errors_of(problem_of(case, MPI.COMM_WORLD, options))\n"
        "    assert error < 1e-10, (case, error)\n"
        "coarse = problem_of('regular', MPI.COMM_WORLD, options)\n"
        "coarse = with_active(coarse, coarse.inequality).coarse\n"
        "assert coarse.entries == 36 * 151, coarse.entries\n"
    )
    execute(program, ranks=2)
