"""G Gᵀ made of blocks, beside G applied as it is written."""

import numpy as np
import pytest
from mpi4py import MPI

from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.ranks import execute

CASES = {
    "hexahedra": ("wall", "hexahedron", [2, 3, 2]),
    "triangles": ("wall", "triangle", 5),
    "two bodies": ("two_bodies", "hexahedron", 4),
    "two dimensions": ("rollers_and_floor", "quadrilateral", 3),
    "in a hollow sphere": ("rolling_in_hollow_sphere", "tetrahedron", 3),
}


def problem_of(
    case: str, comm: MPI.Intracomm = MPI.COMM_SELF, options: TotalFetiOptions | None = None
) -> DualProblem:
    name, cell, subdomains = CASES[case]
    return scenes.problem(scenes.ALL[name](cell, 4), subdomains, comm, options=options)


def error_of(problem: DualProblem) -> float:
    """Largest error of (G W Gᵀ)⁻¹ G W Gᵀ α, with and without weights of contact rows."""
    rng = np.random.default_rng(problem.comm.rank)
    weights = np.where(problem.inequality, rng.uniform(0.2, 1.0, problem.size), 1.0)
    assert problem.coarse is not None
    worst = 0.0
    for coarse in (problem.coarse, problem.coarse.weighted(weights)):
        alpha = rng.standard_normal(coarse.kernels)
        dual = np.empty(problem.size)
        coarse.extend(alpha, dual)
        found = coarse.coefficients(dual)
        worst = max(worst, float(np.abs(found - alpha).max(initial=0.0)))
    return float(problem.comm.allreduce(worst, op=MPI.MAX))


@pytest.mark.parametrize("case", CASES)
def test_its_factor_undoes_products_with_g(case: str) -> None:
    assert error_of(problem_of(case)) < 1e-8


def test_rows_are_taken_in_chunks() -> None:
    assert error_of(problem_of("hexahedra", options=TotalFetiOptions(chunk=100))) < 1e-8


@pytest.mark.mpi
@pytest.mark.parametrize("shared", [0, 20_000])
def test_on_ranks(shared: int) -> None:
    """In parts and whole on every rank."""
    program = (
        "from mpi4py import MPI\n"
        "from solver.tfeti.constraints.options import TotalFetiOptions\n"
        "from tests.contact_app.model.test_gram import CASES, error_of, problem_of\n"
        f"options = TotalFetiOptions(gathered={shared})\n"
        "for case in CASES:\n"
        "    error = error_of(problem_of(case, MPI.COMM_WORLD, options))\n"
        "    assert error < 1e-8, (case, error)\n"
    )
    execute(program, ranks=2)
