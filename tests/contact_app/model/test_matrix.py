"""B and its transpose, also with weights, beside the same rows entry by entry."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from solver.problem.constraints.matrix import ConstraintMatrix
from tests import scenes
from tests.ranks import execute

CASES = {
    "cube": ("wall", "hexahedron", [2, 2, 2]),
    "plane": ("two_bodies", "quadrilateral", [2, 2]),
    "tetrahedra": ("wall", "tetrahedron", 5),
    "bodies that hang in springs": ("rollers_and_floor", "quadrilateral", 3),
}


def constraints_of(case: str, comm: MPI.Intracomm = MPI.COMM_SELF) -> ConstraintMatrix:
    name, cell, subdomains = CASES[case]
    B = scenes.problem(scenes.ALL[name](cell, 4), subdomains, comm=comm).B
    assert isinstance(B, ConstraintMatrix)
    return B


def errors_of(B: ConstraintMatrix) -> float:
    """Largest difference of B, W B and their transposes from the same PETSc matrices."""
    rng = np.random.default_rng(B.comm.rank)
    weights = rng.uniform(0.5, 1.0, B.rows)
    worst = 0.0
    for matrix in (B, B.scaled(weights)):
        u, x = rng.standard_normal(B.columns), rng.standard_normal(B.rows)
        out, back = np.full(B.rows, np.nan), np.full(B.columns, np.nan)
        matrix.apply(u, out)
        matrix.apply_transpose(x, back)
        whole = matrix.matrix
        source, target = whole.createVecs()
        source.array, target.array = u, np.nan
        whole.mult(source, target)
        worst = max(worst, float(np.abs(out - target.array).max(initial=0.0)))
        target.array = x
        whole.multTranspose(target, source)
        worst = max(worst, float(np.abs(back - source.array).max(initial=0.0)))
    return float(B.comm.allreduce(worst, op=MPI.MAX))


@pytest.mark.parametrize("case", CASES)
def test_it_is_its_petsc_matrix(case: str) -> None:
    assert errors_of(constraints_of(case)) < 1e-14


def test_weighted_rows_stay_sorted() -> None:
    """PETSc sorts rows on several ranks: entries in another order would be taken for others."""
    B = constraints_of("bodies that hang in springs")
    weights = np.random.default_rng(0).uniform(0.5, 1.0, B.rows)
    weights[::3] = 0.0
    local = B.scaled(weights).local
    places = [local.indices[a:b] for a, b in zip(local.indptr[:-1], local.indptr[1:], strict=True)]
    assert max(map(len, places)) > 1
    assert all((np.diff(row) > 0).all() for row in places)
    assert not any(map(len, places[::3]))
    assert abs(local - sparse.diags(weights) @ B.local).max() == 0.0


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_on_ranks(ranks: int) -> None:
    program = (
        "from mpi4py import MPI\n"
        "from tests.contact_app.model.test_matrix import CASES, constraints_of, errors_of\n"
        "for case in CASES:\n"
        "    error = errors_of(constraints_of(case, MPI.COMM_WORLD))\n"
        "    assert error < 1e-13, (case, error)\n"
    )
    execute(program, ranks=ranks)
