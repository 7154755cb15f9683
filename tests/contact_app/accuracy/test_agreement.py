"""Acceptance of an estimate by the energies of two meshes."""

import math

import pytest

from contact_app.accuracy.agreement import (
    CELLS,
    CLEAR,
    EITHER_WAY,
    FALLING,
    OTHER_KIND,
    Agreement,
    Measured,
    Verdict,
    needs_no_confirmation,
)


def level(error: float, effectivity: float, degree: int = 2, shift: float = -3.0) -> Measured:
    """A mesh whose energy is ½ e² above the true one, with an estimate of a given effectivity."""
    return Measured(degree, shift + 0.5 * error**2, (effectivity * error) ** 2)


def verdict(*levels: Measured) -> Verdict:
    """The verdict of a run of these levels on the last."""
    run = Agreement()
    return [run.add(one) for one in levels][-1]


def test_one_mesh_confirms_nothing() -> None:
    assert not verdict(level(0.1, 1.0)).agreed


@pytest.mark.parametrize("effectivity", [1.0, 1.2, 2.0])
def test_estimates_that_are_right_or_too_large_are_left_alone(effectivity: float) -> None:
    found = verdict(level(0.4, effectivity), level(0.2, effectivity))
    assert found.agreed
    assert found.raised == pytest.approx(1.0)


@pytest.mark.parametrize("effectivity", [0.95, 0.8, 0.6])
def test_an_estimate_that_is_a_part_of_the_error_is_raised_to_it(effectivity: float) -> None:
    found = verdict(level(0.4, effectivity), level(0.2, effectivity))
    assert found.agreed
    raised = math.sqrt(found.raised) * effectivity * 0.2
    assert raised == pytest.approx(0.2)


def test_an_estimate_that_misses_most_of_the_error_is_rejected() -> None:
    """A locked mesh: errors of 1 and 0.3, of which the estimates are a fifth."""
    found = verdict(level(1.0, 0.2), level(0.3, 0.2))
    assert not found.agreed
    assert "do not agree" in found.doubt


def test_a_lower_bound_catches_an_estimate_below_it() -> None:
    """Twice the fall of the energy is a part of the coarse mesh's squared error."""
    coarse, fine = level(0.5, 0.3), level(0.1, 1.0)
    assert 2.0 * (coarse.energy - fine.energy) > coarse.square
    assert not verdict(coarse, fine).agreed


def test_an_estimate_that_does_not_fall_while_the_energy_does_is_rejected() -> None:
    found = verdict(Measured(2, 1.0, 0.1), Measured(2, 0.5, 0.12))
    assert not found.agreed
    assert "do not fall" in found.doubt


def test_meshes_that_hardly_differ_confirm_nothing() -> None:
    assert "too little" in verdict(level(0.22, 1.0), level(0.2, 1.0)).doubt


def test_the_nearest_mesh_that_differs_enough_is_compared() -> None:
    """The estimate of the first mesh was far too small, which tells nothing about the last one."""
    found = verdict(level(3.0, 0.1), level(0.4, 1.0), level(0.21, 1.0), level(0.2, 1.0))
    assert found.agreed
    assert found.raised == pytest.approx(1.0)


@pytest.mark.parametrize(("effectivity", "agreed"), [(1.0, True), (0.9, True), (0.6, False)])
def test_cells_of_another_degree_confirm_but_do_not_raise(effectivity: float, agreed: bool) -> None:
    found = verdict(level(0.4, effectivity, degree=1), level(0.1, 1.0, degree=2))
    assert found.agreed is agreed
    assert found.raised == 1.0
    assert OTHER_KIND * 0.9**2 > 1.0 > OTHER_KIND * 0.6**2


def test_a_rise_of_the_energy_counts_for_more_than_a_fall() -> None:
    """With round obstacles energies may rise towards the true one, since penetration decreases."""
    down = verdict(Measured(2, 0.06, 0.1), Measured(2, 0.0, 0.02))
    up = verdict(Measured(2, -0.06, 0.1), Measured(2, 0.0, 0.02))
    assert down.raised == pytest.approx(1.5)
    assert up.raised == pytest.approx(2.5)


def test_a_doubt_does_not_matter_far_below_the_target() -> None:
    """Errors of 1 and 0.3, of which the estimates are a fifth: 0.06 is certainly below 0.5."""
    found = verdict(level(1.0, 0.2), level(0.3, 0.2))
    assert not found.agreed
    assert found.confirms(0.06, 0.5)
    assert not found.confirms(0.06, 0.3)
    assert not verdict(level(0.3, 0.2)).confirms(1e-9, 1.0), "nothing is known of one mesh"


def test_limits_are_stricter_where_energies_may_rise() -> None:
    levels = [level(0.6, 0.6), level(0.2, 0.6)]
    for limits, agreed in ((FALLING, True), (EITHER_WAY, False)):
        run = Agreement(limits)
        assert [run.add(one) for one in levels][-1].agreed is agreed


def test_a_coarser_mesh_confirms_the_first() -> None:
    run = Agreement()
    assert not run.add(level(0.2, 0.8)).agreed
    found = run.add_coarser(level(0.4, 0.8))
    assert found.agreed
    assert found.raised == pytest.approx(1 / 0.64)


def test_meshes_that_need_no_confirmation() -> None:
    assert needs_no_confirmation(1e-9, 0.1, 1), "exact to round-off"
    assert needs_no_confirmation(0.9 * CLEAR * 0.1, 0.1, CELLS)
    assert not needs_no_confirmation(0.9 * CLEAR * 0.1, 0.1, CELLS - 1), "a few cells"
    assert not needs_no_confirmation(0.5 * 0.1, 0.1, 100)
