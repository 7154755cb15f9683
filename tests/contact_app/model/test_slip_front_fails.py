"""A slip front that goes too far costs applications, never the answer."""

import numpy as np
import pytest
from mpi4py import MPI

from solver.contact.active_set import ActiveSetMethod
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.friction_law import Friction
from solver.contact.retries import solve_with_retries
from solver.contact.slip_front import SlipFront
from solver.contact.solve_on_set import Outcome, StoppingTest
from solver.problem.certify import friction_residual
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.tfeti.active_set_problem import State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.methods.by_active_sets import initial_active_set
from tests import scenes
from tests.contact_app.model.test_rigid_friction import plate, under_a_plate


@pytest.mark.ratchet
def test_sets_that_fail_ahead_of_the_states_are_tried_without() -> None:
    """A plate at 0.99 of the load at which it slides, where all points are let go at once."""
    d, load = 2, [0.99 * 0.3 * 40.0, -40.0]
    made = under_a_plate(
        "quadrilateral", {"coulomb": 0.3}, plate("quadrilateral", [None] * d, total_force=load)
    )
    problem = scenes.problem(made)
    law = Friction(
        points=problem.friction,
        stiffness=np.full(len(problem.friction.first), np.inf),
        comm=MPI.COMM_SELF,
        front=SlipFront(problem.friction, MPI.COMM_SELF, held=True),  # which it is not
    )

    def lack(state: State) -> float:
        lengths = problem.lengths(state.displacements)
        left = friction_residual(problem, state.multiplier, state.jumps, lengths)
        return max(left, problem.largest_distance(state)) / 1e-8

    def sets(ahead: bool) -> Outcome[State]:
        method = ActiveSetMethod(
            TotalFeti(problem),
            StoppingTest(lack, lambda state: lack(state) <= 1.0),
            MPRGP(),
            options=ActiveSetOptions(early_release=ahead, sliding=1),
            law=law,
        )
        return solve_with_retries(method, initial_active_set(problem, None))

    found, safe = sets(True), sets(False)
    assert found.reason is safe.reason is Reason.ACCEPTED
    assert found.counts.hessian > safe.counts.hessian  # it failed once
    np.testing.assert_array_equal(  # what failed leaves nothing behind
        found.state.multiplier, safe.state.multiplier
    )
