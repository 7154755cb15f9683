"""The mirror image of tensile rows, beside its definition on a line and on a surface."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from solver.contact.active_set_options import ActiveSetOptions
from solver.driver import solve
from solver.tfeti.constraints.contact_edge import SLACK, mirror_image
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.hard_scenes import wall
from tests.ranks import execute

CASES = {"line": ("quadrilateral", 40, [3, 2]), "surface": ("hexahedron", 20, [2, 2, 2])}


def problem_of(case: str, name: str = "wall", comm: MPI.Intracomm = MPI.COMM_SELF) -> DualProblem:
    cell, n, subdomains = CASES[case]
    return build_model(scenes.build(scenes.ALL[name](cell, n), subdomains), comm).problem


def band(problem: DualProblem, rows: int, n: int, source: int = 0) -> np.ndarray:
    """Contact rows of the wall nearer to its top edge than so many rows of n."""
    contact = problem.contact
    height = contact.points[:, problem.dimension - 1]
    result = np.zeros(problem.size, bool)
    result[problem.inequality] = (1.0 - height < (rows - 0.5) / n) & (contact.sources == source)
    return result


@pytest.mark.parametrize("rows", [3, 6, 9])
@pytest.mark.parametrize("case", CASES)
def test_a_band_at_an_edge_opens_twice_as_wide_but_for_the_slack(case: str, rows: int) -> None:
    problem, n = problem_of(case), CASES[case][1]
    found = mirror_image(problem, problem.inequality, band(problem, rows, n))
    wide = 2 * rows - int(SLACK[problem.dimension])
    expected = band(problem, max(wide, rows), n) & ~band(problem, rows, n)
    np.testing.assert_array_equal(found, expected)
    assert found.any() == (wide > rows)


@pytest.mark.parametrize("case", CASES)
def test_nothing_opens_where_nothing_or_all_pulls(case: str) -> None:
    problem = problem_of(case)
    none = np.zeros(problem.size, bool)
    for pulling in (none, problem.inequality):
        assert not mirror_image(problem, problem.inequality, pulling).any()


def test_open_rows_and_other_contacts_stay_as_they_are() -> None:
    """Rows of three obstacles lie at the same nodes; of one the middle of the wall is open."""
    problem, n = problem_of("line", "duplicate_obstacles"), CASES["line"][1]
    open_rows = band(problem, 30, n) & ~band(problem, 12, n)
    found = mirror_image(problem, problem.inequality & ~open_rows, band(problem, 8, n))
    assert found.sum() == 12 - 8
    assert not (found & ~band(problem, 12, n)).any()
    all_of_one = band(problem, n + 2, n)
    assert not mirror_image(problem, problem.inequality, all_of_one).any()


def test_on_ranks() -> None:
    program = (
        "from mpi4py import MPI\n"
        "from tests.contact_app.tfeti.test_contact_edge import CASES, band, problem_of\n"
        "from solver.tfeti.constraints.contact_edge import mirror_image\n"
        "for case in CASES:\n"
        "    counts = []\n"
        "    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):\n"
        "        problem, n = problem_of(case, comm=comm), CASES[case][1]\n"
        "        found = mirror_image(problem, problem.inequality, band(problem, 7, n))\n"
        "        counts.append(comm.allreduce(int(found.sum())))\n"
        "    assert counts[0] == counts[1] > 0, (case, counts)\n"
    )
    execute(program, ranks=3)


@pytest.mark.ratchet
def test_contact_ends_in_fewer_active_sets() -> None:
    """The fine wall takes 28 instead of 33 operator applications, with the same answer."""
    scene = scenes.build(wall(320))
    problem = build_model(scene, MPI.COMM_SELF).problem
    few = solve(problem, scene.solver)
    many = solve(problem, scene.solver, active_sets=ActiveSetOptions(release_at_edge=False))
    assert few.converged
    assert many.converged
    assert few.counts.hessian <= many.counts.hessian - 4
    assert few.measures.energy == pytest.approx(many.measures.energy, rel=1e-8)
