"""MPRGP knows the feasible set by its protocol alone: one written here serves as the box does."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver.errors import QPError
from solver.qp.box import Box
from solver.qp.box_qp import BoxQP
from solver.qp.convex_set import Scratch
from solver.qp.discs import BoxAndDiscs, BoxAndDiscsOnBlock
from solver.qp.mprgp import MPRGP
from solver.qp.result import Reason
from solver.qp.separable_qp import SeparableQP
from solver.vectors import Mask, Vector, blocks

NEAR = 1e-14


@dataclass(frozen=True)
class Balls:
    """|x_i - c_i| ≤ r_i, by distances from the centre instead of bounds."""

    centre: Vector
    radius: Vector

    is_everything = curved = False

    def blocks(self, size: int) -> Iterator[slice]:
        return blocks(size)

    def not_finite(self, offset: int) -> list[str]:
        return []

    def empty(self, offset: int) -> list[str]:
        return ["a radius is negative"] if (self.radius < 0.0).any() else []

    def project(self, x: Vector) -> None:
        away = x - self.centre
        x[:] = self.centre + np.sign(away) * np.minimum(np.abs(away), self.radius)

    def on_block(self, rows: slice, scratch: Scratch) -> "Balls":
        return Balls(self.centre[rows], self.radius[rows])

    def split(self, x: Vector, g: Vector, is_free: Mask, free: Vector, chopped: Vector) -> None:
        away = x - self.centre
        is_free[:] = np.abs(away) < self.radius * (1.0 - NEAR)
        free[:] = np.where(is_free, g, 0.0)
        chopped[:] = np.where(~is_free & (away * g > 0.0), g, 0.0)

    def step_to_boundary(self, x: Vector, p: Vector, alpha: float) -> None:
        x -= alpha * p
        self.project(x)
        self.settle(x)

    def reduce(self, x: Vector, free: Vector, alpha: float, out: Vector) -> None:
        moved = x - alpha * free
        self.project(moved)
        out[:] = (x - moved) / alpha

    def inverse_longest_step(self, x: Vector, p: Vector) -> float:
        room = self.radius + np.sign(p) * (x - self.centre)
        return float(np.max(np.abs(p) / np.where(room > 0.0, room, np.inf), initial=0.0))

    def settle(self, x: Vector) -> None:
        away = x - self.centre
        on_it = np.abs(away) >= self.radius * (1.0 - NEAR)
        x[on_it] = (self.centre + np.sign(away) * self.radius)[on_it]


@given(st.integers(0, 10_000), st.sampled_from(["fixed", "projcg", "projcg-safe", "gfgr-opt"]))
def test_a_user_defined_convex_set_gives_the_answer_of_the_box(seed: int, expansion: str) -> None:
    rng = np.random.default_rng(seed)
    n = 12
    half = rng.normal(size=(n, n))
    A, b = half @ half.T + np.eye(n), 5.0 * rng.normal(size=n)
    centre, radius = rng.normal(size=n), rng.uniform(0.1, 1.0, size=n)
    solver = MPRGP(rtol=1e-10, expansion=expansion)
    ours = solver.solve(SeparableQP(A, b, Balls(centre, radius)))
    box = solver.solve(BoxQP(A, b, centre - radius, centre + radius))
    assert ours.converged == box.converged
    if box.converged:  # plain projcg may cycle
        np.testing.assert_allclose(ours.x, box.x, atol=1e-7)


def test_an_empty_set_is_refused() -> None:
    with pytest.raises(QPError, match="a radius is negative"):
        SeparableQP(np.eye(2), np.zeros(2), Balls(np.zeros(2), np.array([1.0, -1.0])))


def discs_and_bounds(rng: np.random.Generator, discs: int, others: int) -> BoxAndDiscs:
    """Pairs in discs, some of them points, between components with a lower bound or none."""
    order = rng.permutation(2 * discs + others)
    first, second = order[:discs], order[discs : 2 * discs]
    lower = np.full(len(order), -np.inf)
    lower[order[2 * discs :: 2]] = rng.normal(size=len(order[2 * discs :: 2]))
    radius = np.where(rng.random(discs) < 0.2, 0.0, rng.uniform(0.05, 1.0, discs))
    return BoxAndDiscs(Box(lower), first, second, rng.normal(size=(2, discs)), radius)


@given(st.integers(0, 10_000), st.sampled_from(["fixed", "projcg-safe", "gfgr-opt"]), st.booleans())
def test_discs(seed: int, expansion: str, singular: bool) -> None:
    """The answer is the projection of a gradient step from it: the condition of a convex set.

    The theory promises a rate for a positive definite Hessian. A singular one may have no curvature
    along the edge of a disc: the way along that edge then takes any number of steps, and the test
    asks only for what the steps up to the limit reach.
    """
    rng = np.random.default_rng(seed)
    feasible = discs_and_bounds(rng, 4, 5)
    n = 13
    half = rng.normal(size=(n, n - 4 if singular else n))
    A = half @ half.T + (0.0 if singular else 1.0) * np.eye(n)
    b = A @ (3.0 * rng.normal(size=n))
    solver = MPRGP(rtol=1e-9, expansion=expansion, max_iterations=2000 if singular else 10_000)
    found = solver.solve(SeparableQP(A, b, feasible))
    assert found.converged or (singular and found.reason is Reason.MAX_ITERATIONS), found.reason
    step = found.x - (A @ found.x - b) / np.linalg.norm(A, 2)
    feasible.project(step)
    near = (1e-7 if found.converged else 1e-5) * np.abs(b).max() / np.linalg.norm(A, 2)
    np.testing.assert_allclose(step, found.x, atol=near)
    away, size = feasible.from_centers(found.x)
    assert (size <= feasible.radius * (1.0 + 1e-12)).all()


@pytest.mark.ratchet
@given(st.integers(0, 10_000))
def test_small_discs_far_from_zero(seed: int) -> None:
    """Rounding errors of the centre are larger than `ACTIVITY`: points on the edge are not free.

    The steps are few, and accelerated projected gradients find the same answer.
    """
    rng = np.random.default_rng(seed)
    discs = 6
    n = 2 * discs
    half = rng.normal(size=(n, n))
    A = half @ half.T + np.eye(n)
    first = np.arange(0, n, 2)
    center = rng.normal(size=(2, discs))
    radius = 10.0 ** rng.uniform(-17, -4, discs)
    feasible = BoxAndDiscs(Box(), first, first + 1, center, radius)
    b = A @ center.T.ravel() + 3.0 * rng.normal(size=n)
    found = MPRGP(rtol=1e-9).solve(SeparableQP(A, b, feasible))
    assert found.converged
    assert found.counts.hessian < 40
    x, y, length = center.T.ravel(), center.T.ravel(), 1.0 / np.linalg.norm(A, 2)
    for k in range(500):
        before, x = x, y - length * (A @ y - b)
        feasible.project(x)
        y = x + k / (k + 3.0) * (x - before)
    assert (np.abs(found.x - x) < 1e-3 * radius.repeat(2) + 1e-14).all()


def test_a_disc_without_a_radius_is_refused() -> None:
    one = np.array([0])
    for radius, words in ((-1.0, "radius of its disc"), (np.nan, "not finite")):
        discs = BoxAndDiscs(Box(), one, one + 1, np.zeros((2, 1)), np.array([radius]))
        with pytest.raises(QPError, match=f"component 0.*{words}"):
            SeparableQP(np.eye(2), np.zeros(2), discs)


def on_one_block(feasible: BoxAndDiscs) -> BoxAndDiscsOnBlock:
    """The kernels of a set on all of its components."""
    size = len(feasible.box.lower)  # type: ignore[arg-type]
    return feasible.on_block(slice(0, size), Scratch(size))


@given(st.integers(0, 10_000))
def test_the_projection_is_the_nearest_point(seed: int) -> None:
    """(z - P z)ᵀ (y - P z) ≤ 0 for all y of the set, which says it all about P."""
    rng = np.random.default_rng(seed)
    feasible = discs_and_bounds(rng, 3, 4)
    points = 2.0 * rng.normal(size=(20, 10))
    projected = points.copy()
    for x in projected:
        feasible.project(x)
        again = x.copy()
        feasible.project(again)
        np.testing.assert_allclose(again, x, atol=1e-15)
    angles = (points - projected) @ projected.T
    angles -= ((points - projected) * projected).sum(axis=1)[:, None]
    assert angles.max() <= 1e-12


@given(st.integers(0, 10_000))
def test_the_projected_gradient_is_the_derivative_of_a_projected_step(seed: int) -> None:
    """P(x - α g) = x - α (g^f + g^c) + O(α²), with g^f and g^c on different components."""
    rng = np.random.default_rng(seed)
    feasible = discs_and_bounds(rng, 4, 5)
    x, g = 2.0 * rng.normal(size=13), rng.normal(size=13)
    feasible.project(x)
    free, chopped, is_free = np.empty(13), np.empty(13), np.empty(13, bool)
    on_one_block(feasible).split(x, g, is_free, free, chopped)
    assert not free[~is_free].any()
    assert not chopped[is_free].any()
    np.testing.assert_array_equal(free[is_free], g[is_free])
    assert g @ (free + chopped) == pytest.approx((free + chopped) @ (free + chopped), rel=1e-12)
    short = 1e-7
    step = x - short * g
    feasible.project(step)
    np.testing.assert_allclose((x - step) / short, free + chopped, atol=1e-4)


@given(st.integers(0, 10_000), st.floats(1e-3, 10.0))
def test_steps_stay_in_the_set(seed: int, alpha: float) -> None:
    """The reduced gradient's step ends in the set; the longest step ends on its boundary."""
    rng = np.random.default_rng(seed)
    feasible = discs_and_bounds(rng, 4, 5)
    kernels = on_one_block(feasible)
    x, g = rng.normal(size=13), rng.normal(size=13)
    feasible.project(x)
    free, chopped, reduced = np.empty((3, 13))
    kernels.split(x, g, np.empty(13, bool), free, chopped)
    kernels.reduce(x, free, alpha, reduced)
    expected = x - alpha * free
    feasible.project(expected)
    np.testing.assert_allclose(x - alpha * reduced, expected, atol=1e-13 * (1.0 + alpha))
    assert reduced @ free >= reduced @ reduced - 1e-12
    inverse = kernels.inverse_longest_step(x, free)
    if inverse:
        for share, leaves in ((1.0 - 1e-9, False), (1.0 + 1e-6, True)):
            end = x - share / inverse * free
            nearest = end.copy()
            feasible.project(nearest)
            assert (np.abs(nearest - end).max() > 1e-13) == leaves
