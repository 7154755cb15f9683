"""The fast MPRGP against the one to be read beside the book, step for step."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solver import MPRGP, BoxQP
from solver.qp import reference
from solver.qp.examples import figure_1
from solver.qp.iterate import Iterate
from solver.vectors import Array
from tests.solver.qp.problems import ALL, random_hessian, string_obstacle

EXPANSIONS = [name for name in ALL if name != "projcg-safe"]  # that one is not the paper's

Steps = list[tuple[str, Array]]


def fast_steps(qp: BoxQP, x0: Array, norm: float, most: int, **options: object) -> Steps:
    """Kind and point of each step of the fast implementation."""
    points: list[Array] = []

    def watch(it: Iterate) -> None:
        points.append(it.x.copy())

    solver = MPRGP(norm=norm, max_iterations=most, **options)  # type: ignore[arg-type]
    found = solver.solve(qp, x0, watch=watch)
    return [(step.type, x) for step, x in zip(found.history, points, strict=True)][1:]


def agree(
    A: Array, b: Array, lower: Array,
    upper: Array, x0: Array, most: int = 40, **options: object,
) -> int:  # fmt: skip
    """Compare the first steps; how many there are."""
    norm = float(np.linalg.eigvalsh(A)[-1])
    given = {
        ("Γ" if k == "gamma" else "α_u" if k == "alpha_u" else k): v for k, v in options.items()
    }
    book = reference.mprgp(A, b, reference.Box(lower, upper), x0, norm, **given)  # type: ignore[arg-type]
    expected = list(islice(book, most))
    found = fast_steps(BoxQP(A, b, lower, upper), x0, norm, most, **options)
    assert [kind for kind, _ in found] == [kind for kind, _ in expected]
    size = max(float(np.abs(x).max()) for _, x in expected)
    for (_, x), (_, y) in zip(found, expected, strict=True):
        np.testing.assert_allclose(x, y, rtol=0.0, atol=1e-8 * size)
    return len(expected)


def test_the_reference_fits_on_a_page() -> None:
    assert len(Path(reference.__file__).read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("expansion", EXPANSIONS)
def test_a_support_vector_machine_of_the_paper_s_kind(expansion: str) -> None:
    """H = Y X̂ X̂ᵀ Y, b = 1, 0 ≤ x ≤ C, begun at the upper bound (paper, section 5.2)."""
    rng = np.random.default_rng(7)
    X = np.hstack([rng.normal(size=(60, 5)), np.ones((60, 1))])
    y = np.sign(X @ rng.normal(size=6) + 0.5 * rng.normal(size=60))
    H = y[:, None] * (X @ X.T) * y
    upper = np.ones(60)
    x0 = upper - 100.0 * np.finfo(float).eps
    steps = agree(H, np.ones(60), np.zeros(60), upper, x0, 25, expansion=expansion, rtol=0.1)
    assert steps > 5


@pytest.mark.parametrize("expansion", EXPANSIONS)
def test_a_string_over_an_obstacle(expansion: str) -> None:
    A, b, lower = string_obstacle(40)
    none = np.full(40, np.inf)
    assert agree(A.toarray(), b, lower, none, np.zeros(40), 30, expansion=expansion) > 10


def test_figure_1_of_the_paper() -> None:
    """The projected step that raises the cost is the same in both."""
    qp, x0 = figure_1()
    A = np.column_stack([_product(qp, e) for e in np.eye(2)])
    assert qp.lower is not None
    agree(A, qp.b, qp.lower, np.full(2, np.inf), x0, expansion="projcg", rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10_000), st.integers(2, 12), st.sampled_from(EXPANSIONS),
    st.sampled_from([0.5, 1.0, 1.9]), st.sampled_from([0.5, 1.0, 2.0]),
)  # fmt: skip
def test_random_boxes(seed: int, n: int, expansion: str, alpha_u: float, gamma: float) -> None:
    rng = np.random.default_rng(seed)
    A = random_hessian(rng, np.linspace(1.0, 30.0, n))
    b = A @ rng.normal(size=n)
    lower, upper = -rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)
    x0 = rng.uniform(lower, upper)
    agree(
        A, b, lower, upper, x0, 12,
        expansion=expansion, alpha_u=alpha_u, gamma=gamma, rtol=1e-4,
    )  # fmt: skip


def _product(qp: BoxQP, x: Array) -> Array:
    out = np.empty_like(x)
    qp.operator.apply(x, out)
    return out
