"""Rows that share nodes, weighed on several ranks as on one."""

import pytest
from mpi4py import MPI

from contact_app.run.solve import solve_scene
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
