"""Estimates on a set without an operator application, and the end by an automatic tolerance."""

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from solver import MPRGP, Reason
from solver.backend import Statuses
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.active_set_update import ActiveSetUpdate, SetRules
from solver.contact.law import ContactLaw
from solver.contact.solution import Accuracy
from solver.contact.solve_on_set import StoppingTest, solve_on_set
from solver.contact.stopping import AutomaticOptions, AutomaticRule
from solver.tfeti.active_set_problem import ActiveSetProblem, State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.dual import DualProblem
from solver.tfeti.recovery import interface_displacements, kernel_coefficients
from solver.tfeti.winkler import winkler_contact
from solver.vectors import Mask
from tests import scenes


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    return scenes.problem(scenes.ALL["wall"]("hexahedron", 8), [2, 2, 2])


def every_second(problem: DualProblem) -> Mask:
    """Every second contact row."""
    result = problem.inequality.copy()
    result[np.flatnonzero(result)[::2]] = False
    return result


def solved_to(problem: DualProblem, aim: float) -> tuple[ActiveSetProblem, State]:
    on_set = ActiveSetProblem(problem, Statuses(every_second(problem)))
    on_set.solve(MPRGP(), aim, None)
    return on_set, on_set.state()


def test_a_state_has_the_values_of_an_operator_application(problem: DualProblem) -> None:
    on_set, state = solved_to(problem, 0.1)
    multiplier = state.multiplier
    free = interface_displacements(problem, multiplier, np.zeros(len(problem.e)))
    motions = state.displacements - free
    scale = np.abs(state.displacements).max()
    # they differ by rigid motions alone, which no multiplier in equilibrium does work on
    change = np.where(problem.inequality & ~on_set.active, 0.0, multiplier - problem.offset)
    other = problem.constraint_forces(change)
    assert abs(other @ motions) <= 1e-10 * np.linalg.norm(other) * np.linalg.norm(motions)
    jumps = problem.residual(state.displacements) / problem.spread
    np.testing.assert_allclose(state.distance, jumps / scale, atol=1e-10)
    strained = problem.strain_energy(multiplier, problem.residual(free))
    assert state.strained == pytest.approx(strained, rel=1e-10)


def test_prescribed_multipliers_act_as_loads(problem: DualProblem) -> None:
    """Rows that leave the set and keep their multipliers as loads change nothing."""
    closed = problem.inequality
    on_set = ActiveSetProblem(problem, Statuses(closed))
    on_set.solve(MPRGP(), 1e-12, None)
    whole = on_set.state()
    some = every_second(problem)
    part = ActiveSetProblem(problem, Statuses(some, whole.multiplier))
    part.solve(MPRGP(), 1e-12, None)
    found = part.state()
    scale = np.abs(whole.displacements).max()
    np.testing.assert_allclose(found.displacements, whole.displacements, atol=1e-7 * scale)
    largest = np.abs(whole.multiplier).max()
    np.testing.assert_allclose(found.multiplier, whole.multiplier, atol=1e-7 * largest)
    assert found.strained == pytest.approx(whole.strained, rel=1e-7)
    other = ActiveSetProblem(problem, Statuses(some))
    other.solve(MPRGP(), 1e-12, None)
    assert np.abs(other.state().displacements - whole.displacements).max() > 1e-3 * scale


def test_statuses_differ_by_rows_and_by_prescribed_multipliers() -> None:
    active = np.array([True, False, False])
    assert not Statuses(active).changed(Statuses(active, np.array([5.0, 0.0, 0.0]))).any()
    changed = Statuses(active, np.zeros(3)).changed(Statuses(active, np.array([0.0, 2.0, 0.0])))
    np.testing.assert_array_equal(changed, [False, True, False])
    np.testing.assert_array_equal(Statuses(active).changed(Statuses(~active)), [True] * 3)


def test_an_active_set_goes_on_from_the_last_multiplier(problem: DualProblem) -> None:
    """From the last multiplier the same set is solved with a single product."""
    on_set, state = solved_to(problem, 1e-8)
    again = ActiveSetProblem(problem, Statuses(every_second(problem)), state.multiplier)
    assert again.counts.hessian == 1
    np.testing.assert_allclose(again.state().displacements, state.displacements, atol=1e-12)


