"""The last way to an answer, Newton's method on displacements, against the reference."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from solver import Reason
from solver.contact.options import SolverOptions
from solver.driver import solve as solve_problem
from solver.primal.newton import NewtonOptions, solve_by_newton
from solver.tfeti.certify import certify
from tests import scenes
from tests.comparison import reference_of
from tests.contact_app.model.test_rigid import ball_on_block, mixed, plate_on_held
from tests.ranks import execute
from tests.rows import covering

NAMES = [
    "wall", "tilted_plane", "hollow_sphere", "floating_in_corner", "two_planes",
    "duplicate_obstacles", "two_bodies", "initially_penetrating", "no_contacts",
]  # fmt: skip


@pytest.mark.parametrize(("subdomains", "name"), covering([None, 1, [2, 1, 1]], NAMES))
def test_certified_to_rounding_errors(name: str, subdomains: int | list[int] | None) -> None:
    cell = "hexahedron"
    n = 4 if name == "two_bodies" else 2
    made = scenes.ALL[name](cell, n)
    if subdomains == 1:
        subdomains = len(made["bodies"])
    problem = build_model(scenes.build(made, subdomains), MPI.COMM_SELF).problem
    found = solve_by_newton(problem)
    assert found.reason is Reason.CONVERGED
    assert (found.multiplier[problem.inequality] >= 0.0).all()
    certificate, measures = certify(problem, found.multiplier, found.displacements, 1e-9)
    assert certificate.passed, certificate
    known = reference_of(name, cell, n)
    assert measures.energy == pytest.approx(known.energy, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("name", ["mixed", "ball", "plate"])
def test_rigid_bodies_have_unknowns_of_their_own(name: str) -> None:
    """A ball on tied blocks beside a roller; a ball; a plate on a held node and elastic ones."""
    made = {"mixed": mixed, "ball": lambda: ball_on_block("hexahedron", 4), "plate": plate_on_held}
    problem = build_model(scenes.build(made[name]()), MPI.COMM_SELF).problem
    found, known = solve_by_newton(problem), solve_problem(problem, SolverOptions(tolerance=1e-10))
    assert found.reason is Reason.CONVERGED
    certificate, measures = certify(problem, found.multiplier, found.displacements, 1e-9)
    assert certificate.passed, certificate
    assert measures.energy == pytest.approx(known.measures.energy, rel=1e-9)


def test_it_begins_with_given_contact_forces() -> None:
    problem = build_model(scenes.build(scenes.wall("hexahedron", 4)), MPI.COMM_SELF).problem
    cold = solve_by_newton(problem)
    warm = solve_by_newton(problem, cold.multiplier)
    assert warm.counts.hessian < cold.counts.hessian
    scale = np.abs(cold.multiplier).max()
    assert np.abs(warm.multiplier - cold.multiplier).max() < 1e-9 * scale


def test_the_monitor_can_stop_it() -> None:
    problem = build_model(scenes.build(scenes.wall("hexahedron", 4)), MPI.COMM_SELF).problem
    seen = []
    found = solve_by_newton(problem, monitor=lambda step: seen.append(step) or len(seen) == 3)
    assert found.reason is Reason.STOPPED
    assert len(seen) == 3
    limited = solve_by_newton(problem, options=NewtonOptions(inner=2))
    assert limited.reason is Reason.MAX_ITERATIONS
    assert limited.counts.hessian == 2


PROGRAM = """
import json, sys
from mpi4py import MPI
from solver.tfeti.certify import certify
from contact_app.model.model import build_model
from solver.primal.newton import solve_by_newton
from tests import scenes
made = scenes.ALL[sys.argv[1]]("hexahedron", 4)
problem = build_model(scenes.build(made, [2, 1, 2]), MPI.COMM_WORLD).problem
found = solve_by_newton(problem)
certificate, measures = certify(problem, found.multiplier, found.displacements, 1e-9)
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps({"energy": measures.energy, "passed": certificate.passed}))
"""


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["wall", "floating_in_corner"])
def test_the_same_on_two_ranks(name: str) -> None:
    told = []
    for ranks in (1, 2):
        told.append(json.loads(execute(PROGRAM, name, ranks=ranks).splitlines()[-1]))
    assert all(one["passed"] for one in told)
    assert told[0]["energy"] == pytest.approx(told[1]["energy"], rel=1e-11)
