"""Rows where more than two subdomains meet, and the oblique projector their weights make."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from solver.contact.row_kinds import RowKind
from solver.driver import solve
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.ranks import execute

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