def test_smalbe_continues_with_the_same_displacements(problem: DualProblem) -> None:
    state = solved_to(problem, 1e-3)[1]
    x, force = state.homogenised(problem)
    multiplier = problem.offset + x
    alpha = kernel_coefficients(problem, multiplier, force)
    found = interface_displacements(problem, multiplier, alpha)
    scale = np.abs(found).max()
    np.testing.assert_allclose(found, state.displacements, atol=1e-10 * scale)


def beside_two_walls(cell: str, angle: float) -> DualProblem:
    """Two walls through the foot of one side, turned against each other: two rows at each node."""
    made = scenes.wall(cell, 4)
    turned = scenes.plane(cell, (1, 0, 0), (-1, 0, angle))
    made["contacts"].append({"on": "block.x+", "obstacle": turned})
    return scenes.problem(made, [2] * scenes.dimension(cell))


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
@pytest.mark.ratchet
def test_an_active_set_ends_within_a_step_for_each_unknown(cell: str) -> None:
    problem = beside_two_walls(cell, 0.1)
    on_set = ActiveSetProblem(problem, Statuses(problem.inequality))
    assert on_set.solve(MPRGP(), 1e-8, None) is Reason.CONVERGED
    assert on_set.counts.cg < problem.size


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
@pytest.mark.ratchet
def test_an_active_set_stalled_by_rounding_errors_ends(cell: str) -> None:
    """The two rows of a node are the angle apart, which F and its preconditioner square each.

    The smallest eigenvalue of their product is its fourth power, over the largest: 1e-4 leaves no
    digit, and without a limit the solve never ends.
    """
    problem = beside_two_walls(cell, 1e-4)
    on_set, inner = (
        ActiveSetProblem(problem, Statuses(problem.inequality)),
        MPRGP(max_iterations=8 * problem.size),
    )
    assert on_set.solve(inner, 1e-8, None) is Reason.ROUND_OFF
    assert problem.size < on_set.counts.cg <= 2 * problem.size
    assert on_set.at_round_off
    # the caller continues with another method, without another step on this set
    spent = on_set.counts.hessian
    test = StoppingTest(lambda state: 1.0, lambda state: False)
    backend = TotalFeti(problem)
    hierarchy = backend.hierarchy(coarsened=False)
    options = ActiveSetOptions()
    update = ActiveSetUpdate(backend, hierarchy, ContactLaw(), options)
    rules = SetRules(update, options.first_reduction, coarsened=True)
    found = solve_on_set(on_set, rules, test, inner)
    assert found.reason in (None, Reason.ROUND_OFF)
    assert found.counts.hessian == spent


@pytest.mark.ratchet
def test_an_active_set_measures_rounding_errors_outside_the_range_of_the_projector() -> None:
    """A beam 1:300 in thirty subdomains leaves 5e-4 of the right-hand side, which no step removes.

    Without this knowledge steps continue up to the limit of two for each unknown.
    """
    scene = scenes.build(scenes.slender(300.0, [300, 1]), [30, 1])
    problem = build_model(scene, MPI.COMM_SELF).problem
    on_set = ActiveSetProblem(problem, Statuses(winkler_contact(problem)))
    assert on_set.solve(MPRGP(), 0.0, None) is Reason.CONVERGED
    assert on_set.counts.cg < problem.size / 10
    assert on_set.at_round_off


def test_an_automatic_tolerance_tests_the_gap_where_it_may_decide() -> None:
    calls: list[float] = []

    def target() -> AutomaticRule:
        calls.clear()
        return AutomaticRule(lambda answer: Accuracy(1.0, 0.0, 1.0), 1e-4)

    def gap(error: float):
        def evaluated() -> float:
            calls.append(error)
            return 0.5 * (error * AutomaticOptions().loosest) ** 2

        return evaluated

    assert target().required_reduction(
        2.0 * AutomaticOptions().loosest, 1.0, gap(0.1)
    ) == pytest.approx(2.0)
    assert calls == []  # jumps say no
    assert target().required_reduction(0.0, 1.0, gap(0.5)) == pytest.approx(0.5)
    assert calls == [0.5]
    assert target().required_reduction(0.0, 1.0, gap(2.0)) == pytest.approx(2.0)
    assert calls == [2.0]
