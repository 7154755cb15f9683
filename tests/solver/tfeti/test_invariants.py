"""Identities of Total FETI that hold for any multipliers and displacements."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solver.contact.options import SolverOptions
from solver.driver import solve
from solver.problem.duality_gap import duality_gap, nearest_admissible
from solver.problem.feasible import feasible_displacements
from solver.problem.sizes import MeasuredAnswer
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible_multiplier import feasible_multiplier
from solver.tfeti.recovery import displacements, interface_displacements, kernel_coefficients
from solver.vectors import Array
from tests.solver.tfeti.test_from_arrays import in_pieces

COLUMNS = 2
"""Columns of cells of a piece."""

SETTINGS = settings(max_examples=20, deadline=None, derandomize=True)
CASES = {"pieces": st.integers(1, 4), "contrast": st.integers(0, 4), "seed": st.integers(0, 999)}
"""Pieces of a beam, digits between their stiffnesses, and the seed of random vectors."""


@cache
def beam(pieces: int, contrast: int) -> DualProblem:
    """Pieces of unlike stiffness in a row, held on the left, pulled down above a floor."""
    return in_pieces(
        COLUMNS, pieces, lambda x: 0.01 * (1.0 + x[:, 0]), np.full(pieces * COLUMNS, 0.05),
        factors=(1.0, 10.0**contrast),
    )  # fmt: skip


@cache
def least_energy(pieces: int, contrast: int) -> float:
    """½ a(u, u) - l(u) of the answer."""
    answer = solve(beam(pieces, contrast), SolverOptions(tolerance=1e-10))
    assert answer.converged
    return answer.measures.energy


def applied(action: object, x: Array, size: int | None = None) -> Array:
    """The result of a method that puts it into its second argument."""
    out = np.empty(len(x) if size is None else size)
    action(x, out)  # type: ignore[operator]
    return out


def admissible(problem: DualProblem, rng: np.random.Generator) -> Array:
    """A random multiplier in equilibrium with the loads, without tensile contact forces."""
    near = problem.offset + np.abs(problem.offset).max() * rng.normal(size=problem.size)
    closed = problem.inequality & (rng.random(problem.size) < 0.5)
    return feasible_multiplier(problem, near, closed)


@SETTINGS
@given(**CASES)
def test_the_dual_operator_is_symmetric_and_nonnegative(
    pieces: int, contrast: int, seed: int
) -> None:
    problem = beam(pieces, contrast)
    x, y = np.random.default_rng(seed).normal(size=(2, problem.size))
    Fx, Fy = applied(problem.F.apply, x), applied(problem.F.apply, y)
    assert x @ Fy == pytest.approx(y @ Fx, abs=1e-11 * np.linalg.norm(Fx) * np.linalg.norm(y))
    assert x @ Fx > 0.0
    assert y @ Fy > 0.0


def coarse_of(problem: DualProblem, weighted: bool, rng: np.random.Generator) -> CoarseProblem:
    """The coarse problem of all rows, or that of a random active set."""
    assert problem.coarse is not None
    if not weighted:
        return problem.coarse
    active = with_active(problem, problem.inequality & (rng.random(problem.size) < 0.5))
    assert active.coarse is not None
    return active.coarse


@SETTINGS
@given(**CASES, weighted=st.booleans())
def test_the_projector_is_idempotent_and_leaves_equilibrium(
    pieces: int, contrast: int, seed: int, weighted: bool
) -> None:
    """P P = P, G P = 0 and (Pᵀ y)ᵀ x = yᵀ P x; P Gᵀ = 0 as well where all rows weigh alike."""
    problem, rng = beam(pieces, contrast), np.random.default_rng(seed)
    coarse = coarse_of(problem, weighted, rng)
    x, y = rng.normal(size=(2, problem.size))
    Px = applied(coarse.project, x)
    np.testing.assert_allclose(applied(coarse.project, Px), Px, atol=1e-11)
    np.testing.assert_allclose(applied(coarse.restrict, Px, coarse.kernels), 0.0, atol=1e-11)
    assert applied(coarse.project_transpose, y) @ x == pytest.approx(y @ Px, abs=1e-10)
    motion = applied(coarse.extend, rng.normal(size=coarse.kernels), problem.size)
    np.testing.assert_allclose(applied(coarse.project, motion), 0.0, atol=1e-10)


@SETTINGS
@given(**CASES)
def test_recovered_displacements_balance_the_forces_and_have_the_least_jumps(
    pieces: int, contrast: int, seed: int
) -> None:
    """K u = f - Bᵀ λ for any λ with G λ = e; the jumps B u - c have no part along Gᵀ."""
    problem = beam(pieces, contrast)
    multiplier = admissible(problem, np.random.default_rng(seed))
    alpha = kernel_coefficients(problem, multiplier, None)
    u = displacements(problem, multiplier, alpha)
    load = np.abs(multiplier).sum() + sum(np.abs(f).sum() for f in problem.forces)
    equilibrium = MeasuredAnswer(problem, multiplier, u).equilibrium()
    assert equilibrium.imbalance.max() <= 1e-11 * load
    interface = problem.on_interface(u)
    size = np.abs(interface).max()
    np.testing.assert_allclose(
        interface, interface_displacements(problem, multiplier, alpha), atol=1e-11 * size
    )
    assert problem.coarse is not None
    along = applied(problem.coarse.restrict, problem.residual(interface), problem.coarse.kernels)
    assert np.abs(along).max() <= 1e-10 * size


@SETTINGS
@given(**CASES)
def test_neighbours_are_admissible(pieces: int, contrast: int, seed: int) -> None:
    """λ_I ≥ 0 and G λ = e; B û = c on equality rows and B û ≤ c on contact rows."""
    problem, rng = beam(pieces, contrast), np.random.default_rng(seed)
    multiplier = admissible(problem, rng)
    assert problem.coarse is not None
    assert multiplier[problem.inequality].min() >= 0.0
    works = applied(problem.coarse.restrict, multiplier, problem.coarse.kernels)
    np.testing.assert_allclose(works, problem.e, atol=1e-11 * np.abs(multiplier).max())
    found, residual = feasible_displacements(problem, rng.normal(size=problem.B.columns))
    np.testing.assert_allclose(problem.residual(found), residual, atol=1e-12)
    assert np.abs(residual[~problem.inequality]).max() <= 1e-11
    assert residual[problem.inequality].max() <= 1e-11


@SETTINGS
@given(**CASES, far=st.sampled_from([0.0, 1e-3, 1.0]))
def test_the_duality_gap_bounds_the_error_of_any_admissible_pair(
    pieces: int, contrast: int, seed: int, far: float
) -> None:
    """D(λ) ≤ J(u*) ≤ J(û) = D(λ) + gap, with u* the answer and û near u = K⁺ (f - Bᵀ λ) + R α."""
    problem, rng = beam(pieces, contrast), np.random.default_rng(seed)
    multiplier = admissible(problem, rng)
    alpha = kernel_coefficients(problem, multiplier, None)
    unmoved = interface_displacements(problem, multiplier, np.zeros_like(alpha))
    strained = problem.strain_energy(multiplier, problem.residual(unmoved))
    dual = -0.5 * strained - float(multiplier @ problem.c)
    u = displacements(
        problem, multiplier, alpha + far * np.abs(alpha).max() * rng.normal(size=len(alpha))
    )
    gap = duality_gap(problem, multiplier, problem.on_interface(u))
    near = nearest_admissible(problem, multiplier, u)
    for cls, part, field in zip(problem.classes, problem.slices, u, strict=True):
        field[cls.interface] = near[part].reshape(cls.members, -1).T
    costs = [
        0.5 * np.vdot(field, cls.stiffness @ field) - np.vdot(field, force)
        for cls, field, force in zip(problem.classes, u, problem.forces, strict=True)
    ]
    least = least_energy(pieces, contrast)
    assert dual <= least + 1e-9 * (abs(least) + strained)
    assert least <= sum(costs) + 1e-9 * (abs(least) + strained)
    assert gap == pytest.approx(sum(costs) - dual, rel=1e-7)
