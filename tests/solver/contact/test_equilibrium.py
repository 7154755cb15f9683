"""Equilibrium of bodies by Farkas' lemma, against a linear program."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from scipy.optimize import linprog

from solver.contact.equilibrium import FrictionCones, balance, carried_share, slide

NONE = np.zeros((0, 3))


def supports(half_width: float, n: int = 5) -> np.ndarray:
    """Rows of a plane below y = 0 under nodes at |x| ≤ half width: direction -y."""
    return np.array([[0.0, -1.0, -x] for x in np.linspace(-half_width, half_width, n)])


@pytest.mark.parametrize(("x", "stands"), [(0.0, True), (0.999, True), (1.001, False)])
def test_a_body_stands_while_the_line_of_action_is_inside_its_support(
    x: float, stands: bool
) -> None:
    push = np.array([0.0, -1.0, -x])
    found = balance(MPI.COMM_SELF, NONE, supports(1.0), push, 1.0)
    assert (found.escape is None) == stands
    if not stands:
        assert found.escape @ push > 0
        assert (supports(1.0) @ found.escape <= 1e-9).all()


def test_a_body_pulled_off_leaves_upwards() -> None:
    found = balance(MPI.COMM_SELF, NONE, supports(1.0), np.array([0.0, 2.0, 0.0]), 2.0)
    np.testing.assert_allclose(found.escape, [0, 1, 0], atol=1e-12)


def test_free_sliding_is_found() -> None:
    found = balance(MPI.COMM_SELF, NONE, supports(1.0), np.array([0.0, -1.0, 0.0]), 1.0)
    np.testing.assert_allclose(np.abs(found.free_motions), [[1], [0], [0]], atol=1e-12)
    assert not found.held


def test_held_rows_stop_everything() -> None:
    found = balance(MPI.COMM_SELF, np.eye(3), NONE, np.array([5.0, 1.0, -2.0]), 5.0)
    assert found.held
    assert found.escape is None
    assert found.free_motions.shape == (3, 0)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000))
def test_balance_agrees_with_a_linear_program(seed: int) -> None:
    random = np.random.default_rng(seed)
    held = random.integers(-2, 3, size=(random.integers(0, 3), 6)).astype(float)
    contact = random.integers(-2, 3, size=(random.integers(0, 12), 6)).astype(float)
    load = random.integers(-3, 4, size=6).astype(float)
    if not load.any():
        load[0] = 1.0
    found = balance(MPI.COMM_SELF, held, contact, load, float(np.abs(load).sum()))
    rows = np.vstack([held, contact])
    bounds = [(None, None)] * len(held) + [(0, None)] * len(contact)
    feasible = len(rows) > 0 and bool(
        linprog(np.zeros(len(rows)), A_eq=rows.T, b_eq=load, bounds=bounds).success
    )
    assert (found.escape is None) == feasible
    if found.escape is not None:
        np.testing.assert_allclose(held @ found.escape, 0, atol=1e-8)
        assert (contact @ found.escape <= 1e-8).all()
        assert load @ found.escape > 0


def two_points(
    mu: float | list[float], limit: float, normals: np.ndarray
) -> tuple[np.ndarray, FrictionCones]:
    """Contact rows (2, 3) at points on the x axis, motions x, y and a turn, and their friction."""
    points = np.array([-1.0, 1.0])
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    rows, slips = (np.column_stack([v, points * v[:, 1]]) for v in (normals, tangents))
    return rows, FrictionCones(slips, np.arange(2), np.full(2, mu), np.full(2, limit))


DOWN = np.array([[0.0, -1.0], [0.0, -1.0]])
NOTHING = np.zeros((0, 3))


@pytest.mark.parametrize(
    ("mu", "limit", "load", "share"),
    [
        (0.0, 3.0, [8.0, -1.0, 0.0], 0.75),  # 2 s / Q
        (0.5, 3.0, [20.0, -10.0, 0.0], 0.4),  # t Q = 2 s + μ t P
        (0.5, 0.0, [8.0, -10.0, 0.0], None),
        (0.0, 3.0, [1.0, 1.0, 0.0], None),  # lifted
    ],
)
def test_share_of_a_load_that_friction_carries(
    mu: float, limit: float, load: list[float], share: float | None
) -> None:
    rows, cones = two_points(mu, limit, DOWN)
    found = carried_share(MPI.COMM_SELF, NOTHING, rows, np.array(load), cones)
    assert found == (None if share is None else pytest.approx(share, rel=1e-5))


def test_a_slide_has_no_lift() -> None:
    rows, cones = two_points(0.5, 0.0, DOWN)
    load = np.array([8.0, -10.0, 0.0])
    escape = balance(MPI.COMM_SELF, NOTHING, rows, load, 18.0, cones).escape
    assert escape is not None
    assert escape[1] == pytest.approx(0.5 * escape[0])  # normal to the cone
    found = slide(MPI.COMM_SELF, NOTHING, rows, escape, cones)
    np.testing.assert_allclose(found, [1.0, 0.0, 0.0], atol=1e-9)


def test_a_slide_that_a_ramp_stops_keeps_its_lift() -> None:
    """With its lift of 0.5 the motion passes a smooth ramp of slope 0.4, without it not."""
    ramp = np.array([0.4, -1.0]) / np.hypot(0.4, 1.0)
    rows, cones = two_points([0.5, 0.0], 0.0, np.stack([DOWN[0], ramp]))
    load, no_turn = np.array([8.0, -10.0, 0.0]), np.array([[0.0, 0.0, 1.0]])
    escape = balance(MPI.COMM_SELF, no_turn, rows, load, 18.0, cones).escape
    assert escape is not None
    assert escape[1] == pytest.approx(0.5 * escape[0])
    np.testing.assert_array_equal(slide(MPI.COMM_SELF, no_turn, rows, escape, cones), escape)


def points_in_space(random: np.random.Generator) -> tuple[np.ndarray, FrictionCones]:
    """Contact rows (n, 6) of points about a floor, whose normals lean, and their friction."""
    n = int(random.integers(4, 9))
    points = np.column_stack([random.uniform(-1.0, 1.0, (n, 2)), random.uniform(-0.1, 0.1, n)])
    normals = np.column_stack([random.uniform(-0.4, 0.4, (n, 2)), np.full(n, -1.0)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    first = np.cross(normals, np.eye(3)[0])
    first /= np.linalg.norm(first, axis=1)[:, None]
    tangents = np.stack([first, np.cross(normals, first)], axis=1)
    rows = np.column_stack([normals, np.cross(points, normals)])
    slips = np.concatenate([tangents, np.cross(points[:, None], tangents)], axis=2).reshape(-1, 6)
    mu = random.uniform(0.1, 0.6, n)
    return rows, FrictionCones(slips, np.repeat(np.arange(n), 2), np.repeat(mu, 2), np.zeros(2 * n))


def carried_of_push(
    rows: np.ndarray, cones: FrictionCones, base: np.ndarray, push: np.ndarray, sides: int
) -> float:
    """The largest share of a push that cones with so many sides carry beside a base load."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    slips = cones.slips.reshape(len(rows), 2, 6)
    turned = np.einsum("ka,nai->nki", np.column_stack([np.cos(angles), np.sin(angles)]), slips)
    rays = (rows[:, None] + cones.coefficients[::2, None, None] * turned).reshape(-1, 6)
    found = linprog(
        np.append(np.zeros(len(rays)), -1.0),
        A_eq=np.column_stack([rays.T, -push]), b_eq=base, bounds=(0.0, None),
    )  # fmt: skip
    return float(-found.fun) if found.success else 0.0


@pytest.mark.parametrize("seed", range(50))
def test_any_direction_in_space_slides_at_its_limit(seed: int) -> None:
    """At 0.99 of the push that cones of 180 sides carry the body rests, at 1.01 it leaves."""
    random = np.random.default_rng([seed, 6])
    rows, cones = points_in_space(random)
    base = random.uniform(1.0, 2.0, len(rows)) @ rows  # what pressures alone carry
    push = random.normal(size=6)
    limit = carried_of_push(rows, cones, base, push, 180)
    assert 1e-3 < limit < 1e3
    none = np.zeros((0, 6))
    for share, rests in ((0.99, True), (1.01, False)):
        load = base + share * limit * push
        found = balance(MPI.COMM_SELF, none, rows, load, float(np.abs(load).sum()), cones)
        assert (found.escape is None) == rests
