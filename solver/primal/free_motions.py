"""Rigid motions that nothing stops and no load works on: taken out of an answer.

The stiffness is singular along them, and conjugate gradients leave them wherever rounding does.
The support rows W of B say where a body is then held: u - Z (W Z)⁻¹ W u, Z the motions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.primal.merged import MergedSystem, split_motions
from solver.tfeti.constraints.matrix import lent
from solver.tfeti.constraints.rows import RowKind

Array = NDArray[np.float64]


class FreeMotions:
    """The support rows of a problem on merged unknowns (collective)."""

    def __init__(self, system: MergedSystem) -> None:
        self._system, comm = system, system.comm
        problem = system.problem
        mine = np.flatnonzero(problem.kinds == RowKind.SUPPORT)
        starts = np.cumsum([0, *comm.allgather(len(mine))])
        self._rows = np.zeros((starts[-1], system.size))
        bodies = np.zeros(starts[-1], np.int64)
        for k in range(starts[-1]):
            multiplier = np.zeros(problem.size)
            if starts[comm.rank] <= k < starts[comm.rank + 1]:
                row = mine[k - starts[comm.rank]]
                multiplier[row] = 1.0
                bodies[k] = problem.bodies.rows[row, 0]
            interface = problem.constraint_forces(multiplier)
            with lent(comm, interface, self._rows[k]) as (x, y):
                system.transfer.multTranspose(x, y)
        bodies = comm.allreduce(bodies)
        self._motions = np.zeros((system.size, 0))
        if len(bodies):
            every = split_motions(system, np.unique(bodies).tolist())
            seen = comm.allreduce(self._rows @ every)
            self._motions = every @ np.linalg.pinv(seen, rcond=1e-10)

    def without(self, u: Array) -> Array:
        """The displacement (unknowns,) with the supports at rest (collective)."""
        if not len(self._rows):
            return u
        return np.asarray(u - self._motions @ self._system.comm.allreduce(self._rows @ u))
