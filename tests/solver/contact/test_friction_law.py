"""Coulomb's and Tresca's law in the active-set loop, on a backend of dense matrices."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from solver.backend import ConstraintHierarchy, SetState, Statuses
from solver.contact.active_set import ActiveSetMethod, Start
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.friction_law import Friction
from solver.contact.friction_points import FrictionPoints
from solver.contact.law import StateError
from solver.contact.retries import solve_with_retries
from solver.contact.solve_on_set import Outcome, StoppingTest
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Reason
from solver.vectors import Array

POINTS, TOLERANCE = 4, 1e-9


def law_of(d: int, coefficients: Array, limits: Array) -> Friction:
    """Points whose d rows, the normal and the tangential ones, follow each other."""
    count, k = len(limits), d - 1
    point, none = np.repeat(np.arange(count), k), np.zeros(0, np.int64)
    points = FrictionPoints(
        rows=d * point + 1 + np.tile(np.arange(k), count), normals=d * point, point=point,
        first=k * np.arange(count), coefficients=coefficients, limits=limits,
        spread=np.ones(k * count), normal_spread=np.ones(k * count), shared=none, other_rows=none,
        places=np.zeros((count, 3)), sources=np.zeros(count, np.int64),
        tangents=np.tile(np.eye(d)[1:], (count, 1)),
    )  # fmt: skip
    return Friction(points=points, comm=MPI.COMM_SELF, stiffness=np.ones(count))


class DenseBackend:
    """Rows are the unknowns themselves, those of one point after those of another: B = 1."""

    comm = MPI.COMM_SELF

    def __init__(self, d: int, K: Array, f: Array, gaps: Array) -> None:
        self.flexibility, self.free = np.linalg.inv(K), np.linalg.solve(K, f)
        self.K, self.contact_rows = K, np.arange(len(f)) % d == 0
        self.c = np.where(self.contact_rows, np.repeat(gaps, d), 0.0)

    def on_set(self, statuses: Statuses, multiplier: Array | None) -> "DenseSet":
        return DenseSet(self, statuses)

    def hierarchy(self, coarsened: bool) -> ConstraintHierarchy:
        return ConstraintHierarchy(self.contact_rows)

    def release(self) -> None:
        pass

    forget = release


class DenseSet:
    """λ of a set from (F + C) λ = d + C t in its active rows, F the flexibility in its frames."""

    residual, at_round_off, counts = 1.0, False, Counts()

    def __init__(self, backend: DenseBackend, statuses: Statuses) -> None:
        self.backend, self.statuses = backend, statuses

    def solve(self, *_: Any) -> Reason:
        return Reason.CONVERGED

    def error(self, strained: float) -> float:
        return 1e-14

    def state(self) -> SetState:
        backend, statuses, size = self.backend, self.statuses, len(self.backend.c)
        turn, active = statuses.turn, statuses.active
        frames = (
            np.eye(size) if turn is None else np.array([turn.back(row) for row in np.eye(size)])
        )
        given = np.zeros(size) if statuses.tractions is None else statuses.tractions
        soft = np.zeros(size) if statuses.compliance is None else statuses.compliance
        F, d = frames @ backend.flexibility @ frames.T, frames @ (backend.free - backend.c)
        multiplier = np.where(active, 0.0, given)
        rhs = (d - F @ multiplier + soft * given)[active]
        multiplier[active] = np.linalg.solve((F + np.diag(soft))[np.ix_(active, active)], rhs)
        multiplier = frames.T @ multiplier
        u = backend.free - backend.flexibility @ multiplier
        jumps, strained = u - backend.c, float(u @ backend.K @ u)
        return SetState(multiplier, statuses.holding, jumps, np.ones(size), strained)


def violation(law: Friction, d: int, state: SetState) -> float:
    """The largest violation of the conditions of contact and friction."""
    forces, jumps = state.multiplier.reshape(-1, d), state.jumps.reshape(-1, d)
    pressing, friction, slip = forces[:, 0], forces[:, 1:], jumps[:, 1:]
    limit = law.points.coefficients * np.maximum(pressing, 0.0) + law.points.limits
    size, length = np.linalg.norm(friction, axis=1), np.linalg.norm(slip, axis=1)
    lost = limit * length - np.einsum("ij,ij->i", friction, slip)
    errors = [-pressing, jumps[:, 0], np.abs(pressing * jumps[:, 0]), size - limit, np.abs(lost)]
    return float(np.max(errors))


def solved(law: Friction, d: int, backend: DenseBackend) -> Outcome[SetState]:
    """The outcome of the loop from contact everywhere."""
    test = StoppingTest[SetState](
        lambda state: 1.0 if violation(law, d, state) <= TOLERANCE else 10.0,
        lambda state: violation(law, d, state) <= TOLERANCE,
    )
    made: Any = backend
    options = replace(ActiveSetOptions().with_friction(), significant=1.0)
    method = ActiveSetMethod[SetState](made, test, MPRGP(), options=options, law=law)
    return solve_with_retries(method, Start(backend.contact_rows))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([2, 3]), st.booleans())
def test_answers_meet_the_conditions_of_the_law(seed: int, d: int, coulomb: bool) -> None:
    draw = np.random.default_rng([seed, d])
    A = draw.normal(size=(d * POINTS, d * POINTS))
    K = A @ A.T / len(A) + 2.0 * np.eye(len(A))
    drawn, none = draw.uniform(0.1, 0.4, POINTS), np.zeros(POINTS)
    law = law_of(d, drawn, none) if coulomb else law_of(d, none, drawn)
    gaps = draw.uniform(0.0, 0.3, POINTS) * (draw.random(POINTS) < 0.5)
    outcome = solved(law, d, DenseBackend(d, K, draw.normal(size=len(A)), gaps))
    assert outcome.reason is Reason.ACCEPTED
    assert outcome.state is not None
    assert violation(law, d, outcome.state) <= TOLERANCE


def after(law: Friction, before: Statuses, multiplier: list[float], jumps: list[float]) -> Statuses:
    """The statuses that follow a state of one point, in contact."""
    state = SetState(np.array(multiplier), before.active, np.array(jumps), np.ones(len(jumps)), 1.0)
    normals = np.arange(len(jumps)) == 0
    return law.following(normals, state, StateError(0.0, 0.0, 1.0), before, False)[0]


def test_a_point_slides_along_the_force_that_exceeds_its_limit() -> None:
    law, sticks = law_of(3, np.array([0.5]), np.zeros(1)), Statuses(np.ones(3, bool))
    np.testing.assert_array_equal(after(law, sticks, [10.0, 3.0, 4.0], [0.0] * 3).active, True)
    slides = after(law, sticks, [8.0, 3.0, 4.0], [0.0] * 3)
    assert slides.turn is not None
    assert slides.tractions is not None
    np.testing.assert_allclose(slides.turn.back(slides.tractions), [0.0, 2.4, 3.2])
    np.testing.assert_array_equal(slides.active, [True, False, True])


@pytest.mark.parametrize(("slip", "sticks"), [(-0.1, True), (0.1, False)])
def test_a_point_that_slips_against_its_friction_sticks(slip: float, sticks: bool) -> None:
    law = law_of(2, np.zeros(1), np.array([2.0]))
    slides = Statuses(np.array([True, False]), np.array([0.0, 2.0]))
    following = after(law, slides, [5.0, 2.0], [0.0, slip])
    assert following.active[1] == sticks
    assert following.tractions is not None
    assert following.tractions[1] == (0.0 if sticks else 2.0)


@pytest.mark.parametrize("given_limit", [0.0, 3.0])
def test_open_points_have_friction_of_a_given_limit_alone(given_limit: float) -> None:
    law = law_of(2, np.array([0.3]), np.array([given_limit]))
    consistent = law.consistent(Statuses(np.array([False, True])))
    np.testing.assert_array_equal(consistent.active, [False, given_limit > 0.0])
    slides = law.consistent(Statuses(np.zeros(2, bool), np.array([0.0, 2.0])))
    np.testing.assert_array_equal(slides.tractions, [0.0, 2.0 if given_limit else 0.0])


def test_a_point_of_two_contacts_that_sticks_begins_with_its_force() -> None:
    """It begins below its limit, not at it; a step without change of loads ends with one set."""
    law = law_of(2, np.array([0.5]), np.zeros(1))
    points = replace(law.points, shared=np.array([0]), other_rows=np.array([2]))
    law = replace(law, points=points, shared_compliance=np.array([0.1]))
    begin = law.initial(np.array([True, False, True]), np.array([10.0, 2.0, 3.0]), ahead=True)
    assert begin.tractions is not None
    np.testing.assert_array_equal(begin.tractions, [0.0, 2.0, 0.0])
