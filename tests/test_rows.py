"""Rows of parametrised tests: every combination once, and few that are not slow."""

from itertools import combinations, product

from tests.rows import covering

AXES = (range(5), "ab", ["x", "y", {}])


def test_all_rows_are_there_and_each_part_of_one_in_a_fast_row() -> None:
    for together, most in ((1, 5), (2, 18)):
        rows = covering(*AXES, together=together)
        assert [row.values for row in rows] == list(product(*AXES))
        fast = [row.values for row in rows if not row.marks]
        assert 0 < len(fast) <= most
        for at in combinations(range(3), together):
            for part in product(*(AXES[i] for i in at)):
                assert any(tuple(values[i] for i in at) == part for values in fast)
