"""The nearest point of a polyhedron: `solver.contact.nearest_point`."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import nnls

from solver.contact.nearest_point import nearest_point


def nearest(point: list[float], rows: list[list[float]], limits: list[float]) -> np.ndarray:
    found = nearest_point(MPI.COMM_SELF, np.array(point), np.array(rows), np.array(limits))
    assert found is not None
    return found


def test_a_point_inside_is_returned() -> None:
    assert nearest([0.2, -0.1], [[1.0, 0.0]], [1.0]) == pytest.approx([0.2, -0.1])


def test_a_wedge_has_its_tip_as_nearest_point() -> None:
    """|y| ≤ 1 - x, scaled rows: the tip (1, 0) is nearest to all points behind it."""
    assert nearest([3.0, 0.5], [[2.0, 2.0], [5.0, -5.0]], [2.0, 5.0]) == pytest.approx([1.0, 0.0])


def test_rows_with_limit_zero_hold_a_point_on_them() -> None:
    assert nearest([1.0, 2.0], [[1.0, 0.0]], [0.0]) == pytest.approx([0.0, 2.0], abs=1e-12)


def test_random_polyhedra_meet_the_conditions_of_optimality() -> None:
    """The difference p - y is a non-negative sum of the rows that hold with equality at y."""
    rng = np.random.default_rng(5)
    for size in (2, 3, 6, 24):
        rows, point = rng.normal(size=(300, size)), 4.0 * rng.normal(size=size)
        limits = np.where(rng.uniform(size=300) < 0.01, 0.0, rng.uniform(size=300))
        y = nearest_point(MPI.COMM_SELF, point, rows, limits)
        assert y is not None
        left = limits - rows @ y
        assert left.min() > -1e-11
        assert nnls(rows[left < 1e-9].T, point - y)[1] < 1e-8
