"""Load balancing: each rank gets a run of consecutive subdomains with about equal work."""

from collections.abc import Hashable, Sequence

MEMBER = 0.5
"""Work per subdomain over the work on its class, which is meshed and factored once per rank."""

GROWTH = 4.0 / 3.0
"""Exponent of the work on a class in its number of cells: that of a dense interface block."""

WORTH = 1.05
"""Work of the busiest rank over its lower bound, up to which ranks get equal numbers."""


def balanced_runs(subdomains: Sequence[tuple[Hashable, int]], ranks: int) -> list[int]:
    """First subdomain of each rank, and the total number; every rank gets at least one.

    Parameters
    ----------
    subdomains
        Class and cells of each; there are at least as many as ranks.
    """
    count = len(subdomains)
    even = [count * rank // ranks for rank in range(ranks + 1)]
    most = _largest_work(subdomains, even)
    best, least = even, most
    low = most / ranks  # lower bound of the work of the busiest rank
    for _ in range(20):
        limit = 0.5 * (low + least)
        starts = _within(subdomains, ranks, limit)
        work = _largest_work(subdomains, starts)
        if work < least:
            best, least = starts, work
        else:
            low = limit
    return best if most > WORTH * least else even


def _within(subdomains: Sequence[tuple[Hashable, int]], ranks: int, limit: float) -> list[int]:
    """Fill ranks one after another up to a limit; the last one gets the rest."""
    starts, work = [0], 0.0
    kinds: set[Hashable] = set()
    for number, (kind, cells) in enumerate(subdomains):
        more = _work(cells, kind in kinds)
        left = ranks - len(starts)
        if (
            number > starts[-1]
            and left
            and (work + more > limit or len(subdomains) - number == left)
        ):
            starts.append(number)
            kinds, work, more = set(), 0.0, _work(cells, False)
        kinds.add(kind)
        work += more
    return [*starts, len(subdomains)]


def _largest_work(subdomains: Sequence[tuple[Hashable, int]], starts: Sequence[int]) -> float:
    """Work of the busiest rank."""
    most = 0.0
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        kinds: set[Hashable] = set()
        work = 0.0
        for kind, cells in subdomains[first:last]:
            work += _work(cells, kind in kinds)
            kinds.add(kind)
        most = max(most, work)
    return most


def _work(cells: int, has_kind: bool) -> float:
    return float(cells**GROWTH * (MEMBER if has_kind else 1.0 + MEMBER))
