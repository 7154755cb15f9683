"""Friction on the levels of the first set: springs in tangential rows that yield at the slip limit.

With a limit s and a spring of stiffness k the friction of a slip w is min(k, s / |w|) w, the
derivative of a convex function of w. So each tangential row has a spring of this stiffness, which
follows the slip from one Newton step to the next. The limit of Coulomb's law is that of the normal
force at the beginning of a step.
"""

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from solver.primal.merged import MergedSystem
from solver.vectors import Array, Ints


@dataclass(frozen=True, eq=False)
class FrictionSprings:
    """The points with friction, by the rows of a merged system; forces are multipliers."""

    rows: Ints
    normals: Ints
    point: Ints
    """Row of each tangential component, row of its point's normal, and number of its point. Shape
    (k,)."""
    sticking: Array  # (k,)
    """Stiffness of the springs while the points stick."""
    coefficients: Array
    limits: Array
    """Largest friction over the normal multiplier, and given largest friction. Shape (points,)."""
    acts: bool = True
    """Whether a contact of any rank has friction."""

    @classmethod
    def of(cls, system: MergedSystem, stiffness: Array) -> "FrictionSprings":
        """The points of a system.

        Parameters
        ----------
        stiffness : (rows,)
            Of the springs while the points stick.
        """
        points = system.problem.friction
        place = np.full(system.problem.size, -1)
        place[system.rows] = np.arange(len(system.rows))
        spread, normal = points.spread[points.first], points.normal_spread[points.first]
        return cls(
            place[points.rows],
            place[points.normals],
            points.point,
            stiffness[place[points.rows]],
            points.coefficients * normal / spread,
            points.limits / spread,
            points.acts,
        )

    def everywhere(self, comm: MPI.Intracomm, rows: int) -> "FrictionSprings":
        """The points of all ranks, by the numbers of all rows (collective).

        Parameters
        ----------
        rows
            Number of rows of this rank.
        """
        first_row, first_point = (comm.exscan(count) or 0 for count in (rows, len(self.limits)))
        parts = (
            self.rows + first_row, self.normals + first_row, self.point + first_point,
            self.sticking, self.coefficients, self.limits,
        )  # fmt: skip
        together = (np.concatenate(comm.allgather(part)) for part in parts)
        return replace(FrictionSprings(*together), acts=self.acts)

    def stiffness(self, jump: Array, normal_forces: Array) -> Array:
        """Stiffness of the springs of the tangential rows, (k,).

        Parameters
        ----------
        jump, normal_forces : (rows,)
            C u - c, and the multipliers of the normals, of all rows.
        """
        pressing = np.zeros(len(self.limits))
        pressing[self.point] = np.maximum(normal_forces[self.normals], 0.0)
        largest = self.limits + self.coefficients * pressing
        slip = np.sqrt(np.bincount(self.point, jump[self.rows] ** 2, len(largest)))
        still = np.where(largest > 0.0, np.inf, 0.0)
        sliding = np.divide(largest, slip, out=still, where=slip > 0.0)
        return np.minimum(self.sticking, sliding[self.point])
