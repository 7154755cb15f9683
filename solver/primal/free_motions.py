"""Rigid motions that nothing stops and no load works on.

The stiffness is singular along them. Residuals are kept orthogonal to them, since rounding alone
puts anything there, and they are taken out of an answer: the support rows W of B say where a body
is then held, u - Z (W Z)⁻¹ W u with Z the motions.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.primal.merged import MergedSystem, split_motions
from solver.tfeti.constraints.matrix import lent
from solver.tfeti.constraints.rows import RowKind

Array = NDArray[np.float64]

UNSEEN = 1e-10
"""Squared length of what rows see of a motion, over that of the largest, below which it is free."""

SPRINGLESS = 1e-12
"""Stiffness against a motion over the largest entry of K, up to which no spring resists it."""


class FreeMotions:
    """The free motions of a problem with support rows; there are none without (collective)."""

    def __init__(self, system: MergedSystem) -> None:
        self._system = system
        self._rows, bodies = _supports(system)
        self._motions = np.zeros((system.size, 0))
        if len(bodies):
            groups = system.problem.bodies.groups
            moving = np.flatnonzero(np.isin(groups, groups[bodies]))
            self._motions = _unseen(system, split_motions(system, moving.tolist()))
        seen = system.comm.allreduce(self._rows @ self._motions)
        self._moves = self._motions @ np.linalg.pinv(seen, rcond=1e-10)

    @property
    def none(self) -> bool:
        """Whether there are none."""
        return self._motions.shape[1] == 0

    def orthogonal(self, values: Array) -> Array:
        """The part of a vector (unknowns,) that is orthogonal to the motions (collective)."""
        if self.none:
            return values
        inside = self._system.comm.allreduce(self._motions.T @ values)
        return np.asarray(values - self._motions @ inside)

    def without(self, u: Array) -> Array:
        """The displacement (unknowns,) with the supports at rest (collective)."""
        if self.none:
            return u
        return np.asarray(u - self._moves @ self._system.comm.allreduce(self._rows @ u))


def _supports(system: MergedSystem) -> tuple[Array, NDArray[np.int64]]:
    """Support rows on merged unknowns, (rows, unknowns), and the body of each (collective)."""
    comm, problem = system.comm, system.problem
    mine = np.flatnonzero(problem.kinds == RowKind.SUPPORT)
    starts = np.cumsum([0, *comm.allgather(len(mine))])
    rows = np.zeros((starts[-1], system.size))
    bodies = np.zeros(starts[-1], np.int64)
    for k in range(starts[-1]):
        multiplier = np.zeros(problem.size)
        if starts[comm.rank] <= k < starts[comm.rank + 1]:
            row = mine[k - starts[comm.rank]]
            multiplier[row] = 1.0
            bodies[k] = problem.bodies.rows[row, 0]
        interface = problem.constraint_forces(multiplier)
        with lent(comm, interface, rows[k]) as (x, y):
            system.transfer.multTranspose(x, y)
    return rows, np.asarray(comm.allreduce(bodies))


def _unseen(system: MergedSystem, motions: Array) -> Array:
    """Orthonormal combinations of rigid motions (unknowns, k) that nothing sees (collective).

    Neither a row, nor a held unknown, nor the stiffness, which has springs in it for some forms.
    """
    comm = system.comm
    seen = [system.multiply(system.C, np.ascontiguousarray(m)) for m in motions.T]
    held = motions[system.held]
    gram = comm.allreduce(np.array(seen) @ np.array(seen).T + held.T @ held)
    values, vectors = np.linalg.eigh(gram)
    free = motions @ vectors[:, values <= UNSEEN * max(values.max(), np.finfo(float).tiny)]
    square = comm.allreduce(free.T @ free)
    free = np.asarray(np.linalg.solve(np.linalg.cholesky(square), free.T).T)
    images = [system.multiply(system.K, np.ascontiguousarray(m)) for m in free.T]
    energy = comm.allreduce(free.T @ np.array(images).reshape(-1, len(free)).T)
    stiffest = comm.allreduce(float(system.diagonal.max(initial=0.0)), op=MPI.MAX)
    values, vectors = np.linalg.eigh(0.5 * (energy + energy.T))
    return free @ vectors[:, values <= SPRINGLESS * stiffest]
