"""Similar subdomains share one factor: K = γ Q K₁ Qᵀ."""

from dataclasses import replace

import numpy as np
import pytest

from solver.tfeti.subdomain.classes import ClassData, subdomain_class, subdomain_classes
from solver.tfeti.subdomain.similar import MovedInverse, Shape
from tests.solver.tfeti.test_reflections import springs

TURNED = (2, 0, 1)
"""Axis to which each axis of the first box goes."""


def data(cells: tuple[int, ...], size: float = 1.0, members: int = 40) -> ClassData:
    """A box of springs all of whose outer nodes are touched."""
    d = len(cells)
    points, K = springs(cells, spacing=(1.0,) * d)
    outside = ((points[:, :d] == 0.0) | (points[:, :d] == np.array(cells))).any(axis=1)
    touched = np.flatnonzero(np.repeat(outside, d))
    return ClassData(size * K, size * points, d, touched, members, None)


def turned(cells: tuple[int, ...]) -> tuple[int, ...]:
    """Cells of the box with permuted axes."""
    return tuple(cells[TURNED.index(axis)] for axis in range(3))


def test_a_turned_and_enlarged_box_is_similar() -> None:
    one, other = data((3, 2, 1)), data(turned((3, 2, 1)), 1.7)
    found = Shape(one.stiffness, one.points, 3).similarity(Shape(other.stiffness, other.points, 3))
    assert found is not None
    assert found.factor == pytest.approx(1.7, rel=1e-12)
    np.testing.assert_allclose(
        found.stiffness(one.stiffness).toarray(), other.stiffness.toarray(), atol=1e-12
    )


@pytest.mark.parametrize("changed", ["stiffer end", "longer", "other cells"])
def test_other_boxes_are_not_similar(changed: str) -> None:
    one = other = data((3, 2, 1))
    if changed == "stiffer end":
        points, K = springs((3, 2, 1), 1.0 + other.points[:, 0], spacing=(1.0,) * 3)
        other = replace(other, stiffness=K)
    elif changed == "longer":
        other = replace(other, points=other.points * np.array([1.0, 1.0, 1.0 + 1e-6]))
    else:
        other = data((2, 2, 2))
    shapes = [Shape(d.stiffness, d.points, 3) for d in (one, other)]
    assert shapes[0].similarity(shapes[1]) is None


@pytest.mark.parametrize("members", [40, 0])
def test_similar_classes_have_the_inverses_of_their_own_factors(members: int) -> None:
    """By dense blocks, and by sparse solves without members; with other touched unknowns each."""
    cells = [(3, 2, 2), turned((3, 2, 2)), (4, 3, 2)]
    given = [data(cells[0], members=members), data(cells[1], 0.6, members), data(cells[2])]
    given[0] = replace(given[0], touched=given[0].touched[::4])
    shared = subdomain_classes(given)
    assert [isinstance(cls.inverse, MovedInverse) for cls in shared] == [False, True, False]
    assert [cls.block is not None for cls in shared[:2]] == [members > 0] * 2
    for one, cls in zip(given, shared, strict=True):
        A, alone = one.stiffness.toarray(), subdomain_class(one)
        assert set(one.touched) <= set(cls.interface)
        assert cls.members == one.members
        np.testing.assert_allclose(cls.stiffness.toarray(), A, atol=1e-12)
        assert np.abs(A @ cls.kernel).max() < 1e-12
        # inverses may differ by motions of the kernel, so loads are balanced
        R, load = cls.kernel[cls.interface], np.zeros((len(A), 3))
        loads = np.random.default_rng(1).normal(size=(len(R), 3))
        loads -= R @ np.linalg.solve(R.T @ R, R.T @ loads)
        load[cls.interface] = loads
        np.testing.assert_allclose(A @ cls.solve(load), load, atol=1e-10)
        out = np.empty((3, len(R)))
        cls.apply_interface(np.ascontiguousarray(loads.T), out)
        works = [np.sum(load * u, axis=0) for u in (alone.solve(load), cls.solve(load))]
        for work in (works[1], np.sum(out.T * loads, axis=0)):
            np.testing.assert_allclose(work, works[0], rtol=1e-10)
        if cls.schur_complement is not None:
            inside = np.setdiff1d(np.arange(len(A)), cls.interface)
            coupling = A[np.ix_(inside, cls.interface)]
            relaxed = A[np.ix_(cls.interface, cls.interface)] - coupling.T @ np.linalg.solve(
                A[np.ix_(inside, inside)], coupling
            )
            found = np.empty_like(relaxed)
            cls.schur_complement.apply(np.eye(len(relaxed)), found)
            np.testing.assert_allclose(found, relaxed, rtol=0, atol=1e-5)
