"""Steps of active sets: they end where they penetrate far, and coarse levels correct sets."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from meshes.samples.make_trials import write
from solver.backend import Statuses
from solver.contact.stopping import StoppingRule
from solver.primal.backend import Multigrid
from solver.primal.by_active_sets import solve_by_multigrid
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from solver.tfeti.dual import DualProblem
from solver.vectors import Mask
from tests import scenes
from tests.contact_app.run.test_primal import MULTIGRID_ALWAYS

INNER = MPRGP(rtol=1e-10, max_iterations=2000)


def trial(name: str, path: Path) -> DualProblem:
    """A coarse trial part of `make_trials.py`."""
    scene = scenes.read(write(name, 1.8, path), ["solver.method=primal"])
    return build_model(scene, MPI.COMM_SELF, needed="distinct").problem


@pytest.mark.parametrize("name", ["angle_bracket", "bar_in_vee"])
def test_coarse_levels_correct_a_set(name: str, tmp_path: Path) -> None:
    """From a set of all rows they come near the solution; the set of the solution stays."""
    problem = trial(name, tmp_path)
    task = Task(problem, StoppingRule(1e-8), INNER)
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    exact = problem.inequality & (found.multiplier > 0.0)
    backend = Multigrid(problem, MULTIGRID_ALWAYS)

    def after(active: Mask, reduction: float) -> tuple[Mask, Mask]:
        """The next set and the corrected one."""
        backend.begin_at(backend.system.at_rest)
        on_set = backend.on_set(Statuses(active), None)
        on_set.solve(INNER, reduction * on_set.residual, None)
        state = on_set.state()
        following = np.where(active, state.multiplier > 0.0, state.jumps > 0.0)
        corrected = backend.corrected_contact(state.multiplier)
        assert corrected is not None
        return following & problem.inequality, corrected

    np.testing.assert_array_equal(after(exact, 1e-8)[1], exact)
    following, corrected = after(problem.inequality, 0.1)
    wrong, left = (int((rows != exact).sum()) for rows in (following, corrected))
    assert 0 < left < 0.2 * wrong  # 14 instead of 179, 23 instead of 378


def test_an_empty_set_that_lets_a_body_go_is_refused(tmp_path: Path) -> None:
    """Contact alone holds the bar; conjugate gradients would look for its place in vain."""
    problem = trial("bar_in_vee", tmp_path)
    backend = Multigrid(problem, MULTIGRID_ALWAYS)
    with pytest.raises(ArithmeticError, match="leave a body"):
        backend.on_set(Statuses(np.zeros_like(problem.inequality)), None)
    backend.on_set(Statuses(problem.inequality), None)
