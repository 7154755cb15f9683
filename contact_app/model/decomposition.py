"""The automatic decomposition: splits of a box, and their predicted cost.

The candidates are splits into sub-boxes of about equal length in every direction, and the
undecomposed box. The model of `solver.tfeti.subdomain.costs` chooses the one with the least
predicted time.
`python -m contact_app.studies.settings` compares it with others.
"""

import math
from collections import Counter
from collections.abc import Iterator
from itertools import product

from meshes.box import BoxShape
from solver.tfeti.subdomain.costs import Group, run_seconds

APPLICATIONS_GLUED, APPLICATIONS_WHOLE = 30.0, 30.0
"""Typical number of applications of the dual operator in a solve, with and without gluing."""

EDGE = 8.0
"""Cells along the edge of a sub-box at which `APPLICATIONS_GLUED` holds; they grow slowly."""

WORTH_SPLITTING = 0.8
"""Time of the best split over that of one subdomain above which the box is not split."""

SUBDOMAIN_OF_SEVERAL = 2e-4
"""Seconds per subdomain of several bodies that the cost model does not count, such as the recovery
of stresses. They decide between splits of a box that the model ranks alike: tied cubes of 40 and
48, 23 and 29, and 20 and 24 cells of degree 2 took 4 to 10 % less in the parts chosen with it (4 ×
4 × 4 of one of them in place of 6 × 6 × 6 or 5 × 5 × 5). Splits of one body were chosen by runs.
"""

SLENDER = 20.0
"""Boxes that are longer than this multiple of their width are not split up to `SLENDER_NODES`.

The factor of a narrow body is inexpensive, and bending of a chain of subdomains makes the dual
problem ill-conditioned.
"""

SLENDER_NODES = 50_000
"""Number of nodes up to which slender boxes are not split."""

LONGEST = 3.0
"""Largest ratio of length to width of sub-boxes, as far as the cells allow."""


def choose_split(box: BoxShape, at_least: int = 1, single: bool = True) -> tuple[int, ...]:
    """Sub-boxes along each axis for `decomposition: auto`.

    Parameters
    ----------
    at_least
        Least number of sub-boxes: one per rank.
    single
        Whether it is the only body; several bodies have a coarse problem for any splits.
    """
    undecomposed = (1,) * box.dimension
    edges = sorted(c * h for c, h in zip(box.cells, box.spacing, strict=True))
    if at_least == 1 and edges[-1] > SLENDER * edges[-2] and box.nodes <= SLENDER_NODES:
        return undecomposed
    enough = [split for split in _splits(box) if math.prod(split) >= at_least]
    best = min(enough, key=lambda split: seconds(box, split, single), default=box.cells)
    most = WORTH_SPLITTING * seconds(box, undecomposed, single)
    if at_least == 1 and seconds(box, best, single) > most:
        return undecomposed
    return best


def seconds(box: BoxShape, split: tuple[int, ...], single: bool = True) -> float:
    """Predicted seconds of a run with a box in given sub-boxes; parameters as in `choose_split`."""
    subdomains = math.prod(split)
    groups = groups_of(box, split)
    rows = box.dimension * (
        math.prod(box.degree * c + p for c, p in zip(box.cells, split, strict=True)) - box.nodes
    )
    edge = (math.prod(box.degree * c for c in box.cells) / subdomains) ** (1.0 / box.dimension)
    applications = (
        APPLICATIONS_GLUED * (edge / EDGE) ** 0.2 if subdomains > 1 else APPLICATIONS_WHOLE
    )
    several = 0.0 if single else SUBDOMAIN_OF_SEVERAL * subdomains
    return several + run_seconds(groups, rows, applications, subdomains > 1 or not single)


def groups_of(box: BoxShape, split: tuple[int, ...]) -> list[Group]:
    """Groups of sub-boxes of equal size.

    An undecomposed box has no interface and uses no reflections.
    """
    d = box.dimension
    reflections = 2**d if box.cell in ("quadrilateral", "hexahedron") else 2
    sizes = [
        Counter({c // p: p - c % p, c // p + 1: c % p})
        for c, p in zip(box.cells, split, strict=True)
    ]
    groups = []
    for cells in product(*sizes):
        members = math.prod(s[c] for s, c in zip(sizes, cells, strict=True))
        if not members:
            continue
        nodes = math.prod(box.degree * c + 1 for c in cells)
        inside = math.prod(max(box.degree * c - 1, 0) for c in cells)
        one = math.prod(split) == 1
        groups.append(
            Group(
                d, d * nodes, 0 if one else d * (nodes - inside), members, 1 if one else reflections
            )
        )
    return groups


def _splits(box: BoxShape) -> Iterator[tuple[int, ...]]:
    """One sub-box, and splits into sub-boxes of about every size."""
    yield (1,) * box.dimension
    counted = set()
    length = max(c * h for c, h in zip(box.cells, box.spacing, strict=True))
    target, shortest = length, float(min(box.spacing))
    while target > shortest:
        choices = [
            _near(cells, cells * spacing / target)
            for cells, spacing in zip(box.cells, box.spacing, strict=True)
        ]
        for split in product(*choices):
            if split in counted or math.prod(split) == 1:
                continue
            counted.add(split)
            edges = [c * h / p for c, h, p in zip(box.cells, box.spacing, split, strict=True)]
            # a short axis of the whole box makes no sub-box too narrow
            free = [e for e, p in zip(edges, split, strict=True) if p > 1]
            if max(edges) <= LONGEST * min(free):
                yield split
        target /= 1.25


def _near(cells: int, wish: float) -> list[int]:
    """Numbers of parts near a wanted one: the nearest, and the nearest divisor of the cells."""
    nearest = min(cells, max(1, round(wish)))
    even = [p for p in range(1, min(cells, math.ceil(2 * wish)) + 1) if cells % p == 0]
    return sorted({nearest, min(even, key=lambda p: abs(math.log(p / wish)))})
