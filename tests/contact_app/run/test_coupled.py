"""Rows that share nodes, weighed on several ranks as on one."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from contact_app.run.solve import solve_scene
from solver.tfeti.coupled import FactorOfParts
from tests import scenes
from tests.ranks import execute
from tests.scenes import CONFIGS

HEXAHEDRA, PART = "stack", "hub_on_shaft"


def applications(name: str, comm: MPI.Intracomm) -> int:
    """Operator applications of a shipped scene of pairs, by active sets, at degree 1."""
    path = CONFIGS / f"{name}.yaml"
    asked = ["solver.method=active-set", "solver.tolerance=1e-8"]
    asked += [f"bodies.{i}.degree=1" for i in range(2)]
    solved = solve_scene(scenes.read(path, asked), comm)
    assert solved.solution.certificate.passed
    return int(solved.solution.counts.hessian)


def test_equal_parts_share_a_factor() -> None:
    """Three parts of M, two of them equal but for a row that is not free."""
    random = np.random.default_rng(3)
    one, other = (0.1 * random.random((5, 5)) for _ in range(2))
    blocks = [part + part.T + np.eye(5) for part in (one, one, other)]
    M = sparse.block_diag(blocks, format="csc")
    order = random.permutation(5)
    mixed = np.argsort(np.concatenate([order, order, order]) * 3 + np.repeat(range(3), 5))
    M, values, factor = M[mixed][:, mixed], random.random(15), FactorOfParts(M[mixed][:, mixed])
    for held in ([], [4]):
        free = ~np.isin(np.arange(15), held)
        expected = np.zeros(15)
        expected[free] = np.linalg.solve(M.toarray()[free][:, free], values[free])
        np.testing.assert_allclose(factor.solve(values, free), expected, atol=1e-14)


@pytest.mark.mpi
@pytest.mark.ratchet
@pytest.mark.parametrize("name", [HEXAHEDRA, PART])
def test_two_ranks_take_as_many_applications_as_one(name: str) -> None:
    """With the entries of rows in another order than PETSc's: 765 and 75 instead of 26 and 29."""
    program = (
        "import sys\n"
        "from mpi4py import MPI\n"
        "from tests.contact_app.run.test_coupled import applications\n"
        "count = applications(sys.argv[1], MPI.COMM_WORLD)\n"
        "if MPI.COMM_WORLD.rank == 0:\n"
        "    print(count)\n"
    )
    one, two = (int(execute(program, name, ranks=ranks)) for ranks in (1, 2))
    assert two <= 1.2 * one
