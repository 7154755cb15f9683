"""The length of the step to the solution on a set, where the full step penetrates obstacles.

The solution u₁ on a set may lie far beyond rows that were open: a body that a few rows hold rolls
or bends about them. If all penetrated rows joined the set, the next sets would release them again,
a few in each. So the step from u₀ to u₁ ends where an energy is least: that of K under the
load and the forces of the active rows, which is least at u₁, and of one-sided springs on the open
rows, as stiff as K is against each row alone,

    ½ κ (t - 1)² + ½ Σ s max(0, g₀ + t (g₁ - g₀))²,   κ = (u₁ - u₀)ᵀ K (u₁ - u₀),

with the jumps g = C u - c of the open rows. Of the rows that u₁ penetrates, those that this point
penetrates, too, join the set, and the next solve begins there. At least one row joins: without
pressing springs the minimum is at t = 1. Rows that u₀ penetrates already, for instance since they
have just left the set, press only beyond g₀.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.primal.line_search import minimum_along
from solver.vectors import Array, Mask


@dataclass(frozen=True, eq=False)
class Position:
    """A displacement with f - K u (unknowns,) and C u - c (rows,); local parts."""

    u: Array
    left: Array
    jumps: Array

    def towards(self, other: "Position", share: float) -> "Position":
        """The position after a share of the step to another one."""
        pairs = zip(self._parts, other._parts, strict=True)
        return Position(*(one + share * (two - one) for one, two in pairs))

    @property
    def _parts(self) -> tuple[Array, Array, Array]:
        return self.u, self.left, self.jumps


def shortened(
    comm: MPI.Intracomm,
    stiffness: Array,
    is_open: Mask,
    before: Position,
    after: Position,
    full: float = 0.7,
) -> tuple[Position, Mask | None]:
    """The point of least energy on a step that penetrates more rows than are active (collective).

    Parameters
    ----------
    stiffness : (rows,)
        s, of all rows.
    is_open : (rows,)
        Mask of the contact rows that are not active.
    before, after
        Beginning and end of the step.
    full
        Share from which on the whole step is taken: sets that grow evenly need whole steps.

    Returns
    -------
    The point, and the rows (rows,) that press there. The end of the step and None where the step
    stays whole.
    """
    reached = after.jumps[is_open]
    penetrated, active = comm.allreduce(np.array([(reached > 0.0).sum(), (~is_open).sum()]))
    if penetrated <= active:
        return after, None
    bend = float((after.u - before.u) @ (before.left - after.left))
    already = np.maximum(before.jumps, 0.0)
    beginning, springs = (before.jumps - already)[is_open], stiffness[is_open]
    image = reached - before.jumps[is_open]

    def rest(t: float) -> tuple[float, float]:
        """Slope and curvature without springs."""
        return bend * (t - 1.0), bend

    share = minimum_along(comm, rest, springs * beginning, springs * image, image)
    if share >= full:
        return after, None
    point = before.towards(after, share)
    return point, point.jumps > already
