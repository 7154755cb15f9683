"""Rows of parametrised tests: some in every run, all in the slow one."""

from collections import Counter
from collections.abc import Collection
from itertools import combinations, product
from typing import Any

import pytest


def covering(*axes: Collection[Any], together: int = 1) -> list[Any]:
    """All combinations of values; most are slow, but every value occurs in one that is not.

    A test whose axes hardly act on one another fails on some row of the few if it fails at all;
    ``--slow`` runs all of them.

    Parameters
    ----------
    axes
        The values of each parameter.
    together
        Of how many axes each combination of values occurs in a row that is not slow: 2 where
        faults may depend on two of them.
    """
    rows = list(product(*axes))
    places = list(combinations(range(len(axes)), together))
    parts = {row: {(at, tuple(row[i] for i in at)) for at in places} for row in _numbers(axes)}
    missing, used, chosen = set().union(*parts.values()), Counter[Any](), set()
    while missing:
        row = max(parts, key=lambda row: (len(parts[row] & missing), -sum(used[v] for v in row)))
        chosen.add(row)
        missing -= parts[row]
        used.update(row)
    return [
        pytest.param(*values, marks=() if row in chosen else pytest.mark.slow)
        for row, values in zip(parts, rows, strict=True)
    ]


def _numbers(axes: tuple[Collection[Any], ...]) -> list[tuple[tuple[int, int], ...]]:
    """The combinations by axis and number, for values may be no keys."""
    return list(product(*[[(k, i) for i, _ in enumerate(axis)] for k, axis in enumerate(axes)]))
