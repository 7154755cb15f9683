"""The rules of the next set, given the sets before it, on a backend without any mechanics."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from solver.backend import Statuses
from solver.contact.active_set_options import ActiveSetOptions, Turnover
from solver.contact.active_set_update import ActiveSetUpdate, SetRules
from solver.contact.law import ContactLaw

ROWS = 8

OPTIONS = ActiveSetOptions(patience=3, largest_error=0.3, sets_before_levels=5)


@dataclass(frozen=True)
class Levels:
    """Every second row on the coarse level."""

    finest: bool

    @property
    def allowed(self) -> np.ndarray:
        return np.ones(ROWS, bool) if self.finest else np.arange(ROWS) % 2 == 0

    def finer(self) -> "Levels":
        return Levels(finest=True)


class Rigid:
    """The part of a backend that the rules need."""

    comm = MPI.COMM_SELF
    contact_rows = np.ones(ROWS, bool)

    def hierarchy(self, coarsened: bool) -> Levels:
        return Levels(finest=not coarsened)


def rules_of(options: ActiveSetOptions, coarsened: bool = True) -> SetRules[Any]:
    backend: Any = Rigid()
    update = ActiveSetUpdate[Any](backend, Levels(True), ContactLaw(), options)
    return SetRules(update, options.first_reduction, coarsened)


def different_sets(count: int) -> list[Statuses]:
    return [Statuses(np.arange(ROWS) < 1 + n % ROWS, np.full(ROWS, float(n))) for n in range(count)]


def test_many_sets_are_solved_more_accurately() -> None:
    """Patience: once by `tighten`; then each time by `careful`, the error as well."""
    rules, found = rules_of(OPTIONS), []
    for number, statuses in enumerate(different_sets(10)):
        rules, _ = rules.for_set(number, statuses, [])
        found.append((rules.reduction, rules.update.options.largest_error))
    first, tighten, careful = OPTIONS.first_reduction, OPTIONS.tighten, OPTIONS.careful
    expected = [(first, 0.3)] * 3 + [(first * tighten, 0.3)] * 3
    expected += [(first * tighten * careful, 0.3 * careful)] * 3
    expected += [(first * tighten * careful**2, 0.3 * careful**2)]
    np.testing.assert_allclose(found, expected)


def test_a_set_that_returns_is_solved_more_accurately_without_early_release() -> None:
    rules, statuses = rules_of(OPTIONS), different_sets(2)
    for number, visited in enumerate([statuses[0], statuses[1]]):
        rules, _ = rules.for_set(number, visited, [])
    assert rules.update.early_release
    rules, _ = rules.for_set(2, statuses[0], [])
    assert rules.reduction == OPTIONS.first_reduction * OPTIONS.deeper
    assert not rules.update.early_release
    again, _ = rules.for_set(2, statuses[1], [])  # was visited before the rules were changed
    assert again.reduction == rules.reduction


def test_contact_peels_on_after_four_sets_that_only_lose_rows() -> None:
    """A bar in a vee loses 14 % and 16 % of its rows in two sets, and settles in the next ones."""
    leaving = [Turnover(joined=0, left=20 - i, closed=140 - 20 * i) for i in range(4)]
    assert OPTIONS.peels_on([Turnover(joined=79, left=0, closed=61), *leaving])
    assert not OPTIONS.peels_on(leaving[:3])
    assert not OPTIONS.peels_on([*leaving[:2], Turnover(joined=1, left=19, closed=100), leaving[3]])


def test_contact_that_peels_off_goes_on_by_levels() -> None:
    statuses = Statuses(np.ones(ROWS, bool))
    peeling = [Turnover(joined=0, left=3, closed=ROWS), Turnover(joined=0, left=3, closed=ROWS)]
    options = replace(OPTIONS, patience=0)
    rules, same = rules_of(options, coarsened=False).for_set(2, statuses, [])
    assert rules.update.hierarchy.finest
    assert same is statuses
    coarse, fewer = rules.for_set(3, statuses, peeling)
    assert not coarse.update.hierarchy.finest
    assert coarse.reduction == OPTIONS.coarse_reduction
    np.testing.assert_array_equal(fewer.active, Levels(False).allowed)
    fine, _ = coarse.for_set(4, fewer, peeling)  # the set returns: the next level decides
    assert fine.update.hierarchy.finest
    assert not coarse.update.hierarchy.finest
    assert fine.reduction == coarse.reduction


@pytest.mark.parametrize("negligible", [0.0, 1e-9])
def test_a_row_with_negligible_tension_stays_active(negligible: float) -> None:
    """The last row pulls by 1e-10 of the largest force, which is not an error of the state."""
    forces = np.where(np.arange(ROWS) < 3, 50.0, 0.0)
    forces[2] = -5e-9
    state: Any = SimpleNamespace(
        multiplier=forces,
        distance=np.zeros(ROWS),
        closing=np.zeros(ROWS),
        jumps=np.zeros(ROWS),
        strained=1.0,
    )
    solved: Any = SimpleNamespace(statuses=Statuses(forces != 0.0), error=lambda strained: 1e-12)
    update = rules_of(replace(OPTIONS, negligible=negligible)).update
    following, _, _ = update.following(solved, state)
    stays = forces > (-1.0 if negligible else 0.0)
    np.testing.assert_array_equal(following.active, stays & (forces != 0.0))
    forces[2] = -5e-7
    following, _, _ = update.following(solved, state)
    assert following.active.sum() == 2


@pytest.mark.parametrize(
    ("first", "jumps"),
    [((0, 9), False), ((9, 0), True), ((200, 0), False)],
    ids=["only lost rows", "changed as few", "changed more"],
)
def test_sets_do_not_settle_where_as_many_rows_change_as_in_an_earlier_set_with_new_rows(
    first: tuple[int, int], jumps: bool
) -> None:
    """A first set from coarse levels that loses few rows only says nothing of growing contact."""
    growing = [Turnover(joined, 2, 500) for joined in (77, 20, 327, 54, 111, 64, 33, 27)]
    assert OPTIONS.jumps([Turnover(*first, 440), *growing]) is jumps
    assert not OPTIONS.jumps([Turnover(*first, 440), *growing[:-1]])
    assert not OPTIONS.jumps([Turnover(*first, 440), *growing[:-1], Turnover(0, 30, 500)])


def test_contact_that_only_opens_is_not_unsettled() -> None:
    """The turnovers of `configs/rough_rod.yaml` and of the clip."""
    leaving = [(0, 124, 207), (0, 1, 83), (0, 2, 82), (0, 58, 80), (0, 20, 22), (1, 1, 2)]
    changing = [(4, 5, 10), (5, 7, 9), (26, 4, 4), (9, 22, 26), (1, 8, 14), (5, 4, 8)]
    options = ActiveSetOptions(settling=6)
    assert not options.is_unsettled([Turnover(*numbers) for numbers in leaving])
    assert options.is_unsettled([Turnover(*numbers) for numbers in changing])
    assert not options.is_unsettled([Turnover(*numbers) for numbers in changing[:5]])
