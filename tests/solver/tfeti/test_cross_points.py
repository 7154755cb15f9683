"""Rows that join the copies of a node in more than two subdomains."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from solver.tfeti.constraints.cross_points import Neighbours, helmert, joining
from solver.vectors import Array, Mask


def graph(m: int, edges: list[tuple[int, int]]) -> Mask:
    result = np.zeros((m, m), bool)
    for a, b in edges:
        result[a, b] = result[b, a] = True
    return result


def laplacian(adjacent: Mask) -> Array:
    return np.diag(adjacent.sum(axis=1)) - adjacent.astype(float)


@pytest.mark.parametrize("m", range(2, 9))
def test_helmert_rows_span_the_differences_of_copies(m: int) -> None:
    rows = helmert(m)
    np.testing.assert_allclose(rows @ rows.T, np.eye(m - 1), atol=1e-15)
    np.testing.assert_allclose(rows @ np.ones(m), 0, atol=1e-15)


@settings(max_examples=80, deadline=None)
@given(st.integers(2, 9), st.data())
def test_rows_are_orthonormal_and_join_neighbours_alone(m: int, data: st.DataObject) -> None:
    pairs = [(a, b) for a in range(m) for b in range(a)]
    adjacent = graph(m, data.draw(st.lists(st.sampled_from(pairs))))
    rows, weights = joining(adjacent)
    np.testing.assert_allclose(rows @ rows.T, np.eye(m - 1), atol=1e-13)
    np.testing.assert_allclose(rows @ np.ones(m), 0, atol=1e-13)
    assert weights.max() == pytest.approx(1.0)
    assert weights.min() > 0.0
    values = np.linalg.eigvalsh(laplacian(adjacent))
    if values[1] < 1e-9:  # not connected: nothing to choose
        np.testing.assert_array_equal(weights, 1.0)
        return
    joined = rows.T @ (weights[:, None] * rows)
    np.testing.assert_allclose(joined, laplacian(adjacent) / values[-1], atol=1e-12)


def test_neighbours_are_alone_at_a_node() -> None:
    known = Neighbours(MPI.COMM_SELF, np.array([[3, 1], [1, 3], [1, 2]]))
    adjacent = known.adjacent(np.array([[1, 2, 3], [2, 3, 4]]))
    np.testing.assert_array_equal(adjacent[0], graph(3, [(0, 1), (0, 2)]))
    assert not adjacent[1].any()
    none = Neighbours(MPI.COMM_SELF, np.zeros((0, 2), np.int64))
    assert not none.adjacent(np.array([[1, 2, 3]])).any()
