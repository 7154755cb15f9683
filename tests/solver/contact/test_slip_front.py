"""How far points let go ahead of a state: rods of contact points, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from solver.contact.friction_points import FrictionPoints
from solver.contact.slip_front import FrontOptions, SlipFront

EXACT = FrontOptions(shares=(1.0, 1.0))


def rod(count: int, contacts: int = 1) -> FrictionPoints:
    """Points on a line in the plane, `count` in each contact, with the slip limit 1."""
    number = np.arange(count * contacts)
    places = np.zeros((len(number), 3))
    places[:, 0] = number % count
    ones = np.ones(len(number))
    none = np.empty(0, np.int64)
    return FrictionPoints(
        rows=2 * number + 1, normals=2 * number, point=number, first=number,
        coefficients=0.0 * ones, limits=ones, spread=ones, normal_spread=ones,
        shared=none, other_rows=none, places=places, sources=number // count,
        tangents=np.tile([1.0, 0.0], (len(number), 1)),
    )  # fmt: skip


def pulled(points: FrictionPoints, force: float) -> np.ndarray:
    """All of a force at the first point, as where all of a thin rod sticks."""
    forces = np.zeros(len(points.rows))
    forces[0] = force
    return forces


def front(points: FrictionPoints, held: bool = False) -> SlipFront:
    return SlipFront(points, MPI.COMM_SELF, held, EXACT)


def test_as_many_points_of_a_rod_slide_as_its_force_needs() -> None:
    """7.5 are seven points at their limit, and half of it at the eighth, which sticks."""
    points = rod(20)
    early, after = front(points).sliding(pulled(points, 7.5), points.limits, np.ones(20, bool))
    assert list(np.flatnonzero(early)) == [1, 2, 3, 4, 5, 6]  # the first one is beyond its limit
    assert after == pytest.approx([1.0] * 7 + [0.5] + [0.0] * 12)


def test_excess_force_goes_to_sticking_points_only() -> None:
    points = rod(20)
    sticks = np.arange(20) != 1
    early, after = front(points).sliding(pulled(points, 2.5), points.limits, sticks)
    assert list(np.flatnonzero(early)) == [2]
    assert after == pytest.approx([1.0, 0.0, 1.0, 0.5] + [0.0] * 16)


@pytest.mark.parametrize(("held", "guessed"), [(False, 0), (True, 18)])
def test_no_early_release_of_a_nearly_sliding_body_held_by_friction_alone(
    held: bool, guessed: int
) -> None:
    points = rod(20)
    early, _ = front(points, held).sliding(pulled(points, 19.5), points.limits, np.ones(20, bool))
    assert early.sum() == guessed


def test_no_force_passes_between_contacts() -> None:
    """The excess force of one contact does not go to another contact in the same place."""
    points = rod(5, contacts=2)
    early, after = front(points, True).sliding(
        pulled(points, 50.0), points.limits, np.ones(10, bool)
    )
    assert list(np.flatnonzero(early)) == [1, 2, 3, 4]
    assert not after[5:].any()


def test_in_space_the_force_goes_to_several_neighbours_and_keeps_its_direction() -> None:
    number = np.arange(9)
    points = rod(9)
    places = np.stack([number % 3, number // 3, 0 * number], axis=1).astype(float)
    points = replace(
        points, places=places, rows=np.arange(18), normals=np.zeros(18, int),
        point=np.repeat(number, 2), first=2 * number, spread=np.ones(18),
        tangents=np.tile(np.eye(3)[:2], (9, 1)),
    )  # fmt: skip
    forces = np.zeros(18)
    forces[8:10] = 1.8, 2.4  # of the point in the middle, three times its limit
    _, after = front(points, True).sliding(forces, points.limits, np.ones(9, bool))
    found = after.reshape(-1, 2)
    assert found[4] == pytest.approx([0.6, 0.8])
    assert found.sum(axis=0) == pytest.approx([1.8, 2.4])
    takers = np.linalg.norm(np.delete(found, 4, axis=0), axis=1)
    assert sorted(takers)[-3:] == pytest.approx([2.0 / 3.0] * 3)
