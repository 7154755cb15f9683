"""Bodies with friction that touch and that no load presses: all contact forces are zero."""

import numpy as np
import pytest

from solver.problem.certify import friction_numbers
from tests import scenes
from tests.comparison import solve
from tests.contact_app.run.test_friction import pair


@pytest.mark.ratchet
@pytest.mark.parametrize("method", ["active-set", "primal"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_forces_that_fade_from_set_to_set_are_zero(cell: str, method: str) -> None:
    """A block on another one is moved along it: friction and contact forces cause each other.

    They fell by a constant factor in each set. Total FETI took 39 to 614 operator applications, and
    multigrid was not certified.
    """
    made = pair(cell, {"coulomb": 0.6})
    made["conditions"][1]["displacement"] = scenes.vector(cell, 0.02, 0.012, 0.0)
    summary = solve(made, 4, tolerance=1e-8, method=method).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == method
    assert summary["solver"]["hessian_multiplications"] <= 30
    assert summary["solution"]["max_contact_pressure"] == 0.0


def test_rigid_plate_that_touches_without_load_slides_without_forces() -> None:
    """It may sink, tilt and turn, and nothing presses it: no set of contact points holds it."""
    plane = {"point": [5, 5, 5], "normal": [0, 0, -1]}
    made = {
        "dimension": 3,
        "bodies": [
            scenes.box("block", [10, 10, 5], [4, 4, 2]),
            {"name": "plate", "rigid": {"plane": plane}},
        ],
        "conditions": [
            {"on": "block.z-", "displacement": [0, 0, 0]},
            {"in": "plate", "displacement": [0.01, 0, None]},
        ],
        "contacts": [{"on": "block.z+", "against": "plate", "friction": {"coulomb": 0.3}}],
    }
    summary = solve(made, 1).summary
    assert summary["certificate"]["passed"]
    assert summary["solution"]["max_contact_pressure"] == 0.0
    assert summary["solution"]["energy"] < 1e-30


def test_excess_of_friction_counts_at_all_points_together() -> None:
    """On fine meshes many small forces beyond their limits are a large force."""
    solved = solve(pair("quadrilateral", {"coulomb": 0.3}), 4)
    problem, multiplier = solved.model.problem, solved.solution.multiplier.copy()
    points = problem.friction
    multiplier[points.rows] *= 1.5
    size, limit = points.sizes(points.forces(multiplier)), points.slip_limits(multiplier)
    excess = np.maximum(size - limit, 0.0)
    one, comm = np.ones(problem.bodies.count), problem.comm
    numbers = friction_numbers(problem, multiplier, np.zeros(problem.size), one, one)
    assert comm.allreduce(int((excess > 0.0).sum())) > 1
    assert numbers["friction_cone"] == pytest.approx([comm.allreduce(float(excess.sum()))] * 2)
