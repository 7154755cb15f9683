"""Bodies that only contact holds: active sets jump, and the augmented Lagrangian settles them."""

from pathlib import Path

import numpy as np
import pytest

from solver.contact.stopping import StoppingRule
from solver.primal import by_active_sets
from solver.primal.factor import FactorOptions
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from tests import scenes
from tests.bearings import half_bearing
from tests.comparison import solve


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("cell", "balls", "counts", "tolerance", "most"),
    [
        ("tetrahedron", 4, (8, 4), 1e-6, 110),
        ("hexahedron", 3, (8, 6), 1e-6, 110),
        ("quadrilateral", 3, (12, 10), 1e-6, 200),
        ("quadrilateral", 4, (12, 10), 1e-8, 200),  # 41 to 159 by the BLAS kernel
        ("quadrilateral", 7, (12, 10), 1e-6, 250),
        ("triangle", 7, (12, 10), 1e-8, 250),
    ],
)
def test_bodies_that_only_contact_holds_are_solved_by_multigrid(
    cell: str, balls: int, counts: tuple[int, int], tolerance: float, most: int, tmp_path: Path
) -> None:
    """A set that does not hold a body moves it far; without the Lagrangian there is no answer.

    Some rollers in the plane carry no load, so that no set holds them. They turn so far that K u
    has no digits, and along their motions L has no least value but that of its rounding errors.
    """
    made = half_bearing(tmp_path, cell, balls, counts)
    summary = solve(made, None, tolerance=tolerance, method="primal").summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == "primal"
    assert summary["solver"]["hessian_multiplications"] <= most


def test_rollers_without_load_do_not_keep_a_bearing_from_its_certificate(tmp_path: Path) -> None:
    """The middle one of three rollers carries everything; the others hardly touch."""
    made = half_bearing(tmp_path, "quadrilateral", balls=3, counts=(12, 10))
    summary = solve(made, None, tolerance=1e-6).summary
    assert summary["certificate"]["passed"]
    forces = [np.linalg.norm(contact["force"]) for contact in summary["contacts"]]
    assert forces[2] == pytest.approx(forces[3], rel=1e-6)
    assert max(forces[:2] + forces[4:]) <= 1e-6 * forces[2]


@pytest.mark.parametrize("thin", [12.0, 100.0])
def test_a_plate_that_peels_off_settles_by_factors_or_by_sets_that_release_few_rows(
    thin: float,
) -> None:
    """It lies flat on the second set; without a constraint hierarchy each set releases a few rows.

    Factors solve on the hierarchy if the body counts as thin.
    """
    made = {
        "dimension": 3,
        "bodies": [scenes.box("plate", [50, 20, 2], [25, 10, 2], young=2.1e5)],
        "conditions": [{"in": "plate", "force": [0, 0, -2e-3]},
                       {"on": "plate.x-", "displacement": [0, 0, None]},
                       {"on": "plate.x+", "displacement": [None, None, 0.002]}],
        "contacts": [{"on": "plate.z-",
                      "obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}],
        "solver": {"method": "primal"},
    }  # fmt: skip
    problem = scenes.problem(made)
    task = Task(problem, StoppingRule(1e-8), MPRGP(rtol=1e-10, max_iterations=2000))
    factors = FactorOptions(small=0.0, thin=thin, thin_seconds=0.0)
    peeled = by_active_sets.solve_by_multigrid(task, None, None, factors)
    expected = by_active_sets.solve_by_multigrid(task, None, None)
    assert peeled.converged
    assert peeled.measures.energy == pytest.approx(expected.measures.energy, rel=1e-7)
