"""One factor for several active sets of thin bodies, whose contact changes by a few rows a set.

A factor of M₀ belongs to the set for which it was made. In another set some rows R have left and
some rows J have joined. With X = M₀⁻¹ Cᵀ on these rows, and W the stiffness of their springs in M₀,
the displacements V = X_R W move each row of R by nearly one and leave the other active rows alone.
So

    B = M₀⁻¹ + V (Vᵀ K V)⁻¹ Vᵀ,      M⁻¹ = B - T (W⁻¹ + C_J T)⁻¹ Tᵀ,  T = B C_Jᵀ

is nearly the inverse without the springs of R and with springs on J. Vᵀ K V is summed from products
with K: the difference of W and W C_R X_R would consist of rounding errors.
"""

import numpy as np

from solver.primal.blocks import in_blocks
from solver.primal.factor import Factor, FactorOptions, row_stiffness
from solver.primal.merged import MergedSystem
from solver.primal.products import multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.vectors import Array, Mask

Row = tuple[int, int]
"""Rank and place of a row."""


class FactorOnSets:
    """A factor that follows the sets of one problem; applied like a V-cycle."""

    def __init__(self, system: MergedSystem, options: FactorOptions) -> None:
        self.comm, self._system, self._options = system.comm, system, options
        self._stiffness = options.penalty * row_stiffness(system)
        self._factor: Factor | None = None

    def adapt_to(self, projector: Projector) -> None:
        """Follow a set, by a new factor if too many rows have changed (collective).

        Raises
        ------
        ArithmeticError
            The matrix of the set has no factor.
        """
        active = np.zeros(len(self._stiffness), bool)
        active[projector.rows] = True
        if self._factor is None or not self._follows(active):
            self._factor = None  # free the factor before the next one is made
            self._factor = Factor(self._system, projector, self._options)
            self._active, self._columns = active, dict[Row, tuple[Array, Array, Array]]()
            self._U, self._E = np.zeros((self._system.size, 0)), np.zeros((0, 0))

    def _follows(self, active: Mask) -> bool:
        """Whether the factor can follow the set; if so it does (collective)."""
        at = np.flatnonzero((active != self._active) & (self._stiffness > 0.0))
        parts = self.comm.allgather((at, active[at], self._stiffness[at]))
        rows = [(rank, int(i)) for rank, part in enumerate(parts) for i in part[0]]
        if len(self._columns.keys() | rows) > self._options.most_changed:
            return False
        for row in rows:
            if row not in self._columns:
                self._columns[row] = self._column(row)
        joins, W = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
        shape = len(rows), self._system.size
        F, X, KX = (
            np.array([self._columns[row][k] for row in rows]).reshape(shape).T for k in range(3)
        )
        V, KV = X[:, ~joins] * W[~joins], KX[:, ~joins] * W[~joins]
        energy = self.comm.allreduce(V.T @ KV)
        scale = 1.0 / np.sqrt(np.maximum(energy.diagonal(), np.finfo(float).tiny))
        scaled = 0.5 * (energy + energy.T) * np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        if len(values) and values[0] < self._options.singular:
            return False
        vectors *= scale[:, None]
        released = vectors / values @ vectors.T
        T = X[:, joins] + V @ (released @ self.comm.allreduce(V.T @ F[:, joins]))
        held = self.comm.allreduce(F[:, joins].T @ T)
        joined = np.linalg.inv(0.5 * (held + held.T) + np.diag(1.0 / W[joins]))
        self._U = np.hstack([V, T])
        self._E = np.zeros((len(rows), len(rows)))
        count = V.shape[1]
        self._E[:count, :count], self._E[count:, count:] = released, -joined
        return True

    def _column(self, row: Row) -> tuple[Array, Array, Array]:
        """Cᵀ, M₀⁻¹ Cᵀ and K M₀⁻¹ Cᵀ of one row, (unknowns,) (collective)."""
        assert self._factor is not None
        chosen = np.zeros(len(self._stiffness))
        if row[0] == self.comm.rank:
            chosen[row[1]] = 1.0
        force = multiply_transposed(self._system.C, chosen)
        moved = np.empty_like(force)
        self._factor.apply(force, moved)
        return force, moved, multiply(in_blocks(self._system.K), moved)

    def apply(self, residual: Array, out: Array) -> None:
        """Put the correction into out (collective)."""
        assert self._factor is not None
        self._factor.apply(residual, out)
        if len(self._E):
            out += self._U @ (self._E @ self.comm.allreduce(self._U.T @ residual))
