"""The alternating part of nodal pressures of degree 2, on lines and quadrilaterals.

Along a line of nodes through facets (ends and middles in turn), a pressure with the right mean but
an alternating error is p + 2ε at the ends and p - ε in the middles. Fourth differences,

    S = (q₋₂ - 4q₋₁ + 6q₀ - 4q₁ + q₂)/16 = (D₋₁ - 2D₀ + D₁)/16,   D = q₋₁ - 2q₀ + q₁,

are 3ε/2 at the ends and -3ε/2 in the middles; for a smooth pressure they are of fourth order in the
size of facets. So 4/3 S is subtracted at the ends and 2/3 S in the middles, along each of the two
axes of a face. This removes the alternation completely and, where lines continue, no force: the sum
of the S is zero. Where facets differ in size D is weighted so that linear and quadratic pressures
have S = 0 at the ends. Lines that meet a plane of symmetry continue in their mirror image.

Only lines with all three nodes in contact take part: near the edge of the contact p falls like a
root, and its fourth differences would look like an alternation. A node between two nodes in contact
counts as in contact: only an alternation opens such a node. At the ends of the lines, and where
they do not go on straight, D is that of the other end of the facet, and S that of the middle with
the other sign; half of that at the edge of the contact, towards which an alternation fades. The
axes are distinguished by the largest component of a line's direction.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask

LINES = {3: ((0, 2, 1),), 9: ((0, 4, 1), (5, 8, 6), (2, 7, 3), (0, 5, 2), (4, 8, 7), (1, 6, 3))}
"""End, middle and end of the lines of nodes of a facet, in dolfinx's order, by its nodes."""

STRAIGHT = 0.3
"""Largest length of the mean of the two unit vectors at a node where a line counts as straight."""

END, MIDDLE, FADED = 4.0 / 3.0, 2.0 / 3.0, 0.5


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of nodes of facets."""

    nodes: Ints  # (lines, 3)
    """Copies of nodes: end, middle, end."""
    along: Array  # (lines, 3)
    """Unit vectors."""
    weight: Array  # (lines,)
    """One over the length."""

    @classmethod
    def of(cls, facets: Sequence[Ints], points: Array) -> "Lines":
        """Lines of facets (facets, nodes) among copies of nodes at points (copies, 3)."""
        parts = [np.zeros((0, 3), np.int64)]
        parts += [nodes[:, list(line)] for nodes in facets for line in LINES[nodes.shape[1]]]
        nodes = np.concatenate(parts)
        along = points[nodes[:, 2]] - points[nodes[:, 0]]
        length = np.linalg.norm(along, axis=1)
        return cls(nodes, along / length[:, None], 1.0 / length)

    def chosen(self, rows: Mask | Ints) -> "Lines":
        """Some of the lines."""
        return Lines(self.nodes[rows], self.along[rows], self.weight[rows])


def alternation(
    lines: Lines, q: Array, meet: Callable[[Array], Array], folded: Mask | None = None
) -> Array:
    """The alternating part of a pressure at copies of nodes, (copies,) (collective).

    Parameters
    ----------
    lines
        Lines of the whole boundary.
    q : (copies,)
        Pressures; 0 at open nodes.
    meet
        Function that replaces values at copies (copies,) by their sums over all copies of a node
        (collective).
    folded : (3, copies)
        Mask of copies on a plane of symmetry normal to each axis; none by default.
    """
    folded = np.zeros((3, len(q)), bool) if folded is None else folded
    result = np.zeros(len(q))
    axes = np.abs(lines.along).argmax(axis=1)
    for axis in range(3):
        along = lines.chosen(axes == axis)
        every = _Ends(along, len(q), meet, folded)
        some = along.chosen(_touching(along, every, q))
        result += _along(some, every, q, meet, folded)
    return result


class _Ends:
    """Sums over the ends of lines along one axis, at copies of nodes.

    On a plane of symmetry the sums are half of those of the whole.
    """

    def __init__(
        self, lines: Lines, copies: int, meet: Callable[[Array], Array], folded: Mask
    ) -> None:
        self._nodes = np.concatenate([lines.nodes[:, 0], lines.nodes[:, 2]])
        self._copies, self._meet = copies, meet
        sides = np.concatenate([lines.along, -lines.along]).T
        self.count = self.sums(np.ones(len(self._nodes)))
        met = np.stack([self.sums(side) for side in sides])
        length = np.linalg.norm(np.where(folded, 0.0, met), axis=0)  # images cancel across it
        self.go_on = (self.count > 0.0) & (length < STRAIGHT * self.count)

    def sums(self, values: NDArray[Any]) -> Array:
        """Sums at nodes of values at the first ends, then at the last ends."""
        return self._meet(_sum(self._nodes, values, self._copies))


def _sum(nodes: Ints, values: NDArray[Any], size: int) -> Array:
    """Values summed by node, (size,)."""
    return np.bincount(nodes, values, size).astype(np.float64)


def _touching(lines: Lines, ends: _Ends, q: Array) -> Mask:
    """Mask of the lines along one axis with all nodes in contact."""
    first, middle, last = lines.nodes.T
    touches = (q[middle] > 0.0) | ((q[first] > 0.0) & (q[last] > 0.0))
    between = ends.go_on & (ends.sums(np.tile(touches, 2).astype(float)) == ends.count)
    inside = (q > 0.0) | between
    return touches & inside[first] & inside[last]


def _along(
    lines: Lines, every: _Ends, q: Array, meet: Callable[[Array], Array], folded: Mask
) -> Array:
    """The alternation along one axis on lines in contact, among all lines along it."""
    first, middle, last = lines.nodes.T
    ends = _Ends(lines, len(q), meet, folded)
    weight = np.tile(lines.weight, 2)
    total = ends.sums(weight)
    mean = np.divide(1.0, total, out=np.zeros(len(q)), where=total > 0.0)
    difference = q[first] - 2.0 * q[middle] + q[last]
    rise = np.concatenate([q[middle] - q[first], q[middle] - q[last]])
    across = 2.0 * mean * ends.sums(weight * rise)
    inside = (mean * ends.sums(weight * np.tile(difference, 2)) - across) / 8.0

    a, b = ends.go_on[first], ends.go_on[last]
    one = np.where(a, across[first], across[last])
    other = np.where(b, across[last], across[first])
    on_either = a | b
    fourth = np.where(on_either, one - 2.0 * difference + other, 0.0) / 16.0
    count = meet(_sum(middle, np.ones(len(middle)), len(q)))
    amid = meet(_sum(middle, fourth, len(q))) / np.maximum(count, 1.0)
    seen = ends.sums(weight * np.tile(on_either, 2))
    outside = -ends.sums(weight * np.tile(fourth, 2))
    outside[every.count > ends.count] *= FADED
    outside = np.divide(outside, seen, out=np.zeros(len(q)), where=seen > 0.0)
    return END * np.where(ends.go_on, inside, outside) + MIDDLE * amid
